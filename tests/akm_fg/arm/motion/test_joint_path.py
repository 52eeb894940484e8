"""Free motion along waypoints: limits, smoothness, and how close it stays to the straight legs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from akm_fg.arm.body.kinematics import DDDQ_MAX, DDQ_MAX, DQ_MAX, Q_HOME, Q_MAX, Q_MIN
from akm_fg.arm.body.limits import ExecutedMotion
from akm_fg.arm.motion.joint_path import TimeLawConfig, joint_motion
from akm_fg.errors import MotionInfeasible

STEP_S = 1e-3


def waypoints(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    offsets = rng.uniform(-0.6, 0.6, (count - 1, 7))
    return np.vstack([Q_HOME, np.clip(Q_HOME + offsets, Q_MIN + 0.05, Q_MAX - 0.05)])


def distance_to_legs(q: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N,) distance of each of q (N, 7) to the polyline through the points."""
    best = np.full(len(q), np.inf)
    for a, b in pairwise(points):
        share = np.clip((q - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(q - a - share[:, None] * (b - a), axis=1))
    return best


@pytest.mark.parametrize("seed", range(4))
def test_the_references_are_within_the_limits_and_near_the_legs(seed: int):
    points, config = waypoints(seed, 2 + seed), TimeLawConfig()
    motion = joint_motion(points, STEP_S, config)
    dq = np.vstack([np.zeros(7), motion.dq, np.zeros(7)])  # at rest before and after
    q = np.vstack([points[0], motion.q, points[-1]])
    usage = ExecutedMotion(STEP_S, q, dq, np.zeros_like(q)).usage()
    assert usage.within
    assert usage.velocity <= 2.001 * config.speed
    assert usage.acceleration <= 2.001 * config.acceleration
    assert distance_to_legs(motion.q, points).max() <= config.corner_rad + 1e-9
    np.testing.assert_allclose(motion.q[-1], points[-1], atol=1e-12)
    np.testing.assert_allclose(np.diff(q[:-1], axis=0) / STEP_S, motion.dq, atol=5e-3)
    np.testing.assert_allclose(np.diff(dq[:-1], axis=0) / STEP_S, motion.ddq, atol=0.2)


def test_no_more_than_two_legs_run_at_once_however_wide_corners_may_be():
    """Four legs of equal length: each may begin with the one before, but not before that ended."""
    config = TimeLawConfig(corner_rad=10.0)
    points = Q_HOME + np.linspace(0.0, 1.2, 5)[:, None] * np.eye(7)[0]
    motion = joint_motion(points, STEP_S, config)
    dq = np.vstack([np.zeros(7), motion.dq, np.zeros(7)])
    q = np.vstack([points[0], motion.q, points[-1]])
    usage = ExecutedMotion(STEP_S, q, dq, np.zeros_like(q)).usage()
    assert usage.velocity <= 2.001 * config.speed
    assert usage.acceleration <= 2.001 * config.acceleration


def test_a_corner_costs_less_time_than_a_stop():
    points = waypoints(5, 4)
    alone = sum(len(joint_motion(points[k : k + 2], STEP_S).q) for k in range(3))
    stopping = joint_motion(points, STEP_S, TimeLawConfig(corner_rad=0.0))
    assert len(stopping.q) == pytest.approx(alone, abs=3)
    assert len(joint_motion(points, STEP_S).q) < 0.97 * alone


def test_one_leg_uses_its_share_of_a_limit():
    config = TimeLawConfig(speed=0.2, acceleration=0.1, jerk=0.03)
    goal = Q_HOME + np.array([1.2, 0, 0, 0, 0, 0, 0])
    motion = joint_motion([Q_HOME, goal], STEP_S, config)
    assert np.abs(motion.dq[:, 0]).max() == pytest.approx(0.2 * DQ_MAX[0], rel=1e-3)
    assert np.abs(motion.ddq[:, 0]).max() == pytest.approx(0.1 * DDQ_MAX[0], rel=1e-2)
    jerk = np.abs(np.diff(motion.ddq[:, 0])).max() / STEP_S
    assert jerk == pytest.approx(0.03 * DDDQ_MAX[0], rel=1e-2)


def test_standing_still_is_a_motion_too():
    motion = joint_motion([Q_HOME, Q_HOME], STEP_S)
    np.testing.assert_allclose(motion.q, [Q_HOME])
    assert not motion.dq.any()


def test_bad_waypoints_and_settings_are_refused():
    with pytest.raises(MotionInfeasible, match="outside the limits"):
        joint_motion([Q_HOME, Q_MAX + 0.1], STEP_S)
    with pytest.raises(ValueError, match="expected"):
        joint_motion([Q_HOME], STEP_S)
    with pytest.raises(ValueError, match="shares"):
        TimeLawConfig(speed=0.6)
