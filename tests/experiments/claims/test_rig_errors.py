"""Rigs that err, on the smallest configuration."""

import dataclasses

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.io.recording_writer import write_recording
from akm_fg.records import CalibrationErrors, JointTruth, PinholeCamera, Recording, RgbdFrame
from experiments.claims.rig_errors import (
    WITH,
    WITHOUT,
    RigErrorsConfig,
    run,
    table,
    with_rig_errors,
)
from experiments.pages.tables import NoRows

CAMERA = PinholeCamera(16, 12, 20.0, 20.0, 8.0, 6.0)


def _recording():
    blank = np.zeros((12, 16, 3), dtype=np.uint8)
    depth = np.full((12, 16), 1.5, dtype=np.float32)
    frames = tuple(RgbdFrame(float(t), blank, depth, CAMERA, gtsam.Pose3()) for t in range(2))
    return Recording("r", frames)


def test_without_errors_a_rig_is_as_it_was():
    seen = with_rig_errors(_recording(), CalibrationErrors(np.zeros((6, 6))), 1).frames[1]
    assert_allclose(seen.depth_m, 1.5)
    assert seen.camera == CAMERA
    assert seen.T_world_cam.equals(gtsam.Pose3(), 1e-12)


def test_errors_are_those_of_the_seed_and_the_same_in_all_frames():
    errors = CalibrationErrors(np.diag([1e-6] * 6), 0.002, 0.01, 0.001)
    one, again, other = (with_rig_errors(_recording(), errors, seed) for seed in (1, 1, 2))
    first, second = one.frames
    assert first.T_world_cam.equals(second.T_world_cam, 0.0)
    assert_allclose(first.depth_m, again.frames[0].depth_m)
    assert abs(first.depth_m[0, 0] - other.frames[0].depth_m[0, 0]) > 1e-5
    assert 0.0 < abs(first.camera.fx / 20.0 - 1) < 0.01
    assert 0.0 < np.linalg.norm(first.T_world_cam.translation()) < 0.01


def test_trials_are_run_once_and_tabled_by_what_was_told(tmp_path):
    truth = JointTruth("prismatic", np.array([1.0, 0, 0]), None, np.array([0.0, 0.1]))
    write_recording(tmp_path / "recordings" / "blank", _recording(), truth)
    config = RigErrorsConfig(tmp_path / "recordings", 5, tmp_path / "rows")
    rows = run(config)
    assert {row.method for row in rows} == {WITH, WITHOUT}
    assert all(row.failure for row in rows)  # a blank wall shows nothing
    assert run(config) == rows
    assert f"| {WITHOUT} | 1 |" in table(rows)


def test_a_folder_without_recordings_is_said(tmp_path):
    config = RigErrorsConfig(tmp_path)
    with pytest.raises(NoRows, match="no recordings"):
        run(dataclasses.replace(config, folder=tmp_path / "rows"))
