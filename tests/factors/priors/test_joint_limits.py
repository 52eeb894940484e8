"""Joint limits: silent inside, a smooth wall outside, either side unknown."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, numeric_gradient, numeric_jacobian
from factors.priors.joint_limits import (
    joint_limits_factor,
    joint_limits_residual,
)

LOWER, UPPER, WIDTH = -0.1, 1.5, 0.02
STATES = {
    "zero": np.zeros(3),
    "near zero": np.array([1e-9, -1e-7, 1e-5]),
    "generic": np.array([-0.15, 0.7, 1.6]),
    "pi": np.array([np.pi, -np.pi, np.pi / 2]),
    "just inside": np.array([LOWER + 1e-5, 0.0, UPPER - 1e-5]),
    "just outside": np.array([LOWER - 1e-5, 0.0, UPPER + 1e-5]),
}
LIMITS = {"both": (LOWER, UPPER), "upper": (None, UPPER), "lower": (LOWER, None)}


def _keys(T):
    return [gtsam.symbol("q", t) for t in range(T)]


def _values(q):
    values = gtsam.Values()
    for key, state in zip(_keys(len(q)), q, strict=True):
        values.insert(key, float(state))
    return values


@pytest.fixture(params=list(LIMITS))
def limits(request):
    return LIMITS[request.param]


@pytest.mark.parametrize("q", STATES.values(), ids=STATES.keys())
def test_jacobian_matches_differences(q, limits):
    factor, values = joint_limits_factor(_keys(3), *limits, WIDTH), _values(q)
    A, _ = factor.linearize(values).jacobian()
    assert_allclose(A, numeric_jacobian(factor, values, [1] * 3), atol=1e-6)


@pytest.mark.parametrize("q", STATES.values(), ids=STATES.keys())
def test_gradient_is_that_of_the_cost(q, limits):
    factor, values = joint_limits_factor(_keys(3), *limits, WIDTH), _values(q)
    numeric = numeric_gradient(factor, values, [1] * 3)
    assert_allclose(analytic_gradient(factor, values), numeric, atol=1e-3)


def test_the_gradient_is_continuous_through_the_limit():
    factor = joint_limits_factor(_keys(1), LOWER, UPPER, WIDTH)
    values = _values([UPPER])
    assert_allclose(analytic_gradient(factor, values), [0.0])
    assert_allclose(numeric_gradient(factor, values, [1]), [0.0], atol=1e-2)
    slopes = [analytic_gradient(factor, _values([UPPER + d]))[0] for d in (1e-6, 1e-4)]
    assert_allclose(slopes, np.array([1e-6, 1e-4]) / WIDTH**2, rtol=1e-6)


def test_three_centimetres_past_a_stop_soft_by_two_err_by_one_and_a_half():
    e, J = joint_limits_residual(np.array([0.43, -0.03, 0.2]), 0.0, 0.4, 0.02)
    assert_allclose(e, [1.5, -1.5, 0.0])
    assert_allclose(J, [50.0, 50.0, 0.0])


def test_states_inside_cost_nothing_and_carry_no_information():
    factor, values = joint_limits_factor(_keys(3), LOWER, UPPER, WIDTH), _values([0.0, 0.7, 1.4])
    A, _ = factor.linearize(values).jacobian()
    assert factor.error(values) == 0.0
    assert_allclose(A, 0.0)


def test_an_unknown_limit_lets_everything_pass():
    far = np.array([-1e6, 1e6])
    assert_allclose(joint_limits_residual(far, None, 0.0, 1.0)[0], [0.0, 1e6])
    assert_allclose(joint_limits_residual(far, 0.0, None, 1.0)[0], [-1e6, 0.0])


def test_a_state_pushed_outside_comes_back_to_the_balance_with_the_push():
    """By hand: (q - 2) / 0.1^2 + (q - 1.5) / 0.02^2 = 0."""
    graph = gtsam.NonlinearFactorGraph()
    graph.add(joint_limits_factor(_keys(1), LOWER, UPPER, WIDTH))
    graph.add(gtsam.PriorFactorDouble(_keys(1)[0], 2.0, gtsam.noiseModel.Isotropic.Sigma(1, 0.1)))
    result = gtsam.LevenbergMarquardtOptimizer(graph, _values([0.3])).optimize()
    expected = (2.0 * 0.02**2 + 1.5 * 0.1**2) / (0.02**2 + 0.1**2)
    assert_allclose(result.atDouble(_keys(1)[0]), expected, atol=1e-6)


@pytest.mark.parametrize("limits", [(1.0, 0.0), (0.5, 0.5)])
def test_limits_out_of_order_are_refused(limits):
    with pytest.raises(ValueError, match="expected lower < upper"):
        joint_limits_factor(_keys(1), *limits, WIDTH)


@pytest.mark.parametrize("limits", [(np.nan, 1.0), (0.0, np.inf), (-np.inf, None)])
def test_limits_that_are_not_finite_are_refused(limits):
    with pytest.raises(ValueError, match="finite numbers or None"):
        joint_limits_factor(_keys(1), *limits, WIDTH)


def test_no_limit_at_all_is_refused():
    with pytest.raises(ValueError, match="both limits are None"):
        joint_limits_factor(_keys(1), None, None, WIDTH)


@pytest.mark.parametrize("keys", [[], [None, None]])
def test_no_free_state_is_refused(keys):
    with pytest.raises(ValueError, match="no free state"):
        joint_limits_factor(keys, LOWER, UPPER, WIDTH)


def test_fixed_states_are_left_out():
    factor = joint_limits_factor([None, *_keys(2)], LOWER, UPPER, WIDTH)
    assert list(factor.keys()) == _keys(2)
    assert_allclose(factor.error(_values([UPPER + WIDTH, 0.0])), 0.5)


@pytest.mark.parametrize("width", [0.0, -0.01, np.nan, np.inf])
def test_a_width_that_is_not_positive_is_refused(width):
    with pytest.raises(ValueError, match=r"width is .* expected > 0"):
        joint_limits_factor(_keys(1), LOWER, UPPER, width)
