"""The simulated board is drawn where the truth says, and shown in poses that calibrate."""

from dataclasses import replace
from itertools import product

import cv2
import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.errors import MotionInfeasible
from sim.camera.charuco_board import (
    BoardRig,
    PoseConfig,
    board_shots,
    open_board_rig,
    reported,
    sample_configurations,
)
from sim.camera.charuco_plate import PlateSpec

SCENE = "furniture-dev/door-003"
CONFIG = PoseConfig(views=2, supersample=3)  # drawn three times larger: half a second a view


@pytest.fixture(scope="module")
def rig():
    with open_board_rig(SCENE, seed=0, noise="clean", config=CONFIG) as opened:
        yield opened


@pytest.fixture(scope="module")
def shots(rig):
    """Each with the true T_world_gripper, rebuilt from the same random numbers."""
    return list(board_shots(rig, seed=0, config=replace(CONFIG, repeat_mm=0.0, repeat_deg=0.0)))


def _corners_px(rig: BoardRig, T_world_gripper: gtsam.Pose3) -> np.ndarray:
    """Where all inner corners must be in the image, row by row."""
    spec: PlateSpec = rig.spec
    x, y = np.meshgrid(np.arange(1, spec.squares_x), np.arange(1, spec.squares_y))
    p_board = spec.square_m * np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=-1)
    T = rig.truth.T_world_cam.inverse() * T_world_gripper * rig.truth.T_gripper_board
    return rig.truth.camera.project(np.array([T.transformFrom(p) for p in p_board]))


def test_corners_are_drawn_where_the_truth_says(rig, shots):
    spec, errors = rig.spec, []
    board = cv2.aruco.CharucoBoard(
        (spec.squares_x, spec.squares_y),
        spec.square_m,
        spec.marker_m,
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec.dictionary)),
    )
    detector = cv2.aruco.CharucoDetector(board)
    for shot in shots:
        uv, ids, _, _ = detector.detectBoard(cv2.cvtColor(shot.frame.rgb, cv2.COLOR_RGB2GRAY))
        errors.append(uv.reshape(-1, 2) - _corners_px(rig, shot.T_world_gripper)[ids.ravel()])
    all_errors = np.concatenate(errors)
    assert len(all_errors) > 0.9 * 40 * len(shots)
    assert_allclose(np.median(all_errors, axis=0), 0.0, atol=0.03)
    assert np.sqrt((all_errors**2).mean()) < 0.15


def test_depth_of_the_board_is_that_of_its_plane(rig, shots):
    shot = shots[0]
    T_cam_board = rig.truth.T_world_cam.inverse() * shot.T_world_gripper * rig.truth.T_gripper_board
    uv = _corners_px(rig, shot.T_world_gripper)
    at = np.rint(uv).astype(int)
    depth_m = shot.frame.depth_m[at[:, 1], at[:, 0]].astype(float)
    p_cam = shot.frame.camera.back_project(at.astype(float), depth_m)
    height = np.array([T_cam_board.transformTo(p)[2] for p in p_cam])
    assert np.isfinite(height).mean() > 0.8
    assert_allclose(height[np.isfinite(height)], 0.0, atol=5e-4)


def test_the_board_is_whole_in_every_image_and_touches_nothing(rig):
    rng = np.random.default_rng(7)
    for q in sample_configurations(rig, CONFIG, rng):
        uv = _corners_px(rig, rig.world.kinematics.T_world_gripper(q))
        assert (uv > CONFIG.border_px).all()
        assert (uv < np.array([640, 480]) - CONFIG.border_px).all()
        assert rig.is_free(CONFIG.clearance_m)


def test_a_board_inside_the_furniture_is_noticed(rig):
    world = rig.world
    front = world.placement.T_world_object
    found = False
    place = world.built.p_object_front - np.array([0.0, 0.1, 0.0])
    for tilt_deg, turn in product((-60.0, -90.0, -120.0), np.linspace(0, 2 * np.pi, 7)):
        into = front * gtsam.Pose3(gtsam.Rot3.Rx(np.deg2rad(tilt_deg)), place)
        q = world.kinematics.solve(
            into * gtsam.Pose3(gtsam.Rot3.Rz(turn), np.zeros(3)), np.zeros(7)
        )
        if q is not None:
            rig.put(q)
            found = True
            assert not rig.is_free(CONFIG.clearance_m)
    assert found


def test_reported_poses_err_as_stated():
    config, rng = PoseConfig(repeat_mm=0.2, repeat_deg=0.1), np.random.default_rng(0)
    T = gtsam.Pose3(gtsam.Rot3.Rx(1.0), np.array([0.3, 0.2, 0.1]))
    xi = np.array([gtsam.Pose3.Logmap(T.between(reported(T, config, rng))) for _ in range(500)])
    assert_allclose(np.rad2deg(xi[:, :3].std()), 0.1, rtol=0.08)
    assert_allclose(1e3 * xi[:, 3:].std(), 0.2, rtol=0.08)


def test_the_same_seed_gives_the_same_poses_and_another_seed_others(rig):
    def poses(seed):
        rng = np.random.default_rng(seed)
        return np.array(list(sample_configurations(rig, replace(CONFIG, views=1), rng)))

    first = poses(3)
    assert_allclose(first, poses(3), atol=0.0)
    assert not np.allclose(first, poses(4))


def test_a_board_out_of_reach_is_an_error_not_a_short_recording(rig):
    far = replace(CONFIG, distance_m=(3.0, 4.0), tries=50)
    with pytest.raises(MotionInfeasible, match=r"only 0 of 2 poses"):
        list(sample_configurations(rig, far, np.random.default_rng(0)))
