"""Folders and files by name: what they are called, what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import pytest

from akm_fg.errors import InputError
from sim.objects.imported import imported_spec
from sim.objects.imported.imported_build import build_imported
from sim.objects.imported.partnet import PartnetSuite
from sim.objects.staging import find_spec


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))


def test_the_seed_scales_a_folders_object_and_leaves_a_urdf_in_metres(
    mobility_object, tmp_path: Path
):
    folder = mobility_object(category="Microwave").write(tmp_path / "1")
    specs = [find_spec(f"partnet:{folder}", seed) for seed in (0, 1)]
    assert specs[0].scale != specs[1].scale
    assert all(0.45 <= spec.size_m.max() <= 0.55 for spec in specs)
    urdf = find_spec(str(folder / "mobility.urdf"), 1)
    assert urdf.scale == 1.0 and urdf.size_m.max() == pytest.approx(1.2)
    assert find_spec(str(folder), 0).scale == specs[0].scale  # `partnet:` may be left out


def test_a_missing_collision_mesh_is_replaced_and_a_missing_or_empty_visual_one_said(
    mobility_object, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    folder = mobility_object().write(tmp_path / "1")
    urdf = folder / "mobility.urdf"
    head, tail = urdf.read_text().rsplit("<collision>", 1)
    urdf.write_text(head + "<collision>" + tail.replace("bar-3.obj", "gone.obj", 1))
    spec = find_spec(f"partnet:{folder}", 0)
    out = tmp_path / "out"
    out.mkdir()
    build_imported(spec, out)
    assert len(list(out.glob("part_hull_*.obj"))) == 4  # the board and the handle's three
    assert not caplog.records
    texts = [file.read_text() for file in out.glob("*.urdf")]
    assert texts and not any(str(tmp_path) in text for text in texts)  # they are kept for others
    front = folder / "textured_objs" / "front-2.obj"
    for content, told in ((None, "missing"), ("", "empty"), ("v 0 0 0\n", "empty")):
        front.unlink() if content is None else front.write_text(content)
        caplog.clear()
        imported_spec._say.cache_clear()
        for _ in range(2):  # found in the file, and from the cache: said once
            part = find_spec(f"partnet:{folder}", 0)
        (line,) = caplog.messages
        assert line.startswith(str(urdf)) and f"front-2.obj' of link 'link_0' is {told}" in line
        assert part.handle.style == "handle" and part.mass_kg < spec.mass_kg


def test_a_mesh_that_cannot_be_read_gets_one_line(mobility_object, tmp_path: Path):
    folder = mobility_object().write(tmp_path / "1")
    (folder / "textured_objs" / "front-2.obj").write_text("v 1 2\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"front-2\.obj") as caught:
        find_spec(f"partnet:{folder}", 0)
    assert "\n" not in str(caught.value)


def test_a_suite_goes_on_without_its_broken_objects_and_says_so(
    mobility_object, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    mobility_object().write(tmp_path / "7")
    mobility_object(second_joint=True).write(tmp_path / "12")
    mobility_object().write(tmp_path / "8")
    (tmp_path / "8" / "mobility.urdf").write_text("<robot")
    mobility_object().write(tmp_path / "9")
    moved = (tmp_path / "9" / "mobility.urdf").read_text().replace("textured_objs", "../8")
    (tmp_path / "9" / "mobility.urdf").write_text(moved)
    mobility_object().write(tmp_path / "10")
    (tmp_path / "10" / "textured_objs" / "bar-3.obj").write_text("v 1 2\nf 1 2 3\n")
    suite = PartnetSuite(tmp_path)
    specs, skipped = suite.sound(0)
    wanted = ["7", "12#joint_0", "12#joint_2"]
    assert [spec.name for spec in specs] == [f"partnet:{tmp_path}/{name}" for name in wanted]
    assert [spec.name for spec in suite] == [spec.name for spec in specs]
    assert len(skipped) == 3 == len(caplog.records)
    assert "is not XML" in skipped[0].problem and "lies outside" in skipped[1].problem
    assert find_spec(specs[1].name, 0).joint == "joint_0"  # the listed name opens it


@pytest.mark.parametrize(
    ("name", "joint", "told"),
    [
        ("partnet:{}/1", None, "several joints move; expected one named by --joint: joint_0"),
        ("partnet:{}/1", "lid", "no joint 'lid' that moves; expected one of joint_0, joint_2"),
        ("partnet:{}/2", None, "has no mobility.urdf"),
        ("{}/gone.urdf", None, "no such file"),
        ("furniture-dev/door-001", "hinge", "has one joint"),
    ],
)
def test_a_wrong_object_or_joint_gets_one_clear_line(
    name: str, joint: str | None, told: str, mobility_object, tmp_path: Path
):
    mobility_object(second_joint=True).write(tmp_path / "1")
    with pytest.raises(InputError, match=told) as caught:
        find_spec(name.format(tmp_path), 0, joint=joint)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("folder", ["empty", "gone"])
def test_a_folder_without_objects_is_refused(folder: str, tmp_path: Path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"expected FOLDER/ID/mobility\.urdf"):
        PartnetSuite(tmp_path / folder)


def test_a_mesh_that_was_edited_is_read_anew(mobility_object, tmp_path: Path):
    folder = mobility_object().write(tmp_path / "1")
    before = find_spec(str(folder / "mobility.urdf"), 0)
    mesh = folder / "textured_objs" / "carcass-1.obj"
    mesh.write_text(mesh.read_text().replace("v 0.500000 ", "v 0.900000 "))
    after = find_spec(str(folder / "mobility.urdf"), 0)
    assert after.content != before.content
    assert after.size_m[0] > before.size_m[0] + 0.3
