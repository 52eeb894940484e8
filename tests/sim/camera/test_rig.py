"""Rigs that err: what is believed of them is wrong by what was drawn, and by nothing else."""

from __future__ import annotations

from collections.abc import Iterator

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from akm_fg.records import PinholeCamera, RgbdFrame
from sim.camera.camera import CameraConfig
from sim.camera.rig import CameraErrors, RigErrors
from sim.episode import SimEpisode, open_world

SMALL = CameraConfig().scaled(0.25)
LARGE = RigErrors(0.01, np.radians(1.0), 0.02, 0.02, 0.01, np.radians(0.5))


def _opened(rig: RigErrors | None, seed: int = 3) -> Iterator[SimEpisode]:
    with open_world("drawer", seed, "clean", camera_config=SMALL, rig=rig) as episode:
        yield episode


@pytest.fixture(scope="module")
def perfect() -> Iterator[SimEpisode]:
    yield from _opened(None)


@pytest.fixture(scope="module")
def erring() -> Iterator[SimEpisode]:
    yield from _opened(LARGE)


def test_frames_believe_another_place_and_camera_than_those_that_made_the_picture(perfect, erring):
    """The picture is the perfect camera's; where a pixel points is off as the errors say."""
    true, seen, e = perfect.camera.capture(), erring.camera.capture(), erring.rig.camera
    assert_array_equal(true.rgb, seen.rgb)
    T = seen.T_world_cam * gtsam.Pose3.Expmap(np.array(e.eta))
    assert T.equals(true.T_world_cam, 1e-9)
    assert not seen.T_world_cam.equals(true.T_world_cam, 1e-3)
    assert_allclose(seen.camera.fx * (1 + e.focal), true.camera.fx)
    assert abs(e.focal) > 1e-3
    both = np.isfinite(true.depth_m) & np.isfinite(seen.depth_m)
    assert both.mean() > 0.5
    again_m = seen.depth_m[both] * (1 + e.depth_scale) + e.depth_bias_m
    assert_allclose(again_m, true.depth_m[both], rtol=1e-5)


def test_the_measured_gripper_comes_from_angles_with_offsets(perfect, erring):
    q_true, q = perfect.arm.measured_joints()[0], erring.arm.measured_joints()[0]
    assert_allclose(q - q_true, erring.rig.joint_offsets_rad, atol=1e-12)
    measured, true = erring.arm.T_world_gripper(), erring.true_T_world_gripper()
    assert true.equals(perfect.arm.T_world_gripper(), 1e-9)
    assert 1e-3 < np.linalg.norm(measured.translation() - true.translation()) < 0.05


def test_the_robot_is_masked_where_it_is_believed_to_be(perfect, erring):
    """By the believed camera and the measured joints, as a real one has to."""
    true, believed = (np.isfinite(e.camera.robot_depth()) for e in (perfect, erring))
    assert 0.5 < (true & believed).sum() / (true | believed).sum() < 0.995


def test_errors_are_the_seeds_and_as_large_as_said():
    assert RigErrors().drawn(1).camera == RigErrors().drawn(1).camera != RigErrors().drawn(2).camera
    rigs = [RigErrors().drawn(seed) for seed in range(400)]
    etas = np.array([rig.camera.eta for rig in rigs])
    rest = np.array([[r.camera.focal, r.camera.depth_scale, r.camera.depth_bias_m] for r in rigs])
    joints = np.array([rig.joint_offsets_rad for rig in rigs])
    want = [np.radians(0.1)] * 3 + [1e-3] * 3
    for drawn, sd in ((etas, want), (rest, [0.002, 0.01, 1e-3]), (joints, [np.radians(0.05)] * 7)):
        assert_allclose(drawn.std(axis=0), sd, rtol=0.15)  # 400 draws: 3.5 %, four times that
        assert (np.abs(drawn.mean(axis=0)) < 4 * np.array(sd) / 20).all()


def test_a_perfect_rig_says_nothing_of_its_calibration(perfect, erring):
    assert perfect.calibration is None
    assert perfect.rig.camera == CameraErrors() and not perfect.rig.joint_offsets_rad.any()
    assert_allclose(np.diag(erring.calibration.cov_world_cam)[3:], 1e-4)
    assert erring.calibration.depth_scale_sd == 0.02


def test_a_point_is_seen_where_the_errors_put_it():
    """By hand: depth 2 m measured as (2 - 0.1) / 1.25, focal length 110 taken for 100."""
    camera = PinholeCamera(2, 1, 110.0, 110.0, 0.0, 0.0)
    depth_m = np.full((1, 2), 2.0, dtype=np.float32)
    frame = RgbdFrame(0.0, np.zeros((1, 2, 3), np.uint8), depth_m, camera, gtsam.Pose3())
    eta = (0.0, 0.0, 0.0, 0.0, 0.0, 0.5)
    seen = CameraErrors(eta, 0.1, 0.25, 0.1).seen(frame)
    assert_allclose(seen.depth_m, 1.52, rtol=1e-6)
    assert_allclose([seen.camera.fx, seen.camera.fy], 100.0)
    assert_allclose(seen.T_world_cam.translation(), [0.0, 0.0, -0.5])


def test_errors_below_nothing_are_refused():
    with pytest.raises(ValueError, match="focal is -1"):
        RigErrors(focal=-1.0)
