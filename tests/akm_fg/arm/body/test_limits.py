"""Torque and torque-rate limits, and the measure of how much of Franka's limits a motion used."""

from __future__ import annotations

import numpy as np
import pytest

from akm_fg.arm.body.kinematics import DDDQ_MAX, DDQ_MAX, DQ_MAX, Q_HOME, Q_MAX, TAU_MAX
from akm_fg.arm.body.limits import ExecutedMotion, MotionRecorder, TorqueLimiter

STEP_S = 1e-3


def test_a_torque_step_is_given_at_a_thousand_newton_metres_a_second():
    limiter = TorqueLimiter(np.zeros(7), STEP_S)
    given = [limiter.limited(np.full(7, 3.5)).copy() for _ in range(5)]
    np.testing.assert_allclose([tau[0] for tau in given], [1.0, 2.0, 3.0, 3.5, 3.5])


def test_torques_stay_within_what_the_motors_have():
    limiter = TorqueLimiter(np.zeros(7), STEP_S)
    for _ in range(200):
        tau = limiter.limited(np.array([1e3, -1e3, 0, 0, 1e3, -1e3, 0]))
    np.testing.assert_allclose(tau, TAU_MAX * [1, -1, 0, 0, 1, -1, 0])


def constant_jerk(joint: int, jerk: float, count: int) -> ExecutedMotion:
    """One joint from rest at home under a constant jerk, from sample 0 on."""
    dq, tau = np.zeros((count, 7)), np.zeros((count, 7))
    ddq = jerk * STEP_S * np.arange(count - 1)
    dq[1:, joint] = np.cumsum(ddq) * STEP_S
    return ExecutedMotion(STEP_S, Q_HOME + np.cumsum(dq, axis=0) * STEP_S, dq, tau)


@pytest.mark.parametrize("joint", [0, 3, 6])
def test_usage_by_hand_of_a_constant_jerk(joint: int):
    jerk, count = 0.5 * DDDQ_MAX[joint], 11
    usage = constant_jerk(joint, jerk, count).usage()
    assert usage.jerk == pytest.approx(0.5)
    # Nine steps after the first difference, which is zero: 9 ms of it.
    assert usage.acceleration == pytest.approx(jerk * 9e-3 / DDQ_MAX[joint])
    assert usage.velocity == pytest.approx(jerk * 45e-6 / DQ_MAX[joint])
    assert usage.within == (usage.acceleration <= 1.0)


@pytest.mark.parametrize("field", ["position", "velocity", "torque", "torque_rate"])
def test_each_exceeded_limit_is_seen(field: str):
    q, dq, tau = np.tile(Q_HOME, (5, 1)), np.zeros((5, 7)), np.zeros((5, 7))
    assert ExecutedMotion(STEP_S, q, dq, tau).usage().within
    if field == "position":
        q[2, 1] = Q_MAX[1] + 0.01
    if field == "velocity":
        dq[:, 4] = -1.01 * DQ_MAX[4]
    if field == "torque":
        tau[:, 5] = 1.01 * TAU_MAX[5]
    if field == "torque_rate":
        tau[2:, 5] = 1.1
    usage = ExecutedMotion(STEP_S, q, dq, tau).usage()
    assert not usage.within
    share = {"position": 1.0 - usage.position_margin_rad}.get(field) or getattr(usage, field)
    assert share == pytest.approx({"torque_rate": 1.1}.get(field, 1.01))


def test_the_low_pass_lets_through_what_libfrankas_lets_through():
    dq = np.zeros((60, 7))
    dq[1:] = 1.0  # a step, as of an impact
    motion = ExecutedMotion(STEP_S, np.tile(Q_HOME, (60, 1)), dq, np.zeros((60, 7))).filtered()
    gain = 1e-3 / (1e-3 + 1 / (2 * np.pi * 100.0))
    np.testing.assert_allclose(motion.dq[[1, 2], 0], [gain, 1 - (1 - gain) ** 2])
    assert motion.dq[-1, 0] == pytest.approx(1.0, abs=1e-9)


def test_too_few_samples_are_refused_and_a_recorder_keeps_the_order():
    recorder = MotionRecorder(STEP_S)
    for k in range(4):
        recorder.add(np.full(7, k), np.full(7, 10.0 + k), np.full(7, 20.0 + k))
    motion = recorder.motion(first=2)
    assert (motion.q[:, 0].tolist(), motion.dq[:, 0].tolist()) == ([2, 3], [12, 13])
    assert motion.tau[:, 0].tolist() == [22, 23]
    assert recorder.motion(1, 3).q[:, 0].tolist() == [1, 2]
    with pytest.raises(ValueError, match="2 samples"):
        motion.usage()
