"""`akm-fg objects`: a suite as a table and as JSON."""

import json

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
    assert len(door["size_m"]) == 3 and door["handle"]["length_m"] > 0.0


def test_the_table_names_every_object_and_says_what_the_suite_is_for(capfd, tmp_path):
    out = tmp_path / "objects.json"
    assert main(["objects", "--json", str(out)]) == 0
    printed = capfd.readouterr().out
    names = [o["name"] for o in json.loads(out.read_text())["objects"]]
    assert len(names) == 40 and all(name in printed for name in names)
    assert "20 prismatic, 20 revolute; for dev" in printed


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
    assert "attic" in told and "furniture-116, furniture-dev" in told
