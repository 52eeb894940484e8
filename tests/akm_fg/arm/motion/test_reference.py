"""What the hand is asked to do along a timed path."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from akm_fg.arm.body.kinematics import Q_HOME, FrankaKinematics
from akm_fg.arm.motion.reference import pose_reference, within_joint_limits
from akm_fg.records import TimedPath

STEP_S = 1e-3


def door_path(duration_s: float, angle: float = 0.6, count: int = 12) -> TimedPath:
    """The home pose swung about an upright axis 0.4 m beside it, in even steps."""
    home = FrankaKinematics().T_world_gripper(Q_HOME)
    pivot = gtsam.Pose3(gtsam.Rot3(), home.translation() + np.array([0.0, 0.4, 0.0]))
    poses = [
        pivot * gtsam.Pose3(gtsam.Rot3.Rz(a), np.zeros(3)) * pivot.inverse() * home
        for a in np.linspace(0.0, -angle, count)
    ]
    return TimedPath(np.linspace(0.0, duration_s, count), tuple(poses))


def test_it_passes_through_every_pose_at_its_time_and_rests_at_both_ends():
    path = door_path(3.0)
    reference = pose_reference(path, path.T_world_gripper[0].matrix(), STEP_S)
    for stamp, T in zip(path.stamps_s, path.T_world_gripper, strict=True):
        k = round(float(stamp) / STEP_S)
        np.testing.assert_allclose(reference.p_world[k], T.translation(), atol=1e-4)
        np.testing.assert_allclose(reference.R_world[k], T.rotation().matrix(), atol=1e-3)
    speeds = np.linalg.norm(reference.twist[:, :3], axis=1)
    assert speeds[[0, -1]].max() < 2e-3 and speeds.max() > 0.07
    accelerations = np.diff(reference.twist, axis=0) / STEP_S
    assert np.abs(accelerations[:, :3]).max() < 1.5  # the straight legs would ask for 20 m/s^2
    np.testing.assert_allclose(np.linalg.norm(reference.tangent, axis=1), 1.0)


def test_twist_is_the_derivative_of_the_pose():
    path = door_path(3.0)
    reference = pose_reference(path, path.T_world_gripper[0].matrix(), STEP_S)
    turn = gtsam.Rot3(reference.R_world[1501] @ reference.R_world[1500].T)
    angular = gtsam.Rot3.Logmap(turn) / STEP_S
    np.testing.assert_allclose(reference.twist[1500, 3:], angular, atol=1e-9)
    np.testing.assert_allclose(
        reference.twist[1500, :3], (reference.p_world[1501] - reference.p_world[1500]) / STEP_S
    )


def test_it_begins_where_the_hand_is_and_joins_the_path():
    path = door_path(3.0)
    off = gtsam.Pose3(gtsam.Rot3.Rx(0.1), np.array([0.01, -0.02, 0.005]))
    start = path.T_world_gripper[0] * off
    reference = pose_reference(path, start.matrix(), STEP_S, blend_s=0.5)
    straight = pose_reference(path, path.T_world_gripper[0].matrix(), STEP_S)
    np.testing.assert_allclose(reference.p_world[0], start.translation())
    np.testing.assert_allclose(reference.R_world[0], start.rotation().matrix(), atol=1e-12)
    np.testing.assert_allclose(reference.p_world[500:], straight.p_world[500:], atol=1e-12)
    np.testing.assert_allclose(reference.R_world[500:], straight.R_world[500:], atol=1e-12)


def test_a_single_pose_is_gone_to():
    T = FrankaKinematics().T_world_gripper(Q_HOME)
    start = T * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -0.02]))
    reference = pose_reference(TimedPath(np.zeros(1), (T,)), start.matrix(), STEP_S)
    np.testing.assert_allclose(reference.p_world[[0, -1]], [start.translation(), T.translation()])


def largest_shares(kinematics: FrankaKinematics, path: TimedPath) -> np.ndarray:
    """Of Franka's limits, of joint speed, acceleration and jerk along the path's reference.

    From rest to rest by resolved rates: the joints' own way. The figures are those of the Franka
    Control Interface documentation, "Robot and interface specifications", Panda.
    """
    reference = pose_reference(path, path.T_world_gripper[0].matrix(), STEP_S)
    q, dq = Q_HOME.copy(), [np.zeros(7)]
    for twist in reference.twist:
        J = kinematics.update(q)[1]
        dq.append(np.linalg.pinv(J) @ twist)
        q = q + STEP_S * dq[-1]
    rates = np.array([*dq, np.zeros(7)])
    limits = (
        np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]),
        np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]),
        np.array([7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0]),
    )
    return np.array(
        [
            (np.abs(np.diff(rates, n, axis=0)) / STEP_S**n / limit).max()
            for n, limit in enumerate(limits)
        ]
    )


def test_a_path_too_fast_for_the_joints_is_slowed_down_and_a_slow_one_is_not():
    kinematics = FrankaKinematics()
    slow = door_path(4.0)
    assert within_joint_limits(kinematics, slow, Q_HOME, STEP_S) is slow
    path = within_joint_limits(kinematics, door_path(0.1), Q_HOME, STEP_S)
    assert path is not None and path.stamps_s[-1] > 0.2
    assert (largest_shares(kinematics, path) < 1.0).all()


@pytest.mark.parametrize(
    ("duration_s", "angle", "count"), [(0.2, 0.05, 2), (0.05, 0.01, 2), (0.1, 0.05, 40)]
)
def test_a_twitch_that_is_slow_enough_but_begins_too_suddenly_is_slowed_down(
    duration_s: float, angle: float, count: int
):
    """Accelerations begin within one control step: 0.8 of their limits would be too much jerk."""
    kinematics, path = FrankaKinematics(), door_path(duration_s, angle, count)
    slowed = within_joint_limits(kinematics, path, Q_HOME, STEP_S)
    assert slowed is not None
    assert (largest_shares(kinematics, slowed) < 1.0).all()


def test_a_path_out_of_reach_is_none():
    far = gtsam.Pose3(gtsam.Rot3(), np.array([1.5, 0.0, 0.5]))
    here = FrankaKinematics().T_world_gripper(Q_HOME)
    path = TimedPath(np.array([0.0, 1.0]), (here, far))
    assert within_joint_limits(FrankaKinematics(), path, Q_HOME, STEP_S) is None


def test_tangents_stay_what_they_were_where_the_path_stands():
    T = FrankaKinematics().T_world_gripper(Q_HOME)
    ahead = T * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 0.05]))
    path = TimedPath(np.array([0.0, 1.0, 2.0]), (T, ahead, ahead))
    reference = pose_reference(path, T.matrix(), STEP_S)
    z = T.rotation().matrix()[:, 2]
    assert reference.tangent[0] @ z == pytest.approx(1.0)
    assert abs(reference.tangent[-1] @ z) == pytest.approx(1.0)


def test_a_hand_off_the_path_joins_it_from_rest_without_a_jerk():
    """A quintic over d in T accelerates by at most 10 / sqrt(3) d / T^2: 0.46 m/s^2 for 2 cm."""
    T = FrankaKinematics().T_world_gripper(Q_HOME)
    start = T * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -0.02]))
    reference = pose_reference(TimedPath(np.zeros(1), (T,)), start.matrix(), STEP_S, blend_s=0.5)
    speed = reference.twist[:, :3]
    acceleration = np.diff(np.vstack([np.zeros(3), speed]), axis=0) / STEP_S
    most = 10.0 / np.sqrt(3.0) * 0.02 / 0.5**2
    assert np.linalg.norm(acceleration, axis=1).max() < 1.02 * most
    assert np.linalg.norm(speed, axis=1).max() == pytest.approx(15.0 / 8.0 * 0.02 / 0.5, rel=0.01)
