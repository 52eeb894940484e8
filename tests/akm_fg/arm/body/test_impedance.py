"""The impedance laws, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from akm_fg.arm.body.impedance import (
    ImpedanceConfig,
    JointImpedanceConfig,
    bounded,
    cartesian_torques,
    joint_impedance,
)
from akm_fg.arm.body.kinematics import Q_HOME, Q_MAX, Q_MIN, FrankaKinematics

STILL = np.zeros(7)


@pytest.fixture(scope="module")
def J() -> np.ndarray:
    return FrankaKinematics().update(Q_HOME)[1].copy()


def test_a_joint_is_a_spring_and_a_damper_about_its_reference():
    balance = np.arange(7.0)
    off, slow = np.zeros(7), np.zeros(7)
    off[1], slow[6] = 0.01, 0.1
    tau = joint_impedance(Q_HOME + off, slow, Q_HOME, STILL, balance, JointImpedanceConfig())
    np.testing.assert_allclose(tau - balance, [0, 6.0, 0, 0, 0, 0, 1.5], atol=1e-12)


def test_a_wrench_at_the_hand_is_its_virtual_work_in_the_joints(J: np.ndarray):
    wrench, balance = np.array([10.0, -5.0, 3.0, 0.1, 0.2, -0.3]), np.full(7, 2.0)
    tau = cartesian_torques(wrench, J, Q_HOME, STILL, Q_HOME, balance, ImpedanceConfig())
    rng = np.random.default_rng(0)
    for dq in rng.normal(size=(5, 7)):
        assert (tau - balance) @ dq == pytest.approx(wrench @ (J @ dq))


def test_the_posture_pushes_nothing_at_the_hand(J: np.ndarray):
    rest = Q_HOME + np.array([0.2, -0.1, 0.3, 0.1, -0.2, 0.1, 0.3])
    tau = cartesian_torques(np.zeros(6), J, Q_HOME, STILL, rest, STILL, ImpedanceConfig())
    assert np.abs(tau).max() > 0.1
    at_the_hand = np.linalg.solve(J @ J.T, J @ tau)  # wrench whose torques these would be
    np.testing.assert_allclose(at_the_hand, 0.0, atol=1e-4)


@pytest.mark.parametrize(("limit", "sign"), [(Q_MIN, 1.0), (Q_MAX, -1.0)])
def test_near_a_joint_limit_a_spring_pushes_back(J: np.ndarray, limit: np.ndarray, sign: float):
    config, q = ImpedanceConfig(null_stiffness=0.0), Q_HOME.copy()
    q[2] = limit[2] + sign * 0.02
    tau = cartesian_torques(np.zeros(6), J, q, STILL, Q_HOME, STILL, config)
    assert tau[2] == pytest.approx(sign * config.limit_stiffness * (config.limit_zone_rad - 0.02))
    np.testing.assert_allclose(np.delete(tau, 2), 0.0, atol=1e-9)


@pytest.mark.parametrize(("limit", "sign"), [(Q_MIN, 1.0), (Q_MAX, -1.0)])
def test_an_arm_that_rests_near_a_limit_is_kept_there_and_not_thrown_back(
    J: np.ndarray, limit: np.ndarray, sign: float
):
    config, q_rest = ImpedanceConfig(null_stiffness=0.0), Q_HOME.copy()
    q_rest[2] = limit[2] + sign * 0.02
    still = cartesian_torques(np.zeros(6), J, q_rest, STILL, q_rest, STILL, config)
    np.testing.assert_allclose(still, 0.0, atol=1e-9)
    nearer = q_rest.copy()
    nearer[2] -= sign * 0.01
    tau = cartesian_torques(np.zeros(6), J, nearer, STILL, q_rest, STILL, config)
    assert tau[2] == pytest.approx(sign * config.limit_stiffness * 0.01)


def test_bounded_shortens_what_is_too_long_and_nothing_else():
    np.testing.assert_allclose(bounded(np.array([3.0, 4.0]), 2.5), [1.5, 2.0])
    np.testing.assert_allclose(bounded(np.array([3.0, 4.0]), 5.0), [3.0, 4.0])


def test_motion_of_the_elbow_alone_is_damped_by_both_dampers(J: np.ndarray):
    """3 + 0.5 N m s/rad on joint speeds that do not move the hand, against them."""
    null = np.linalg.svd(J)[2][6]
    for dq in (0.2 * null, -0.2 * null):
        tau = cartesian_torques(np.zeros(6), J, Q_HOME, dq, Q_HOME, STILL, ImpedanceConfig())
        np.testing.assert_allclose(tau, -3.5 * dq, atol=1e-4)


def test_joint_speeds_that_move_the_hand_are_damped_in_the_joints_but_not_by_the_posture(
    J: np.ndarray,
):
    """The posture's 3 N m s/rad would push at the hand: they are taken out, 0.5 are left."""
    dq = np.linalg.pinv(J) @ np.array([0.05, 0.0, 0.02, 0.0, 0.1, 0.0])
    tau = cartesian_torques(np.zeros(6), J, Q_HOME, dq, Q_HOME, STILL, ImpedanceConfig())
    np.testing.assert_allclose(tau, -0.5 * dq, atol=1e-3)
    assert tau @ dq < 0.0
