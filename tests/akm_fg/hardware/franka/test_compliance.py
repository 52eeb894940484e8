"""Springs that exert a law's wrench, straight lines, and legs: without any robot."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="the arm's packages are not installed")
from akm_fg.arm.body.kinematics import DDDQ_MAX, DDQ_MAX, DQ_MAX, rotation_vector
from akm_fg.arm.motion.joint_path import TimeLawConfig
from akm_fg.hardware.franka.compliance import HandState, SpringOfWrench, stretched
from akm_fg.hardware.franka.config import ApproachConfig, SpringConfig
from akm_fg.hardware.franka.legs import leg_limits
from akm_fg.hardware.franka.straight import StraightLine, off_by

SPRING = SpringConfig(400.0, 16.0, 0.18, 0.3)
PERIOD_S = 0.005
HERE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.7, 1.1), np.array([0.5, 0.1, 0.4])).matrix()


def test_the_spring_exerts_the_wrench_that_is_asked_for():
    wrench = np.array([20.0, -10.0, 5.0, 0.5, -0.2, 0.3])
    twist = np.array([0.04, 0.0, -0.02, 0.1, 0.0, -0.05])
    reference = stretched(HandState(0.0, HERE, twist), wrench, SPRING)
    off = reference.T_world_gripper[:3, 3] - HERE[:3, 3]
    force = 400.0 * off - 2.0 * 20.0 * twist[:3]  # critical damping of a unit mass: 2 sqrt(K)
    np.testing.assert_allclose(force, wrench[:3], atol=1e-9)
    turn = rotation_vector(reference.T_world_gripper[:3, :3] @ HERE[:3, :3].T)
    moment = 16.0 * turn - 2.0 * 4.0 * twist[3:]
    np.testing.assert_allclose(moment, wrench[3:], atol=1e-9)


def test_no_wrench_stretches_the_spring_beyond_its_bounds():
    wrench = np.array([1e4, 0.0, 0.0, 0.0, 1e4, 0.0])
    reference = stretched(HandState(0.0, HERE, np.zeros(6)), wrench, SPRING)
    assert np.linalg.norm(reference.T_world_gripper[:3, 3] - HERE[:3, 3]) <= 0.18 + 1e-12
    assert off_by(reference.T_world_gripper, gtsam.Pose3(HERE))[1] <= 0.3 + 1e-9


class ThreeSteps:
    """A law of three steps."""

    def __init__(self):
        self.steps = 0

    @property
    def finished(self):
        return self.steps == 3

    def wrench(self, T, twist, dt):
        assert dt == PERIOD_S
        self.steps += 1
        return np.zeros(6)


def test_a_law_is_asked_once_for_each_period_that_has_passed():
    law, hand = ThreeSteps(), HandState(0.0, HERE, np.zeros(6))
    spring = SpringOfWrench(law, SPRING, PERIOD_S)
    assert spring(hand, PERIOD_S) is not None and law.steps == 1
    assert spring(hand, 2 * PERIOD_S) is not None and law.steps == 3
    assert spring(hand, PERIOD_S) is None


GOAL = gtsam.Pose3(HERE)


def line(**changes):
    end = GOAL.translation()
    start = end - 0.05 * HERE[:3, 2]
    return StraightLine(GOAL, start, end, 0.05, ApproachConfig(**changes), PERIOD_S)


def run(law, hand_of, seconds=10.0):
    """The last reference; `hand_of` says where the hand is that was sent to one."""
    last, T = None, gtsam.Pose3(HERE).matrix()
    T[:3, 3] -= 0.05 * HERE[:3, 2]
    for k in range(round(seconds / PERIOD_S)):
        reference = law(HandState(k * PERIOD_S, T, np.zeros(6)), PERIOD_S)
        if reference is None:
            return last
        last, T = reference, hand_of(reference.T_world_gripper)
    raise AssertionError("it does not end")


def test_a_line_ends_at_its_goal():
    law = line()
    last = run(law, lambda T: T.copy())
    assert law.blocked_m is None
    assert off_by(last.T_world_gripper, GOAL)[0] < 1e-4
    assert np.abs(last.twist).max() < 1e-6


def test_what_friction_holds_back_is_made_up_for():
    def behind(T):
        T = T.copy()
        T[:3, 3] -= 0.004 * HERE[:3, 2]
        return T

    law = line(settle_s=3.0)
    last = run(law, behind)
    assert law.blocked_m is None
    assert off_by(behind(last.T_world_gripper), GOAL)[0] < 0.001


def test_a_wall_ends_a_line_before_its_goal():
    def stopped(T):
        T = T.copy()
        beyond = HERE[:3, 2] @ (T[:3, 3] - GOAL.translation()) + 0.03
        T[:3, 3] -= max(beyond, 0.0) * HERE[:3, 2]
        return T

    law = line()
    run(law, stopped)
    assert law.blocked_m == pytest.approx(0.03, abs=0.002)


def test_the_joints_of_a_leg_have_limits_in_the_ratio_of_their_ways():
    law, step = TimeLawConfig(), np.array([0.3, 0.2, -0.1, 0.2, 0.5, -0.3, 0.0])
    limits = leg_limits(step, law)
    for limit, most, share in (
        (limits.rates, DQ_MAX, law.speed),
        (limits.accelerations, DDQ_MAX, law.acceleration),
        (limits.jerks, DDDQ_MAX, law.jerk),
    ):
        assert np.all(limit <= share * most * (1 + 1e-9))
        np.testing.assert_allclose(limit[:6] / limit[4], np.abs(step[:6]) / 0.5)
        assert limit[6] > 0.0
