"""The checker itself: right on what is known, and able to say no."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.adapter import make_factor
from factors.finite_differences import (
    analytic_gradient,
    central_difference,
    numeric_gradient,
    numeric_jacobian,
    retract,
)

POSE = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.4, -0.9, 0.6])), np.array([0.2, -0.5, 0.9]))


@pytest.fixture
def values():
    v = gtsam.Values()
    v.insert(1, POSE)
    v.insert(2, 0.5)
    v.insert(3, gtsam.Rot3.Rz(0.3))
    return v


def _prior():
    measured = POSE.compose(gtsam.Pose3.Expmap(np.array([0.1, -0.2, 0.3, 0.02, 0.05, -0.04])))
    return gtsam.PriorFactorPose3(1, measured, gtsam.noiseModel.Isotropic.Sigma(6, 0.1))


def test_central_difference_of_a_quadratic_is_exact():
    def square(x):
        return np.array([x[0] ** 2, x[0] * x[1], 3.0])

    J = central_difference(square, np.array([2.0, 5.0]), step=1e-3)
    assert_allclose(J, [[4.0, 0.0], [5.0, 2.0], [0.0, 0.0]], atol=1e-10)


def test_retract_moves_the_given_keys_and_no_other(values):
    moved = retract(values, [2], [1], np.array([0.25]))
    assert_allclose(moved.atDouble(2), 0.75)
    assert moved.atPose3(1).equals(POSE, 1e-12)
    assert moved.atRot3(3).equals(gtsam.Rot3.Rz(0.3), 1e-12)


def test_retract_puts_the_increment_on_the_right(values):
    delta = 1e-4 * np.arange(1, 8)
    moved = retract(values, [2, 1], [1, 6], delta)
    assert_allclose(moved.atDouble(2), 0.5001)
    want = POSE.compose(gtsam.Pose3.Expmap(delta[1:]))
    assert_allclose(moved.atPose3(1).matrix(), want.matrix(), atol=1e-6)


def test_numeric_jacobian_agrees_with_gtsams_own_factor(values):
    factor = _prior()
    whitened, _ = factor.linearize(values).jacobian()
    assert_allclose(numeric_jacobian(factor, values, [6]), whitened * 0.1, atol=1e-6)


def test_numeric_and_analytic_gradient_agree_on_gtsams_own_factor(values):
    factor = _prior()
    numeric = numeric_gradient(factor, values, [6])
    assert np.abs(numeric).max() > 1
    assert_allclose(analytic_gradient(factor, values), numeric, rtol=1e-5, atol=1e-5)


def test_a_jacobian_of_the_wrong_sign_is_noticed(values):
    def residual(values, want_jacobians):
        return np.array([values.atDouble(2) - 2.0]), [-np.ones((1, 1))]

    factor = make_factor(residual, {2: 1}, gtsam.noiseModel.Unit.Create(1))
    assert_allclose(numeric_gradient(factor, values, [1]), [-1.5], rtol=1e-6)
    assert_allclose(analytic_gradient(factor, values), [1.5])
