"""What the hand is asked to do along a path."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from akm_fg.arm.body.kinematics import DDDQ_MAX, DDQ_MAX, DQ_MAX, Q_HOME, FrankaKinematics
from akm_fg.arm.motion.reference import (
    ReferenceConfig,
    pose_reference,
    within_joint_limits,
)
from akm_fg.arm.motion.time_law import duration_s
from akm_fg.records import HandPath, WayLimits

STEP_S = 1e-3


def lasting(duration_s: float) -> WayLimits:
    """Of a way from 0 to 1: with speed and acceleration free it takes (32 / j)^(1/3)."""
    return WayLimits(1e4 / duration_s, 1e6 / duration_s**2, 32.0 / duration_s**3)


def door_path(duration_s: float, angle: float = 0.6, count: int = 12) -> HandPath:
    """The home pose swung about an upright axis 0.4 m beside it, in even steps."""
    home = FrankaKinematics().T_world_gripper(Q_HOME)
    pivot = gtsam.Pose3(gtsam.Rot3(), home.translation() + np.array([0.0, 0.4, 0.0]))
    poses = [
        pivot * gtsam.Pose3(gtsam.Rot3.Rz(a), np.zeros(3)) * pivot.inverse() * home
        for a in np.linspace(0.0, -angle, count)
    ]
    return HandPath(np.linspace(0.0, 1.0, count), tuple(poses), lasting(duration_s))


def test_it_passes_through_every_pose_within_the_ways_limits_and_rests_at_both_ends():
    path = door_path(3.0)
    reference = pose_reference(path, path.T_world_gripper[0].matrix(), STEP_S)
    assert len(reference) == 3001
    for s, T in zip(path.way, path.T_world_gripper, strict=True):
        k = int(np.abs(reference.law[:, 0, 0] - s).argmin())
        np.testing.assert_allclose(reference.p_world[k], T.translation(), atol=2e-4)
        np.testing.assert_allclose(reference.R_world[k], T.rotation().matrix(), atol=1e-3)
    speeds = np.linalg.norm(reference.twist[:, :3], axis=1)
    assert speeds[[0, -1]].max() < 1e-4 and speeds.max() > 0.07
    jerks = np.diff(reference.law[:, 2, 0]) / STEP_S
    assert np.abs(jerks).max() <= 1.001 * path.limits.jerk
    np.testing.assert_allclose(np.linalg.norm(reference.tangent, axis=1), 1.0)


def test_between_control_steps_it_never_jerks_by_more_than_ruckig_was_asked_for():
    """A drawer: third differences of the way itself, at the control rate."""
    poses = tuple(gtsam.Pose3(gtsam.Rot3(), np.array([x, 0.0, 0.0])) for x in (0.0, 0.1, 0.3))
    path = HandPath(np.array([0.0, 0.1, 0.3]), poses, WayLimits(0.1, 0.3, 2.0))
    reference = pose_reference(path, np.eye(4), STEP_S)
    x = reference.p_world[:, 0]
    for n, limit in enumerate((0.1, 0.3, 2.0), start=1):
        assert np.abs(np.diff(x, n)).max() / STEP_S**n <= 1.01 * limit


@pytest.mark.parametrize("step", [1, 400, 1500, 2600])
def test_from_any_step_on_it_can_come_to_rest_without_a_jerk(step: int):
    path = door_path(3.0)
    off = gtsam.Pose3(gtsam.Rot3.Rx(0.1), np.array([0.01, -0.02, 0.005]))
    start = (path.T_world_gripper[0] * off).matrix()
    reference = pose_reference(path, start, STEP_S)
    rest = reference.braked(step)
    np.testing.assert_allclose(rest.p_world[0], reference.p_world[step], atol=1e-12)
    np.testing.assert_allclose(rest.law[0], reference.law[step], atol=1e-12)
    np.testing.assert_allclose(rest.law[-1, 1:], 0.0, atol=1e-9)
    assert rest.law[-1, 0, 0] <= 1.0 + 1e-9  # no farther than the path goes
    assert np.abs(np.diff(rest.law[:, 2, 0])).max() / STEP_S <= 1.001 * path.limits.jerk
    assert len(rest) < len(reference) - step + 2


def test_twist_is_the_derivative_of_the_pose():
    path = door_path(3.0)
    reference = pose_reference(path, path.T_world_gripper[0].matrix(), STEP_S)
    turn = gtsam.Rot3(reference.R_world[1501] @ reference.R_world[1500].T)
    angular = gtsam.Rot3.Logmap(turn) / STEP_S
    np.testing.assert_allclose(reference.twist[1500, 3:], angular, atol=1e-9)
    np.testing.assert_allclose(
        reference.twist[1500, :3], (reference.p_world[1501] - reference.p_world[1500]) / STEP_S
    )
    # And the speed of the law is that of the pose: both are what ruckig said.
    way = float(np.linalg.norm(reference.twist[1500, :3])) / (0.6 * 0.4)
    assert reference.law[1500, 1, 0] == pytest.approx(way, rel=1e-3)


def test_it_begins_where_the_hand_is_and_joins_the_path():
    path = door_path(3.0)
    off = gtsam.Pose3(gtsam.Rot3.Rx(0.1), np.array([0.01, -0.02, 0.005]))
    start = path.T_world_gripper[0] * off
    reference = pose_reference(path, start.matrix(), STEP_S)
    straight = pose_reference(path, path.T_world_gripper[0].matrix(), STEP_S)
    np.testing.assert_allclose(reference.p_world[0], start.translation())
    np.testing.assert_allclose(reference.R_world[0], start.rotation().matrix(), atol=1e-12)
    np.testing.assert_allclose(reference.p_world[900:], straight.p_world[900:], atol=1e-9)
    np.testing.assert_allclose(reference.R_world[900:], straight.R_world[900:], atol=1e-9)


def test_a_single_pose_is_gone_to():
    T = FrankaKinematics().T_world_gripper(Q_HOME)
    start = T * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -0.02]))
    reference = pose_reference(HandPath(np.zeros(1), (T,), lasting(1.0)), start.matrix(), STEP_S)
    np.testing.assert_allclose(reference.p_world[[0, -1]], [start.translation(), T.translation()])


def largest_shares(kinematics: FrankaKinematics, path: HandPath) -> np.ndarray:
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
    slow = replace(door_path(4.0), limits=WayLimits(0.4, 0.4, 1.0))
    assert within_joint_limits(kinematics, slow, Q_HOME) is slow
    path = within_joint_limits(kinematics, door_path(0.1), Q_HOME)
    assert path is not None and duration_s(path) > 0.2
    assert (largest_shares(kinematics, path) < 1.0).all()


@pytest.mark.parametrize(
    ("duration_s", "angle", "count"), [(0.2, 0.05, 2), (0.05, 0.01, 2), (0.1, 0.05, 40)]
)
def test_a_twitch_that_is_slow_enough_but_begins_too_suddenly_is_slowed_down(
    duration_s: float, angle: float, count: int
):
    kinematics, path = FrankaKinematics(), door_path(duration_s, angle, count)
    slowed = within_joint_limits(kinematics, path, Q_HOME)
    assert slowed is not None
    assert (largest_shares(kinematics, slowed) < 1.0).all()


def test_a_path_out_of_reach_is_none():
    far = gtsam.Pose3(gtsam.Rot3(), np.array([1.5, 0.0, 0.5]))
    here = FrankaKinematics().T_world_gripper(Q_HOME)
    path = HandPath(np.array([0.0, 1.0]), (here, far), lasting(1.0))
    assert within_joint_limits(FrankaKinematics(), path, Q_HOME) is None


def test_tangents_are_there_where_the_hand_stands_and_none_where_it_only_turns():
    T = FrankaKinematics().T_world_gripper(Q_HOME)
    ahead = T * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 0.05]))
    path = HandPath(np.array([0.0, 1.0]), (T, ahead), lasting(1.0))
    reference = pose_reference(path, T.matrix(), STEP_S)
    z = T.rotation().matrix()[:, 2]
    np.testing.assert_allclose(reference.tangent @ z, 1.0)
    turned = T * gtsam.Pose3(gtsam.Rot3.Rz(0.3), np.zeros(3))
    path = HandPath(np.array([0.0, 1.0]), (T, turned), lasting(1.0))
    assert (pose_reference(path, T.matrix(), STEP_S).tangent == 0.0).all()


def test_a_hand_off_the_path_joins_it_from_rest_without_a_jerk():
    T = FrankaKinematics().T_world_gripper(Q_HOME)
    start = T * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -0.02]))
    config = ReferenceConfig()
    path = HandPath(np.zeros(1), (T,), lasting(1.0))
    reference = pose_reference(path, start.matrix(), STEP_S, config)
    p, most = reference.p_world, config.join_m
    for n, limit in enumerate((most.speed, most.acceleration, most.jerk), start=1):
        assert np.abs(np.diff(p, n, axis=0)).max() / STEP_S**n <= 1.01 * limit
    assert len(reference) * STEP_S < 1.0


FREE = WayLimits(1e4, 1e6, 1e9)


@pytest.mark.parametrize("path", [door_path(1.0, 0.02, 41), door_path(1.0, 0.6, 41)])
def test_speed_acceleration_and_jerk_of_every_joint_stay_within_their_shares(path: HandPath):
    """By the chain rule, with the joints' angles along the way by inverse kinematics."""
    kinematics, path = FrankaKinematics(), replace(path, limits=FREE)
    slowed = within_joint_limits(kinematics, path, Q_HOME)
    assert slowed is not None
    v, a, j = slowed.limits.speed, slowed.limits.acceleration, slowed.limits.jerk
    q, angles = Q_HOME, []
    for T in path.T_world_gripper:
        q = kinematics.solve(T, q)
        angles.append(q)
    spline, s = CubicSpline(path.way, np.array(angles)), np.linspace(0.0, 1.0, 500)
    d1, d2, d3 = (np.abs(spline(s, n)) for n in (1, 2, 3))
    shares = [
        (d1 * v / DQ_MAX).max(),
        ((d2 * v**2 + d1 * a) / DDQ_MAX).max(),
        ((d3 * v**3 + 3.0 * d2 * v * a + d1 * j) / DDDQ_MAX).max(),
    ]
    # The third derivative of a spline is a step function: not the same through other poses.
    assert max(shares[:2]) < 0.81 and shares[2] < 0.9
    assert (d1 * j / DDDQ_MAX).max() < 0.272  # a third of 0.8
    assert max(shares) > 0.3  # and it is not much slower than it need be
