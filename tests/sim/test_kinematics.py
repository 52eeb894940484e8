from __future__ import annotations

import gtsam
import numpy as np

from sim.kinematics import Q_HOME, Q_MAX, Q_MIN, FrankaKinematics, limit_margin_rad
from sim.reaching import ReachConfig, choose_grasp_configuration, standoff


def test_inverse_kinematics_is_exact_to_a_tenth_of_a_millimetre_and_keeps_the_limits():
    kinematics, rng = FrankaKinematics(), np.random.default_rng(3)
    for _ in range(50):
        q_true = rng.uniform(Q_MIN + 0.1, Q_MAX - 0.1)
        wanted = kinematics.T_world_gripper(q_true)
        q = kinematics.solve(wanted, q_true + rng.normal(0.0, 0.2, 7))
        assert q is not None and limit_margin_rad(q) >= 0.0
        error = wanted.localCoordinates(kinematics.T_world_gripper(q))
        assert np.linalg.norm(error[3:]) < 1e-4
        assert np.linalg.norm(error[:3]) < 1e-3


def test_the_jacobian_is_the_derivative_of_the_pose():
    kinematics, step = FrankaKinematics(), 1e-6
    q = Q_HOME + 0.1
    J = kinematics.update(q)[1].copy()
    for j in range(7):
        dq = np.eye(7)[j] * step
        ahead, behind = kinematics.T_world_gripper(q + dq), kinematics.T_world_gripper(q - dq)
        column = (ahead.translation() - behind.translation()) / (2 * step)
        np.testing.assert_allclose(J[:3, j], column, atol=1e-6)


def test_a_pose_out_of_reach_has_no_solution():
    far = gtsam.Pose3(gtsam.Rot3(), np.array([2.0, 0.0, 0.5]))
    assert FrankaKinematics().solve(far, Q_HOME) is None
    assert choose_grasp_configuration(FrankaKinematics(), far) is None


def test_the_pregrasp_lies_behind_the_grasp_along_the_approach():
    kinematics = FrankaKinematics()
    grasp = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([0.6, 0.1, 0.5]))
    choice = choose_grasp_configuration(kinematics, grasp)
    assert choice is not None
    wanted = standoff(grasp, ReachConfig().standoff_m)
    assert wanted.equals(kinematics.T_world_gripper(choice.q_pregrasp), 1e-3)
    np.testing.assert_allclose(wanted.translation(), [0.5, 0.1, 0.5], atol=1e-9)
