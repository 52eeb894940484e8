"""`akm-fg objects`: a suite as a table and as JSON."""

import json

import numpy as np
import pytest

from akm_fg.cli.main import main


def test_a_suite_is_listed_with_joint_range_size_handle_and_split(capfd):
    assert main(["objects", "--suite", "furniture-116", "--json", "-"]) == 0
    listing = json.loads(capfd.readouterr().out)
    assert listing["schema"] == "akm-fg/objects/1"
    assert listing["split"] == "test"
    assert len(listing["objects"]) == 116
    door = next(o for o in listing["objects"] if o["name"] == "furniture-116/door-003")
    assert (door["kind"], door["unit"], door["hinge"]) == ("revolute", "rad", "bottom")
    assert door["range"][0] == 0.0 and door["range"][1] > 0.7
    assert door["standard_range"] == [0.0, np.deg2rad(40.0)]
    assert len(door["size_m"]) == 3 and door["handle"]["length_m"] > 0.0
    assert listing["skipped"] == []


def test_what_holds_a_part_closed_is_listed(capfd):
    assert main(["objects", "--json", "-"]) == 0
    listed = json.loads(capfd.readouterr().out)["objects"]
    caught = [o["catch"] for o in listed if o["catch"] is not None]
    assert caught and all(c["force"] > 0 and c["stiffness"] > 0 < c["travel"] for c in caught)
    closers = [o["closer"] for o in listed if o["closer"] is not None]
    assert {c["until"] is None for c in closers} == {True, False}  # hinges never let go, slides do
    assert main(["objects"]) == 0
    table = capfd.readouterr().out
    assert table.count("catch") == len(caught) and table.count("closer") == len(closers)


def test_a_users_folder_is_listed_and_its_broken_objects_are_named(
    capfd, mobility_object, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "mine"
    mobility_object(limits=(0.0, -1.0), axis="0 0 -1").write(folder / "7")
    mobility_object(second_joint=True).write(folder / "12")
    mobility_object().write(folder / "8")
    (folder / "8" / "mobility.urdf").write_text("<robot")
    assert main(["objects", "--suite", "partnet", "--folder", str(folder), "--json", "-"]) == 2
    out, err = capfd.readouterr()
    listing = json.loads(out)
    names = [f"partnet:{folder}/{name}" for name in ("7", "12#joint_0", "12#joint_2")]
    assert [o["name"] for o in listing["objects"]] == names
    assert (listing["split"], listing["objects"][0]["joint"]) == ("user", "joint_0")
    assert listing["objects"][0]["handle"]["fits"] is True
    assert listing["objects"][0]["standard_range"] == [0.0, 0.4]
    (bad,) = listing["skipped"]
    assert bad["name"].endswith("/8") and "is not XML" in bad["problem"]
    assert err.count("\n") == 1 and "left out" in err and "is not XML" in err
    (folder / "8" / "mobility.urdf").unlink()
    assert main(["objects", "--suite", f"partnet:{folder}"]) == 0
    assert "2 prismatic, 1 revolute; for user" in capfd.readouterr().out


def test_one_object_or_urdf_is_listed_by_its_joints(capfd, mobility_object, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = mobility_object(second_joint=True).write(tmp_path / "1")
    for place in (folder, folder / "mobility.urdf"):
        assert main(["objects", "--suite", "partnet", "--folder", str(place), "--json", "-"]) == 0
        listed = json.loads(capfd.readouterr().out)["objects"]
        assert [o["joint"] for o in listed] == ["joint_0", "joint_2"]
        assert all(o["name"].endswith(f"{place}#{o['joint']}") for o in listed)


def test_a_scale_makes_metres_of_millimetres(capfd, mobility_object, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    urdf = mobility_object().write(tmp_path / "1") / "mobility.urdf"
    sizes = []
    for more in ([], ["--scale", "0.25"]):
        arguments = ["objects", "--suite", "partnet", "--folder", str(urdf), "--json", "-", *more]
        assert main(arguments) == 0
        sizes.append(json.loads(capfd.readouterr().out)["objects"][0]["size_m"])
    np.testing.assert_allclose(sizes[1], 0.25 * np.array(sizes[0]))
    assert main(["objects", "--scale", "2"]) == 2
    assert "not for furniture-dev" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--suite", "partnet"], "expected --folder FOLDER"),
        (["--suite", "partnet", "--folder", "{}"], "expected FOLDER/ID/mobility.urdf"),
        (["--suite", "partnet", "--folder", "{}/gone"], "no such folder"),
        (["--suite", "partnet", "--folder", "{}/gone.urdf"], "no such file"),
        (["--folder", "{}"], "expected --suite partnet"),
    ],
)
def test_a_wrong_folder_gets_one_line(arguments, told, capfd, tmp_path):
    assert main(["objects", *(a.format(tmp_path) for a in arguments)]) == 2
    err = capfd.readouterr().err.strip()
    assert err.count("\n") == 0 and told in err


def test_the_table_names_every_object_and_says_what_the_suite_is_for(capfd, tmp_path):
    out = tmp_path / "objects.json"
    assert main(["objects", "--json", str(out)]) == 0
    printed = capfd.readouterr().out
    names = [o["name"] for o in json.loads(out.read_text())["objects"]]
    assert len(names) == 40 and all(name in printed for name in names)
    assert "20 prismatic, 20 revolute; for dev" in printed
    assert max(len(line.rstrip()) for line in printed.splitlines()) <= 80


@pytest.mark.parametrize("columns", ["60", "80", "130"])
def test_no_width_cuts_a_unit_or_a_name_off(columns, capfd, monkeypatch):
    assert main(["objects", "--json", "-"]) == 0
    listed = json.loads(capfd.readouterr().out)["objects"]
    monkeypatch.setenv("COLUMNS", columns)
    assert main(["objects"]) == 0
    words = capfd.readouterr().out.split()
    assert words.count("catch") == sum(o["catch"] is not None for o in listed)
    assert words.count("closer") == sum(o["closer"] is not None for o in listed)
    assert words.count("N") + words.count("N,") >= words.count("catch")
    assert all(o["name"] in words for o in listed)


def test_a_wide_terminal_shows_family_surface_and_split_too(capfd, monkeypatch):
    assert main(["objects"]) == 0
    assert "surface" not in capfd.readouterr().out
    monkeypatch.setenv("COLUMNS", "150")
    assert main(["objects"]) == 0
    assert "surface" in capfd.readouterr().out


def test_the_seed_scales_the_objects(capfd):
    sizes = []
    for seed in ("0", "1"):
        assert main(["objects", "--seed", seed, "--json", "-"]) == 0
        sizes.append(json.loads(capfd.readouterr().out)["objects"][0]["size_m"])
    assert sizes[0] != sizes[1]


def test_an_unknown_suite_gets_one_line(capfd):
    assert main(["objects", "--suite", "attic"]) == 2
    told = capfd.readouterr().err.strip()
    assert told.count("\n") == 0
    assert "attic" in told and "furniture-116, furniture-dev, partnet" in told
