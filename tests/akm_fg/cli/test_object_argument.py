"""OBJECT as a person writes it: what it means, and one clear line where it means nothing."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from akm_fg.cli.main import main
from akm_fg.cli.object_argument import parse_object
from akm_fg.errors import InputError


@pytest.fixture
def cabinet(mobility_object, tmp_path: Path) -> Path:
    return mobility_object().write(tmp_path / "cabinets" / "46236")


@pytest.fixture
def chest(mobility_object, tmp_path: Path) -> Path:
    """Two of its joints move."""
    return mobility_object(second_joint=True).write(tmp_path / "cabinets" / "46300")


@pytest.mark.parametrize(
    ("name", "kind", "label"),
    [
        ("door", "revolute", "door"),
        ("drawer", "prismatic", "drawer"),
        ("furniture-dev/door-003", "revolute", "furniture-dev-door-003"),
        ("furniture-116/drawer-007", "prismatic", "furniture-116-drawer-007"),
    ],
)
def test_ours_go_by_name(name: str, kind: str, label: str):
    found = parse_object(name)
    assert (found.title, found.label, found.words) == (name, label, f"--object {name}")
    assert found.spec(1).kind == kind


def test_a_folder_and_its_file_are_the_same_object(cabinet: Path):
    folder, file = parse_object(str(cabinet)), parse_object(str(cabinet / "mobility.urdf"))
    assert folder.title == file.title == folder.label == "46236"
    assert folder.spec(0).kind == file.spec(0).kind == "prismatic"


def test_a_joint_is_named_in_title_label_and_command(chest: Path):
    found = parse_object(str(chest), "joint_0")
    assert (found.title, found.label) == ("46300, joint_0", "46300-joint_0")
    assert found.words == f"--object {chest} --joint joint_0"
    assert found.spec(0).kind == "prismatic"
    assert found.whole_name == f"{chest}#joint_0"
    assert parse_object(found.whole_name).label == found.label


def test_a_plain_urdf_is_called_by_its_file(cabinet: Path):
    file = (cabinet / "mobility.urdf").rename(cabinet / "my chest.urdf")
    found = parse_object(str(file))
    assert (found.title, found.label) == ("my chest", "my-chest")
    assert found.words == f"--object '{file}'"


def test_a_scale_is_kept_in_the_command_and_only_for_files(cabinet: Path, capfd):
    urdf = cabinet / "mobility.urdf"
    metres, less = parse_object(str(urdf)), parse_object(str(urdf), scale=0.5)
    assert less.words == f"--object {urdf} --scale 0.5"
    np.testing.assert_allclose(less.spec(0).size_m, 0.5 * metres.spec(0).size_m)
    assert less.spec(0).upper == pytest.approx(0.5 * metres.spec(0).upper)
    assert "--scale is for files and folders" in told(capfd, "--object", "door", "--scale", "2")
    for scale in ("0", "-1", "nan", "inf"):
        assert "--scale: is" in told(capfd, "--object", str(urdf), "--scale", scale)


def test_meshes_elsewhere_need_leave(cabinet: Path, tmp_path: Path, capfd):
    urdf, library = cabinet / "mobility.urdf", tmp_path / "library"
    meshes = cabinet / "textured_objs"
    meshes.rename(library)
    urdf.write_text(urdf.read_text().replace("textured_objs", str(library)))
    assert "lies outside" in told(capfd, "--object", str(urdf))
    found = parse_object(str(urdf), allowed=library)
    assert found.words == f"--object {urdf} --allow {library}"
    assert found.spec(0).allowed == library
    assert "is no folder" in told(capfd, "--object", str(urdf), "--allow", str(tmp_path / "no"))
    assert "--allow is for files" in told(capfd, "--object", "door", "--allow", str(library))


def told(capfd, *arguments: str) -> str:
    """The one line that a demo says before anything runs."""
    assert main(["demo", "--contact", "given", *arguments]) == 2
    said = capfd.readouterr().err.strip()
    assert "\n" not in said and said.startswith("akm-fg: ")
    return said


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("cupboard", "'cupboard' is no suite's object, file or folder; expected door, drawer"),
        ("furniture-200/door-001", "'furniture-200/door-001' is no suite's object, file or folder"),
        ("furniture-dev/door-099", "furniture-dev/door-099: no such object; expected drawer-001"),
        ("nowhere/chest.urdf", "'nowhere/chest.urdf' is no suite's object, file or folder"),
        ("a" * 5000, "is not a usable path"),
    ],
)
def test_what_is_not_there_is_told(name: str, words: str, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert words in told(capfd, "--object", name)
    assert not (tmp_path / "runs").exists()


def test_a_file_that_is_no_urdf_is_told(tmp_path, capfd):
    (tmp_path / "chest.obj").write_text("v 0 0 0")
    assert "does not end in .urdf" in told(capfd, "--object", str(tmp_path / "chest.obj"))
    (tmp_path / "chest.urdf").write_text("<robot")
    assert "is not XML" in told(capfd, "--object", str(tmp_path / "chest.urdf"))
    assert "mobility.urdf" in told(capfd, "--object", str(tmp_path))


def test_a_file_that_is_no_file_is_told(tmp_path, capfd):
    os.mkfifo(tmp_path / "pipe.urdf")
    for place in (tmp_path / "pipe.urdf", Path("/dev/null")):
        assert main(["explore", "--object", str(place), "--out", str(tmp_path)]) == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert ("is not a regular file" if place.suffix else "does not end in .urdf") in line


def test_a_joint_is_asked_for_where_several_move(chest: Path, capfd):
    listed = "joint_0, joint_2"
    assert f"--joint: {listed}" in told(capfd, "--object", str(chest))
    wrong = told(capfd, "--object", str(chest), "--joint", "joint_9")
    assert "no joint 'joint_9'" in wrong and listed in wrong
    assert "none can be chosen" in told(capfd, "--object", "door", "--joint", "hinge")


def test_a_target_of_the_wrong_unit_names_the_kind(chest: Path, capfd):
    arguments = ("--object", str(chest), "--joint", "joint_0", "--target", "30deg")
    assert "whose joint is prismatic; expected metres (0.25)" in told(capfd, *arguments)


@pytest.mark.parametrize("target", ["-0.05", "0.9", "-10deg", "200deg"])
def test_a_target_outside_the_range_is_told_before_anything_runs(target: str, capfd, tmp_path):
    name = "door" if target.endswith("deg") else "drawer"
    said = told(capfd, "--object", name, f"--target={target}", "--out", str(tmp_path / "runs"))
    assert f"{target} is outside the range of {name}; expected 0 to " in said
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("name", "target", "words"),
    [
        ("furniture-dev/drawer-001", "30deg", "whose joint is prismatic; expected metres"),
        ("furniture-dev/door-001", "0.2", "whose joint is revolute; expected degrees"),
        ("furniture-dev/door-001", "400deg", "is outside the range"),
    ],
)
def test_a_demo_that_would_explore_first_refuses_it_too(name, target, words, capfd, tmp_path):
    out = tmp_path / "runs"
    assert main(["demo", "--object", name, "--target", target, "--out", str(out)]) == 2
    (line,) = (x for x in capfd.readouterr().err.splitlines() if x.startswith("akm-fg"))
    assert words in line and not out.exists()


def test_what_any_part_of_an_object_can_do_is_no_wrong_target():
    from akm_fg.cli.demo import DemoArguments, _require_some_part
    from sim.objects.staging import find_spec

    spec = find_spec("furniture-multi-dev/cabinet-001", 0)  # three doors and drawers more
    for target in ((0.05, "m"), (0.2, "rad")):
        _require_some_part(DemoArguments(target="it"), target, spec)
    with pytest.raises(InputError, match="outside the range"):
        _require_some_part(DemoArguments(target="it"), (9.0, "rad"), spec)


def test_what_cannot_be_parsed_is_an_input_error():
    with pytest.raises(InputError, match="no suite's object"):
        parse_object("")
