"""How poses and depth are read: as said, as the format has it, or as what is seen tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.io.conventions import GL_FROM_CV, InputConventions
from akm_fg.io.inputs import read_input
from akm_fg.io.read_options import ReadOptions
from akm_fg.io.sources.registry import open_prepared
from akm_fg.records import Recording


@pytest.fixture(scope="module")
def few(mm_door: Recording) -> Recording:
    return replace(mm_door, frames=mm_door.frames[::5])


def posed(recording: Recording, write) -> Recording:
    """The recording with its poses as somebody else writes them."""
    frames = [replace(f, T_world_cam=write(f.T_world_cam)) for f in recording.frames]
    return replace(recording, frames=tuple(frames))


WAYS = {
    "ours": (lambda T: T, "opencv", False),
    "opengl": (lambda T: T * GL_FROM_CV, "opengl", False),
    "inverted": (lambda T: T.inverse(), "opencv", True),
    "both": (lambda T: (T * GL_FROM_CV).inverse(), "opengl", True),
}


@pytest.mark.parametrize("way", WAYS)
def test_the_floor_tells_how_poses_are_written(
    way: str, write: dict, tmp_path: Path, few: Recording
) -> None:
    change, convention, inverted = WAYS[way]
    prepared = open_prepared(write["tum"](tmp_path / "a", posed(few, change)))
    want = few.frames[0].T_world_cam.matrix()
    np.testing.assert_allclose(prepared.places[0].matrix(), want, atol=1e-8)
    understood = prepared.understood
    assert "the floor" in understood.axes_from
    assert understood.axes_from.startswith("the format's" if way == "ours" else "guessed")
    assert len(understood.notes) == (way != "ours")
    said = f"--convention {convention}" + " --invert-pose" * inverted
    assert all(said in note for note in understood.notes)
    assert understood.gravity.startswith("floor 0.9") and "world z" in understood.gravity


def test_what_a_person_says_is_not_doubted(write: dict, tmp_path: Path, few: Recording) -> None:
    path = write["tum"](tmp_path / "a", few)
    said = InputConventions("opengl", invert_pose=True, depth_unit_m=1e-3)
    got = read_input(path, options=ReadOptions(conventions=said))
    want = said.T_world_cam(few.frames[0].T_world_cam)
    np.testing.assert_allclose(got.frames[0].T_world_cam.matrix(), want.matrix(), atol=1e-8)
    np.testing.assert_allclose(got.frames[0].depth_m, 5 * few.frames[0].depth_m, rtol=1e-6)
    assert got.notes == ()


def test_without_a_floor_the_format_is_believed(write: dict, tmp_path: Path, make_clip) -> None:
    clip = make_clip(0.2, 3, joint="prismatic", floor=False, wall=False)
    path = write["tum"](tmp_path / "a", posed(clip.recording, lambda T: T * GL_FROM_CV))
    prepared = open_prepared(path)
    want = clip.recording.frames[0].T_world_cam * GL_FROM_CV
    np.testing.assert_allclose(prepared.places[0].matrix(), want.matrix(), atol=1e-8)
    assert prepared.understood.axes_from == "the format's"


def test_a_world_that_is_the_first_camera_says_nothing_of_up(
    write: dict, tmp_path: Path, few: Recording
) -> None:
    path = write["tum"](tmp_path / "a", posed(few, lambda T: gtsam.Pose3()))
    understood = open_prepared(path).understood
    assert understood.axes_from == "the format's" and understood.notes == ()
    assert "no plane that is seen stands across" in understood.gravity


@pytest.mark.parametrize("way", WAYS)
def test_a_moving_camera_tells_how_poses_are_written(
    way: str, write: dict, tmp_path: Path, walk: Recording
) -> None:
    turned = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.5, 0.7, -0.4), np.array([0.3, 0.1, 2.0]))
    tilted = posed(walk, lambda T: turned * T)  # no up that anybody could know
    prepared = open_prepared(write["tum"](tmp_path / "a", posed(tilted, WAYS[way][0])))
    for got, want in zip(prepared.places, tilted.frames, strict=True):
        np.testing.assert_allclose(got.matrix(), want.T_world_cam.matrix(), atol=1e-7)
    assert "what the moving camera sees again" in prepared.understood.axes_from
    assert len(prepared.understood.notes) == (way != "ours")


@pytest.mark.parametrize(
    ("unit", "read_m", "note"),
    [(5.0, 2e-4, None), (1.0, 1e-3, "not 0.0002 m"), (0.001, 1.0, "read as 1 m")],
)
def test_the_unit_of_depth_is_the_format_s_unless_what_is_seen_is_too_near(
    unit: float, read_m: float, note: str | None, write: dict, tmp_path: Path, few: Recording
) -> None:
    near = [replace(f, depth_m=(0.6 * f.depth_m).astype(np.float32)) for f in few.frames]
    if unit == 0.001:
        near = [replace(f, depth_m=np.rint(f.depth_m)) for f in few.frames]
    recording = replace(few, frames=tuple(near))
    understood = open_prepared(write["tum"](tmp_path / "a", recording, unit=unit)).understood
    assert understood.depth_unit_m == read_m
    assert len(understood.notes) == (note is not None)
    assert all(str(note) in text for text in understood.notes)


def test_a_tracker_s_tremor_is_no_motion_of_the_camera(
    write: dict, tmp_path: Path, few: Recording
) -> None:
    rng = np.random.default_rng(0)
    path = write["tum"](tmp_path / "a", posed(few, lambda T: T.retract(rng.normal(0, 2e-4, 6))))
    prepared = open_prepared(path)
    assert len({place.matrix().tobytes() for place in prepared.places}) == 1
    away = few.frames[0].T_world_cam.between(prepared.places[0])
    assert np.linalg.norm(away.translation()) < 3e-4
    assert "one place for all frames" in prepared.understood.notes[0]
