"""Robot poses that do not belong to the images: one line with the likely cause, or left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.calibration.calibrate import calibrate
from akm_fg.calibration.consistency import agreeing_views
from akm_fg.calibration.initial import views_alone
from akm_fg.calibration.records import CalibrationConfig, CalibrationViews
from akm_fg.errors import InputError

Poses = list[gtsam.Pose3]
VIEWS = 12
OFF = gtsam.Pose3(gtsam.Rot3.Rx(0.1), np.array([0.02, 0.0, 0.01]))


def with_poses(data: CalibrationViews, change: Callable[[Poses], Poses]) -> CalibrationViews:
    poses = change([view.T_world_gripper for view in data.views])
    views = zip(data.views, poses, strict=True)
    return replace(data, views=tuple(replace(v, T_world_gripper=T) for v, T in views))


SLIPS: dict[str, tuple[Callable[[Poses], Poses], str]] = {
    "mm": (
        lambda Ts: [gtsam.Pose3(T.rotation(), 1e3 * T.translation()) for T in Ts],
        "T_world_gripper is likely in millimetres",
    ),
    "after": (lambda Ts: Ts[1:] + Ts[:1], "each pose is that of the image after it"),
    "before": (lambda Ts: Ts[-1:] + Ts[:-1], "each pose is that of the image before it"),
    "inverse": (lambda Ts: [T.inverse() for T in Ts], "T_world_gripper is inverted, or --camera"),
    "reversed": (lambda Ts: Ts[::-1], "the poses are in the opposite order"),
    "transposed": (
        lambda Ts: [gtsam.Pose3(T.rotation().inverse(), T.translation()) for T in Ts],
        "the rotations of T_world_gripper are inverted",
    ),
}


@pytest.mark.parametrize("place", ["fixed", "gripper"])
@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_in_all_poses_is_one_line_with_its_cause(synthetic, place: str, slip: str) -> None:
    data, _ = synthetic(seed=3, views=VIEWS, camera_place=place)
    change, words = SLIPS[slip]
    with pytest.raises(InputError) as caught:
        calibrate(with_poses(data, change), CalibrationConfig(camera_place=place))
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("place", ["fixed", "gripper"])
def test_the_wrong_place_of_the_camera_is_named(synthetic, place: str) -> None:
    data, _ = synthetic(seed=4, views=VIEWS, camera_place=place)
    other = "gripper" if place == "fixed" else "fixed"
    with pytest.raises(InputError, match=f"--camera-place is {place}"):
        calibrate(data, CalibrationConfig(camera_place=other))


def test_poses_in_no_order_at_all_are_refused_without_a_guess(synthetic) -> None:
    data, _ = synthetic(seed=5, views=VIEWS)
    order = np.random.default_rng(0).permutation(VIEWS)
    with pytest.raises(InputError, match="do not belong together") as caught:
        calibrate(with_poses(data, lambda Ts: [Ts[i] for i in order]))
    assert "likely" not in str(caught.value)


def test_sound_views_of_a_bad_arm_are_all_kept(synthetic) -> None:
    data, _ = synthetic(seed=6, views=VIEWS, robot_sd=(1e-3, np.deg2rad(0.2)), sd_px=0.3)
    kept, left_out, words = agreeing_views(
        data, CalibrationConfig(), views_alone(data, CalibrationConfig())
    )
    assert kept.all() and not left_out and not words


def test_views_that_do_not_fit_are_named_and_left_out(synthetic) -> None:
    data, truth = synthetic(seed=7, views=VIEWS)

    def spoilt(Ts: Poses) -> Poses:
        Ts[2], Ts[8] = Ts[2] * OFF, Ts[8] * OFF  # grossly
        Ts[5] = Ts[5] * gtsam.Pose3(gtsam.Rot3.Ry(0.01), np.full(3, 0.002))  # a little
        return Ts

    result = calibrate(with_poses(data, spoilt))
    assert [view.frame for view in result.left_out] == [2, 5, 8]
    assert not {2, 5, 8} & {view.frame for view in result.views}
    told = " ".join(result.warnings)
    assert "frames 2 (" in told and "left out; the limit is 10 px" in told
    assert "frames 5 do not fit the others" in told
    xi = gtsam.Pose3.Logmap(result.T_mount_cam.between(truth.T_mount_cam))
    assert np.linalg.norm(xi[3:]) < 5e-3
    assert xi @ np.linalg.solve(result.T_mount_cam_cov, xi) < 30.0


def test_two_poses_that_are_exchanged_are_named(synthetic) -> None:
    data, _ = synthetic(seed=8, views=VIEWS)
    mixed = with_poses(data, lambda Ts: [*Ts[:3], Ts[4], Ts[3], *Ts[5:]])
    kept, left_out, words = agreeing_views(
        mixed, CalibrationConfig(), views_alone(mixed, CalibrationConfig())
    )
    assert [view.frame for view in left_out] == [3, 4] and kept.sum() == VIEWS - 2
    assert "the poses of 3 and 4 are exchanged" in words[0]


def test_corners_that_fit_no_camera_are_refused_with_the_limit(synthetic) -> None:
    data, _ = synthetic(seed=9, views=VIEWS, sd_px=4.0)
    with pytest.raises(InputError, match=r"the limit is 3\.0|do not belong"):
        calibrate(data)
