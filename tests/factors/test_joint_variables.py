"""The variables of one joint: which columns they are, how they are read, what is refused."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, numeric_gradient
from factors.joint_variables import JointVariables, joint_variables, normal_equations_factor

JOINT, PITCH = gtsam.symbol("j", 0), gtsam.symbol("h", 0)
Q = [None, gtsam.symbol("q", 1), None, gtsam.symbol("q", 3)]


def _values(helical):
    values = gtsam.Values()
    values.insert(JOINT, gtsam.Pose3.Expmap(np.arange(6) / 10))
    values.insert(Q[1], 0.3)
    values.insert(Q[3], -0.2)
    if helical:
        values.insert(PITCH, 0.05)
    return values


def test_fixed_states_are_zero_and_no_columns():
    variables = JointVariables("helical", JOINT, tuple(Q), PITCH)
    assert variables.columns.tolist() == [0, 1, 2, 3, 4, 5, 7, 9, 10]
    assert list(variables.dims.items()) == [(JOINT, 6), (Q[1], 1), (Q[3], 1), (PITCH, 1)]
    joint, q = variables.read(_values(helical=True))
    assert_allclose(joint.T_world_joint, gtsam.Pose3.Expmap(np.arange(6) / 10).matrix())
    assert q.tolist() == [0.0, 0.3, 0.0, -0.2]
    assert joint.pitch == 0.05


def test_a_cost_given_by_its_normal_equations_has_its_gradient_in_gtsam():
    """Half of (q1 - 1)^2 + 4 (q3 + 2 q1)^2, with 7 beside it."""
    variables = JointVariables("revolute", JOINT, tuple(Q))

    def evaluate(joint, q, want):
        a, b = q[1] - 1, q[3] + 2 * q[1]
        H, g = np.zeros((10, 10)), np.zeros(10)
        rows = np.zeros((2, 10))
        rows[0, 7], rows[1, 7], rows[1, 9] = 1, 4, 2
        H[:], g[:] = rows.T @ rows, rows.T @ [a, 2 * b]
        return a**2 + 4 * b**2 + 7, (H, g) if want else None

    factor, values = normal_equations_factor(variables, evaluate), _values(helical=False)
    assert_allclose(factor.error(values), (0.49 + 4 * 0.16 + 7) / 2)
    assert_allclose(
        analytic_gradient(factor, values), numeric_gradient(factor, values, [6, 1, 1]), atol=1e-6
    )


@pytest.mark.parametrize(("kind", "pitch"), [("helical", None), ("revolute", PITCH)])
def test_a_pitch_out_of_place_is_refused(kind, pitch):
    with pytest.raises(ValueError, match="helical joints have one"):
        joint_variables(kind, JOINT, Q, pitch, 4)


def test_a_state_key_too_few_is_refused():
    with pytest.raises(ValueError, match="3 state keys, 4 frames"):
        joint_variables("revolute", JOINT, Q[:3], None, 4)
