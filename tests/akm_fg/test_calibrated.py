"""What is not known of the camera, in the posterior."""

import json
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.calibrated import calibrated, joint_errors
from akm_fg.errors import InputError
from akm_fg.estimation.between_kinds.agreement import line_apart
from akm_fg.estimation.fit import fit_tracks
from akm_fg.io.recording_reader import read_recording
from akm_fg.io.recording_writer import write_recording
from akm_fg.posterior import JointPosterior
from akm_fg.records import CalibrationErrors, PinholeCamera, Recording, RgbdFrame
from experiments.trials.openings import make_opening
from factors.joint import Joint, JointKind

NONE = np.zeros((6, 6))
CAMERA = PinholeCamera(640, 480, 610.0, 590.0, 320.0, 240.0)
T_WORLD_CAM = gtsam.Pose3(gtsam.Rot3.Rz(0.4) * gtsam.Rot3.Rx(-2.0), np.array([0.3, -1.2, 0.9]))
T_CAM_JOINT = gtsam.Pose3(gtsam.Rot3.Ypr(0.3, 0.5, -0.8), np.array([0.2, -0.1, 1.4]))


def _joint(T_cam_joint, T_world_cam=T_WORLD_CAM, kind=JointKind.REVOLUTE):
    return Joint(kind, (T_world_cam * T_cam_joint).matrix(), 0.0)


def _added(errors, kind=JointKind.REVOLUTE):
    posterior = JointPosterior(_joint(T_CAM_JOINT, kind=kind), NONE)
    return joint_errors(T_CAM_JOINT.matrix(), errors, posterior, CAMERA)


@pytest.mark.parametrize("k", range(6))
def test_a_camera_that_stands_elsewhere_moves_the_line_as_the_covariance_says(k):
    """One direction at a time, by moving the camera and looking at where the line went."""
    eta = np.zeros(6)
    eta[k] = 1e-5
    there = _joint(T_CAM_JOINT, T_WORLD_CAM * gtsam.Pose3.Expmap(eta))
    moved = line_apart(_joint(T_CAM_JOINT), there)
    cov = _added(CalibrationErrors(np.outer(eta, eta)))
    assert_allclose(cov[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])], np.outer(moved, moved), atol=1e-14)
    assert not cov[[2, 5]].any()


@pytest.mark.parametrize("name", ["depth_scale_sd", "depth_bias_sd_m", "focal_sd"])
def test_what_is_seen_wrongly_moves_the_line_as_the_covariance_says(name):
    """Two points of the true line, seen through the wrong camera."""
    step = 1e-5
    T = T_CAM_JOINT.matrix()
    points = T[:3, 3] + np.array([[0.0], [1e-3]]) * T[:3, 2]
    if name == "depth_scale_sd":
        seen = points * (1 + step)
    elif name == "focal_sd":
        seen = points * [1 - step, 1 - step, 1.0]
    else:  # the same bias for both: along the ray of the first
        seen = points + step * T[:3, 3] / T[2, 3]
    axis = (seen[1] - seen[0]) / np.linalg.norm(seen[1] - seen[0])
    T_seen = T.copy()
    T_seen[:3, :3] = _turned_onto(T[:3, :3], axis)
    T_seen[:3, 3] = seen[0]
    moved = line_apart(_joint(T_CAM_JOINT), _joint(gtsam.Pose3(T_seen)))
    cov = _added(CalibrationErrors(NONE, **{name: step}))
    assert_allclose(cov[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])], np.outer(moved, moved), atol=1e-13)


@pytest.mark.parametrize("k", range(4))
def test_intrinsics_move_the_line_as_the_covariance_says(k):
    """Two points of the true line, projected by the true camera and lifted by the believed one."""
    names = ("fx", "fy", "cx", "cy")
    step_px = 1e-3
    T = T_CAM_JOINT.matrix()
    points = T[:3, 3] + np.array([[0.0], [1e-3]]) * T[:3, 2]
    believed = replace(CAMERA, **{names[k]: getattr(CAMERA, names[k]) - step_px})
    seen = believed.back_project(CAMERA.project(points), points[:, 2])
    axis = (seen[1] - seen[0]) / np.linalg.norm(seen[1] - seen[0])
    T_seen = T.copy()
    T_seen[:3, :3] = _turned_onto(T[:3, :3], axis)
    T_seen[:3, 3] = seen[0]
    moved = line_apart(_joint(T_CAM_JOINT), _joint(gtsam.Pose3(T_seen)))
    cov_px2 = np.zeros((4, 4))
    cov_px2[k, k] = step_px**2
    cov = _added(CalibrationErrors(NONE, cov_intrinsics=cov_px2))
    got = cov[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])]
    assert_allclose(got, np.outer(moved, moved), rtol=1e-3, atol=1e-4 * np.abs(got).max())


def test_a_relative_error_of_both_focal_lengths_is_one_of_the_intrinsics():
    f_px = np.array([CAMERA.fx, CAMERA.fy, 0.0, 0.0])
    cov_px2 = 0.002**2 * np.outer(f_px, f_px)
    one, other = CalibrationErrors(NONE, 0.002), CalibrationErrors(NONE, cov_intrinsics=cov_px2)
    assert_allclose(_added(one), _added(other), atol=1e-20)
    posterior = fit_tracks(make_opening(1, "prismatic").tracks)
    one, other = (calibrated(posterior, e, T_WORLD_CAM, CAMERA).best.states for e in (one, other))
    assert_allclose(one.sd, other.sd)


def _turned_onto(R, axis):
    """The least turn of a frame that takes its z onto an axis."""
    w = np.cross(R[:, 2], axis)
    sine = np.linalg.norm(w)
    return gtsam.Rot3.Expmap(w / max(sine, 1e-300) * np.arcsin(sine)).matrix() @ R


def test_a_drawers_states_scale_with_depth_and_a_doors_do_not():
    errors = CalibrationErrors(NONE, depth_scale_sd=0.01)
    for kind in ("prismatic", "revolute"):
        posterior = fit_tracks(make_opening(1, kind).tracks)
        with_errors = calibrated(posterior, errors, T_WORLD_CAM, CAMERA)
        before, after = posterior.best.states, with_errors.best.states
        grown = 0.01 * before.mean if kind == "prismatic" else 0.0
        assert_allclose(after.sd, np.hypot(before.sd, grown))
        assert_allclose(after.mean, before.mean)
        assert with_errors.kind == posterior.kind


def test_a_drawers_axis_does_not_care_where_the_camera_stands():
    shift = CalibrationErrors(np.diag([0, 0, 0, 1e-6, 1e-6, 1e-6]))
    assert not _added(shift, JointKind.PRISMATIC).any()


def _recording(errors):
    camera = PinholeCamera(8, 6, 10.0, 10.0, 4.0, 3.0)
    blank = np.zeros((6, 8, 3), dtype=np.uint8)
    frames = tuple(
        RgbdFrame(float(t), blank, np.ones((6, 8), dtype=np.float32), camera, T_WORLD_CAM)
        for t in range(2)
    )
    return Recording("r", frames, calibration=errors)


def test_a_recording_keeps_what_is_not_known_of_its_camera(tmp_path):
    root = np.random.default_rng(0).normal(size=(6, 6)) * 1e-3
    errors = CalibrationErrors(root @ root.T, 0.002, 0.01, 0.001)
    write_recording(tmp_path / "r", _recording(errors))
    read = read_recording(tmp_path / "r").calibration
    assert_allclose(read.cov_world_cam, errors.cov_world_cam)
    assert (read.focal_sd, read.depth_scale_sd, read.depth_bias_sd_m) == (0.002, 0.01, 0.001)
    assert read.cov_intrinsics is None
    lens = replace(errors, cov_intrinsics=np.diag([4.0, 4.0, 1.0, 1.0]))
    write_recording(tmp_path / "lens", _recording(lens))
    assert_allclose(
        read_recording(tmp_path / "lens").calibration.cov_intrinsics, lens.cov_intrinsics
    )
    write_recording(tmp_path / "without", _recording(None))
    assert read_recording(tmp_path / "without").calibration is None


def test_covariances_stand_for_themselves_and_where_they_stood_at_first(tmp_path):
    write_recording(tmp_path / "r", _recording(None))
    file = tmp_path / "r" / "recording.json"
    said = json.loads(file.read_text())
    place, lens = (1e-6 * np.eye(6)).tolist(), np.eye(4).tolist()
    file.write_text(json.dumps(said | {"cov_intrinsics": lens}))
    read = read_recording(tmp_path / "r").calibration
    assert not read.cov_world_cam.any() and read.focal_sd == 0.0
    assert_allclose(read.cov_intrinsics, np.eye(4))
    file.write_text(json.dumps(said | {"calibration": {"cov_world_cam": place, "focal_sd": 0.01}}))
    read = read_recording(tmp_path / "r").calibration
    assert_allclose(read.cov_world_cam, place)
    assert read.focal_sd == 0.01 and read.cov_intrinsics is None
    file.write_text(json.dumps(said | {"cov_intrinsics": place}))
    with pytest.raises(InputError, match="cov_intrinsics"):
        read_recording(tmp_path / "r")


def test_a_calibration_that_is_none_is_refused_in_one_line(tmp_path):
    write_recording(tmp_path / "r", _recording(CalibrationErrors(NONE, 0.002)))
    file = tmp_path / "r" / "recording.json"
    file.write_text(file.read_text().replace('"focal_sd": 0.002', '"focal_sd": -1'))
    with pytest.raises(InputError, match=r"calibration.*no less than 0"):
        read_recording(tmp_path / "r")


def test_a_covariance_that_is_not_symmetric_is_refused():
    cov = np.eye(6)
    cov[0, 1] = 0.5
    with pytest.raises(ValueError, match="symmetric"):
        CalibrationErrors(cov)
    with pytest.raises(ValueError, match="no less"):
        replace(CalibrationErrors(np.eye(6)), cov_world_cam=-np.eye(6))
