"""One door in every format: read, it is the same recording; fitted, the same posterior."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.io.inputs import read_input
from akm_fg.io.recording import write_recording
from akm_fg.pipeline import fit_input
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import Recording

OTHER_STAMPS = ("redwood", "video")  # they have none, or count from 0
NOTES = {"redwood": "pictures without stamps", "video": "unit of depth read as 0.001 m"}


def in_camera(name: str, recording: Recording) -> Recording:
    """The recording as a format without poses has it: the world is the camera's frame."""
    if name != "realsense":
        return recording
    frames = [replace(frame, T_world_cam=gtsam.Pose3()) for frame in recording.frames]
    return replace(recording, frames=tuple(frames))


def same_frames(got: Recording, want: Recording, stamps: bool = True) -> None:
    assert len(got.frames) == len(want.frames)
    for frame, true in zip(got.frames, want.frames, strict=True):
        np.testing.assert_array_equal(frame.rgb, true.rgb)
        np.testing.assert_array_equal(frame.depth_m, true.depth_m)
        np.testing.assert_allclose(frame.T_world_cam.matrix(), true.T_world_cam.matrix(), atol=1e-8)
        assert frame.camera == true.camera
        assert not stamps or frame.stamp_s == pytest.approx(true.stamp_s, abs=1e-6)


def test_every_format_holds_the_same_frames(written: tuple[Path, str], mm_door: Recording) -> None:
    path, name = written
    got = read_input(path)
    same_frames(got, in_camera(name, mm_door), stamps=name not in OTHER_STAMPS)
    assert got.name == path.name
    assert len(got.notes) == (name in NOTES)
    assert all(NOTES[name] in note for note in got.notes)


def test_first_frames_are_taken_from_every_format(
    written: tuple[Path, str], mm_door: Recording
) -> None:
    path, name = written
    first = replace(in_camera(name, mm_door), frames=in_camera(name, mm_door).frames[:3])
    same_frames(read_input(path, first_frames=3), first, stamps=name not in OTHER_STAMPS)


@pytest.fixture(scope="session")
def posterior(
    mm_door: Recording, tmp_path_factory: pytest.TempPathFactory
) -> ArticulationPosterior:
    """Of the door as a recording folder of our own."""
    folder = tmp_path_factory.mktemp("ours") / "door"
    write_recording(folder, mm_door, depth_unit_m=1e-3)
    return fit_input(read_input(folder), "door")


def in_sd(got: dict, want: dict, T_want_got: gtsam.Pose3) -> dict[str, float]:
    """How far two posteriors are apart, in standard deviations."""
    one, other = got["joint"], want["joint"]
    turned = T_want_got.rotation().rotate(np.array(one["axis"]))
    axis_deg = np.degrees(np.linalg.norm(turned - other["axis"]))
    away = T_want_got.transformFrom(np.array(one["pivot"])) - other["pivot"]
    away_m = np.linalg.norm(
        np.cross(other["axis"], away)
    )  # along the axis a pivot may lie anywhere
    states = np.abs(np.subtract(got["states"]["mean"], want["states"]["mean"]))[1:]
    return {
        "axis": axis_deg / other["axis_sd_deg"],
        "pivot": away_m / other["pivot_sd_m"],
        "states": float((states / np.array(want["states"]["sd"])[1:]).max()),
    }


@pytest.mark.slow
def test_every_format_gives_the_same_posterior(
    written: tuple[Path, str], posterior: ArticulationPosterior, mm_door: Recording
) -> None:
    path, name = written
    got = fit_input(read_input(path), "door")
    assert got.kind == posterior.kind == "revolute"
    place = mm_door.frames[0].T_world_cam if name == "realsense" else gtsam.Pose3()
    assert max(in_sd(got.to_dict(), posterior.to_dict(), place).values()) < 0.1


def test_a_record3d_file_holds_the_frames_but_for_its_jpeg(
    write: dict, tmp_path: Path, mm_door: Recording
) -> None:
    pytest.importorskip("liblzfse")
    got = read_input(write["r3d"](tmp_path / "door", mm_door))
    y_up = np.array([[0, 1.0, 0], [0, 0, 1.0], [1.0, 0, 0]])
    for frame, true in zip(got.frames, mm_door.frames, strict=True):
        np.testing.assert_array_equal(frame.depth_m, true.depth_m)
        R = y_up @ true.T_world_cam.rotation().matrix()
        np.testing.assert_allclose(frame.T_world_cam.rotation().matrix(), R, atol=1e-8)
        assert np.abs(frame.rgb.astype(int) - true.rgb).mean() < 2
        assert frame.stamp_s == true.stamp_s


@pytest.mark.slow
def test_a_record3d_file_gives_the_same_posterior(
    write: dict, tmp_path: Path, mm_door: Recording, posterior: ArticulationPosterior
) -> None:
    pytest.importorskip("liblzfse")
    got = fit_input(read_input(write["r3d"](tmp_path / "door", mm_door)), "door")
    y_up = gtsam.Pose3(gtsam.Rot3(np.array([[0, 0, 1.0], [1.0, 0, 0], [0, 1.0, 0]])), np.zeros(3))
    assert got.kind == "revolute"
    assert max(in_sd(got.to_dict(), posterior.to_dict(), y_up).values()) < 0.5  # JPEG
