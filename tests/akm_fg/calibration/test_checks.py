"""Data that do not suffice, or contradict the board, get one line that says why."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.calibration.calibrate import calibrate
from akm_fg.calibration.checks import require_turns
from akm_fg.calibration.records import CalibrationConfig
from akm_fg.errors import AxisUnobservable, InputError

SLANTED = gtsam.Rot3.Expmap(np.array([0.3, -0.5, 0.2]))


def _turned(data, axis, angles_rad):
    """The same data with gripper poses R0 * Exp(angle * axis)."""
    views = [
        replace(
            view, T_world_gripper=gtsam.Pose3(SLANTED * gtsam.Rot3.Expmap(a * axis), 0.1 * axis)
        )
        for view, a in zip(data.views, angles_rad, strict=False)
    ]
    return replace(data, views=tuple(views))


@pytest.mark.parametrize("seen", [1, 2])
def test_fewer_views_than_three_are_refused(synthetic, seen):
    data, _ = synthetic(views=3)
    few = replace(data, views=data.views[:seen], skipped=(5, 6))
    with pytest.raises(InputError, match=rf"seen in {seen} of {seen + 2} images; expected 3"):
        calibrate(few)


def test_poses_that_turn_about_one_axis_leave_the_camera_open_along_it(synthetic):
    """Seen from the world, the open direction is the common axis R a."""
    data, _ = synthetic(views=8)
    axis = np.array([0.0, 0.0, 1.0])
    way = SLANTED.matrix() @ axis
    name = r"\(" + ", ".join(f"{x:.2f}" for x in way) + r"\)"
    with pytest.raises(
        AxisUnobservable, match=rf"translation of T_world_cam along {name} in world"
    ):
        calibrate(_turned(data, axis, np.linspace(-0.5, 0.5, 8)))


def test_poses_that_never_turn_leave_it_open_everywhere(synthetic):
    data, _ = synthetic(views=8)
    with pytest.raises(AxisUnobservable, match=r"T_world_cam is open in every direction"):
        calibrate(_turned(data, np.array([1.0, 0.0, 0.0]), np.zeros(8)))


def test_a_board_turned_in_its_plane_alone_is_refused_before_it_is_fitted(synthetic):
    data, _ = synthetic(views=10, roll_only=True)
    with pytest.raises(AxisUnobservable, match=r"along .* is open"):
        calibrate(data)


def test_of_a_camera_in_the_gripper_the_gripper_axes_are_named(synthetic):
    data, _ = synthetic(views=8, camera_place="gripper")
    turned = _turned(data, np.array([0.0, 1.0, 0.0]), np.linspace(-0.5, 0.5, 8))
    with pytest.raises(
        AxisUnobservable, match=r"T_gripper_cam along \(0\.00, 1\.00, 0\.00\) in gripper axes"
    ):
        calibrate(turned, CalibrationConfig(camera_place="gripper"))


def test_poses_that_hardly_turn_about_a_second_axis_are_told(synthetic):
    data, _ = synthetic(views=8)
    poses = [
        SLANTED * gtsam.Rot3.Rz(a) * gtsam.Rot3.Rx(b)
        for a, b in zip(
            np.linspace(-0.6, 0.6, 8), np.deg2rad(4.0) * (-1.0) ** np.arange(8), strict=True
        )
    ]
    views = [
        replace(view, T_world_gripper=gtsam.Pose3(R, np.zeros(3)))
        for view, R in zip(data.views, poses, strict=True)
    ]
    (told,) = require_turns(replace(data, views=tuple(views)), CalibrationConfig())
    assert "T_world_cam is weakest along it" in told


def test_well_spread_poses_pass_without_a_word(synthetic):
    assert require_turns(synthetic(views=8)[0], CalibrationConfig()) == ()


@pytest.mark.parametrize("place", ["fixed", "gripper"])
@pytest.mark.parametrize("said_m", [0.036, 0.044])
def test_a_wrong_size_of_the_squares_is_found_by_the_robots_motion(
    synthetic, with_board, said_m, place
):
    data, _ = synthetic(views=10, camera_place=place)
    wrong = with_board(data, square_m=said_m)
    config = CalibrationConfig(camera_place=place)
    with pytest.raises(
        InputError, match=rf"says {1e3 * said_m:g} mm, .* it is (39\.9\d*|40|40\.\d+) mm"
    ):
        calibrate(wrong, config)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"robot_sd_m": 0.0}, "robot_sd_m is 0"),
        ({"robot_sd_rad": np.nan}, "robot_sd_rad is nan"),
        ({"dof": 0.0}, "dof is 0"),
        ({"corner_scale_px": -1.0}, "corner_scale_px is -1"),
    ],
)
def test_settings_without_sense_are_refused(setting, message):
    with pytest.raises(ValueError, match=message):
        CalibrationConfig(**setting)
