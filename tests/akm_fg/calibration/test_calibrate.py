"""Camera and hand-eye from corners and poses: the truth comes back, and so does the noise."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.calibration.calibrate import calibrate
from akm_fg.calibration.graph import robot_noise
from akm_fg.calibration.records import CalibrationConfig
from factors.finite_differences import central_difference

PINHOLE = (0.0, 0.0, 0.0, 0.0)


def _pose_error(result, truth):
    """Of the camera, on its own tangent: (rotation, rad), (translation, m)."""
    xi = gtsam.Pose3.Logmap(result.T_mount_cam.between(truth.T_mount_cam))
    return xi[:3], xi[3:]


def _intrinsics_error(result, truth):
    found, real = result.camera, truth.camera
    pinhole = [getattr(real, n) - getattr(found, n) for n in ("fx", "fy", "cx", "cy")]
    return np.r_[pinhole, truth.distortion - result.distortion]


@pytest.mark.parametrize("place", ["fixed", "gripper"])
def test_exact_corners_and_poses_give_the_truth_back(synthetic, place):
    data, truth = synthetic(views=8, sd_px=0.0, robot_sd=(0.0, 0.0), camera_place=place)
    result = calibrate(data, CalibrationConfig(camera_place=place, corner_scale_px=0.1))
    assert_allclose(np.concatenate(_pose_error(result, truth)), 0.0, atol=1e-6)
    board = gtsam.Pose3.Logmap(result.T_holder_board.between(truth.T_holder_board))
    assert_allclose(board, 0.0, atol=1e-6)
    assert_allclose(_intrinsics_error(result, truth)[:4], 0.0, atol=1e-3)
    assert_allclose(result.distortion, truth.distortion, atol=1e-5)
    assert result.rms_px < 1e-4 and not result.warnings


def test_noisy_views_give_the_camera_within_a_millimetre_and_a_tenth_of_a_degree(synthetic):
    data, truth = synthetic(views=25, sd_px=0.07, dof=6.0)
    result = calibrate(data)
    turn, place = _pose_error(result, truth)
    assert np.linalg.norm(place) < 1e-3
    assert np.rad2deg(np.linalg.norm(turn)) < 0.1
    assert_allclose(result.corner_scale_px, 0.07, rtol=0.1)
    assert not result.warnings


def test_intrinsics_that_are_kept_stay_and_have_no_covariance(synthetic):
    data, truth = synthetic(views=8, lens=PINHOLE)
    data = replace(data, camera=truth.camera)
    result = calibrate(data, CalibrationConfig(fixed_intrinsics=True))
    assert_allclose(_intrinsics_error(result, truth), 0.0, atol=1e-4)
    assert not result.intrinsics_cov.any()
    free = calibrate(data, CalibrationConfig(distortion=False))
    assert free.intrinsics_cov[:4, :4].any() and not free.intrinsics_cov[4:].any()
    assert_allclose(free.distortion, 0.0, atol=1e-5)
    assert np.trace(free.T_mount_cam_cov) > np.trace(result.T_mount_cam_cov)


def test_corners_gone_astray_cost_themselves_alone(synthetic):
    data, truth = synthetic(views=12)
    clean = calibrate(data)
    views = list(data.views)
    for i in (2, 5, 9):
        uv = views[i].uv.copy()
        uv[::6] += [25.0, -40.0]
        views[i] = replace(views[i], uv=uv)
    spoilt = calibrate(replace(data, views=tuple(views)))
    moved = gtsam.Pose3.Logmap(clean.T_mount_cam.between(spoilt.T_mount_cam))
    assert moved @ np.linalg.solve(clean.T_mount_cam_cov, moved) < 6.0
    assert spoilt.rms_px > 5.0 * clean.rms_px
    assert np.linalg.norm(_pose_error(spoilt, truth)[1]) < 2e-3


def test_with_sure_corners_the_camera_is_as_unsure_as_the_arm(synthetic):
    """The robot's poses alone limit it then: twice their noise is twice its deviation."""
    data, truth = synthetic(views=10, sd_px=1e-4, lens=PINHOLE)
    data = replace(data, camera=truth.camera)
    sds = []
    for factor in (1.0, 2.0):
        config = CalibrationConfig(
            fixed_intrinsics=True,
            robot_sd_m=factor * 1e-4,
            robot_sd_rad=factor * 1e-3,
            corner_scale_px=1e-4,
        )
        sds.append(np.sqrt(np.diag(calibrate(data, config).T_mount_cam_cov)))
    assert_allclose(sds[1], 2.0 * sds[0], rtol=1e-2)


@pytest.mark.parametrize(("worse", "told"), [(1.0, False), (4.0, True)])
def test_an_arm_that_is_worse_than_stated_is_told(synthetic, worse, told):
    stated = np.array([1e-4, np.deg2rad(0.05)])
    data, _ = synthetic(views=12, robot_sd=tuple(worse * stated))
    warnings = calibrate(data).warnings
    assert any("state what the arm really repeats to" in w for w in warnings) == told


def test_few_views_of_a_small_part_say_which_direction_is_weak(synthetic):
    data, _ = synthetic(views=4, sd_px=0.8)
    warnings = calibrate(data).warnings
    assert any(w.startswith("T_world_cam: its rotation about") for w in warnings)


@pytest.mark.parametrize("place", ["fixed", "gripper"])
def test_the_arm_errs_in_the_axes_of_its_gripper_wherever_the_camera_is(place):
    """Covariance on the tangent of T_mount_holder against differences of the reported pose."""
    G = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.4, -0.9, 0.6])), np.array([0.5, -0.2, 0.4]))
    config = CalibrationConfig(place, robot_sd_m=2e-3, robot_sd_rad=0.01)
    reported = G if place == "fixed" else G.inverse()

    def moved(xi):
        true = G * gtsam.Pose3.Expmap(xi)
        return gtsam.Pose3.Logmap(reported.between(true if place == "fixed" else true.inverse()))

    J = central_difference(moved, np.zeros(6))
    want = J @ np.diag(np.repeat([0.01**2, 2e-3**2], 3)) @ J.T
    assert_allclose(robot_noise(reported, config).covariance(), want, rtol=1e-6, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("place", ["fixed", "gripper"])
@pytest.mark.parametrize("sd_px", [0.05, 0.3])
def test_the_camera_errs_as_much_as_its_covariance_says(synthetic, place, sd_px):
    """Mean NEES of pose and of intrinsics over 120 calibrations, 99.9 % bands."""
    trials, pose_nees, lens_nees = 120, [], []
    for seed in range(trials):
        data, truth = synthetic(seed=seed, views=15, sd_px=sd_px, camera_place=place)
        result = calibrate(data, CalibrationConfig(camera_place=place))
        xi = np.concatenate(_pose_error(result, truth))
        pose_nees.append(xi @ np.linalg.solve(result.T_mount_cam_cov, xi))
        lens = _intrinsics_error(result, truth)
        lens_nees.append(lens @ np.linalg.solve(result.intrinsics_cov, lens))
    for nees, dof in ((pose_nees, 6), (lens_nees, 8)):
        low, high = stats.chi2.ppf([0.0005, 0.9995], dof * trials) / trials
        print(f"{place}, {sd_px} px: NEES {np.mean(nees):.2f}, band {low:.2f} to {high:.2f}")
        assert low < np.mean(nees) < high
