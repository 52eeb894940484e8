"""One door in every format: read, it is the same recording; fitted, the same posterior."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.io.inputs import read_input
from akm_fg.io.recording import write_recording
from akm_fg.pipeline import fit_input
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import Recording

WITHOUT_STAMPS = ("redwood",)


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
    same_frames(got, mm_door, stamps=name not in WITHOUT_STAMPS)
    assert got.name == path.name
    taken = [note for note in got.notes if "without stamps" in note]
    assert len(taken) == len(got.notes) == (name in WITHOUT_STAMPS)


def test_first_frames_are_taken_from_every_format(
    written: tuple[Path, str], mm_door: Recording
) -> None:
    path, name = written
    first = replace(mm_door, frames=mm_door.frames[:3])
    same_frames(read_input(path, first_frames=3), first, stamps=name not in WITHOUT_STAMPS)


@pytest.fixture(scope="session")
def posterior(
    mm_door: Recording, tmp_path_factory: pytest.TempPathFactory
) -> ArticulationPosterior:
    """Of the door as a recording folder of our own."""
    folder = tmp_path_factory.mktemp("ours") / "door"
    write_recording(folder, mm_door, depth_unit_m=1e-3)
    return fit_input(read_input(folder), "door")


@pytest.mark.slow
def test_every_format_gives_the_same_posterior(
    written: tuple[Path, str], posterior: ArticulationPosterior
) -> None:
    got = fit_input(read_input(written[0]), "door").to_dict()
    want = posterior.to_dict()
    assert got["kind"] == want["kind"] == "revolute"
    axes = np.dot(got["joint"]["axis"], want["joint"]["axis"])
    assert np.degrees(np.arccos(min(axes, 1.0))) < 0.1 * want["joint"]["axis_sd_deg"]
    away_m = np.linalg.norm(np.subtract(got["joint"]["pivot"], want["joint"]["pivot"]))
    assert away_m < 0.1 * want["joint"]["pivot_sd_m"]
    states = np.abs(np.subtract(got["states"]["mean"], want["states"]["mean"]))
    assert (states <= 0.1 * np.array(want["states"]["sd"])).all()
