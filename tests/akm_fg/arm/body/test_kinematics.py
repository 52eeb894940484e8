from __future__ import annotations

import gtsam
import numpy as np

from akm_fg.arm.body.description import franka_description
from akm_fg.arm.body.kinematics import (
    Q_HOME,
    Q_MAX,
    Q_MIN,
    TAU_MAX,
    FrankaKinematics,
    limit_margin_rad,
)


def is_at(kinematics: FrankaKinematics, q: np.ndarray, wanted: gtsam.Pose3) -> bool:
    """To a tenth of a millimetre and a milliradian, inside the soft limits."""
    found = kinematics.T_world_gripper(q)
    off_m = np.linalg.norm(found.translation() - wanted.translation())
    off_rad = np.linalg.norm(gtsam.Rot3.Logmap(found.rotation().between(wanted.rotation())))
    return bool(off_m < 1e-4 and off_rad < 1e-3 and limit_margin_rad(q) >= 0.0)


def test_inverse_kinematics_reaches_poses_near_by_to_a_tenth_of_a_millimetre():
    """All but one in a hundred, which may end at a joint limit; then it says so."""
    kinematics, rng = FrankaKinematics(), np.random.default_rng(3)
    missed = 0
    for q_true in rng.uniform(Q_MIN + 0.1, Q_MAX - 0.1, (400, 7)):
        wanted = kinematics.T_world_gripper(q_true)
        q = kinematics.solve(wanted, q_true + rng.normal(0.0, 0.2, 7))
        missed += q is None
        assert q is None or is_at(kinematics, q, wanted)
    assert missed <= 4


def test_inverse_kinematics_from_far_is_as_exact_or_says_none():
    kinematics, rng = FrankaKinematics(), np.random.default_rng(4)
    found = 0
    for q_true in rng.uniform(Q_MIN + 0.1, Q_MAX - 0.1, (50, 7)):
        wanted = kinematics.T_world_gripper(q_true)
        starts = [Q_HOME, *rng.uniform(Q_MIN, Q_MAX, (3, 7))]
        answers = [
            q for q in (kinematics.solve(wanted, start) for start in starts) if q is not None
        ]
        assert all(is_at(kinematics, q, wanted) for q in answers)
        found += bool(answers)
    assert found > 40  # from four starts


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


def test_the_arm_limits_are_those_of_the_urdf():
    text = franka_description().urdf.read_text()
    for q_min, q_max in zip(Q_MIN, Q_MAX, strict=True):
        assert f'soft_lower_limit="{q_min:.4f}" soft_upper_limit="{q_max:.4f}"' in text
    assert [f'effort="{tau:.0f}"' in text for tau in TAU_MAX] == [True] * 7
