"""The one door into GTSAM: shapes are checked, closures are freed, square roots are exact."""

import gc
import weakref

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.adapter import make_factor, square_root_rows

KEY, OTHER = 1, 2


@pytest.fixture
def values():
    v = gtsam.Values()
    v.insert(KEY, gtsam.Pose3())
    v.insert(OTHER, 0.5)
    return v


def _factor(error, blocks):
    return make_factor(
        lambda values, want: (error, blocks), {KEY: 6, OTHER: 1}, gtsam.noiseModel.Unit.Create(2)
    )


def test_error_and_blocks_reach_gtsam_unchanged(values):
    rng = np.random.default_rng(0)
    blocks = [rng.normal(size=(2, 6)), rng.normal(size=(2, 1))]
    e = np.array([3.0, 4.0])
    factor = _factor(e, blocks)
    A, b = factor.linearize(values).jacobian()
    assert_allclose(A, np.hstack(blocks))
    assert_allclose(b, -e)
    assert_allclose(factor.error(values), 12.5)


def test_residual_is_told_whether_jacobians_are_wanted(values):
    asked = []

    def residual(values, want_jacobians):
        asked.append(want_jacobians)
        return np.zeros(1), [np.zeros((1, 6))] if want_jacobians else None

    factor = make_factor(residual, {KEY: 6}, gtsam.noiseModel.Unit.Create(1))
    factor.error(values)
    factor.linearize(values)
    assert asked == [False, True]


@pytest.mark.parametrize(
    "blocks",
    [
        [np.zeros((2, 5)), np.zeros((2, 1))],
        [np.zeros((3, 6)), np.zeros((3, 1))],
        [np.zeros((2, 6)), np.zeros(2)],
        [np.zeros((2, 1)), np.zeros((2, 6))],
        [np.zeros((2, 6))],
        [np.zeros((2, 6)), np.zeros((2, 1)), np.zeros((2, 1))],
        None,
    ],
    ids=["columns", "rows", "flat", "order", "one missing", "one too many", "none"],
)
def test_wrong_jacobian_blocks_raise_instead_of_ending_the_process(values, blocks):
    with pytest.raises(ValueError, match=r"Jacobian blocks .* expected \[\(2, 6\), \(2, 1\)\]"):
        _factor(np.zeros(2), blocks).linearize(values)


@pytest.mark.parametrize("error", [np.zeros(3), np.zeros((2, 1)), np.zeros(0)])
def test_an_error_of_the_wrong_shape_raises(values, error):
    factor = _factor(error, [np.zeros((2, 6)), np.zeros((2, 1))])
    with pytest.raises(ValueError, match=r"error has shape .* expected \(2,\)"):
        factor.error(values)


def test_an_error_raised_inside_a_residual_comes_out_of_gtsam(values):
    def residual(values, want_jacobians):
        raise ZeroDivisionError("in the residual")

    factor = make_factor(residual, {KEY: 6}, gtsam.noiseModel.Unit.Create(1))
    with pytest.raises(ZeroDivisionError, match="in the residual"):
        factor.error(values)


def test_closures_are_freed_with_their_factors(values):
    alive = []
    for _ in range(50):
        data = np.zeros(2)
        alive.append(weakref.ref(data))
        factor = _factor(data, [np.zeros((2, 6)), np.zeros((2, 1))])
        factor.linearize(values)
        del factor, data
    gc.collect()
    assert sum(ref() is not None for ref in alive) == 0


def _quadratic(rank, d=5, seed=0):
    """Information, gradient and twice the cost of `rank` random rows on d variables."""
    rng = np.random.default_rng(seed)
    J, r = rng.normal(size=(rank + 3, d)), rng.normal(size=rank + 3)
    J[:, rank:] = 0.0  # gauge directions
    return J.T @ J, J.T @ r, float(r @ r)


@pytest.mark.parametrize("rank", [0, 1, 3, 5])
def test_square_root_rows_keep_information_gradient_and_cost(rank):
    information, gradient, twice_cost = _quadratic(rank)
    A, e = square_root_rows(information, gradient, twice_cost)
    assert A.shape == (6, 5) and e.shape == (6,)
    assert_allclose(A.T @ A, information, atol=1e-12)
    assert_allclose(A.T @ e, gradient, atol=1e-12)
    assert_allclose(e @ e, twice_cost, rtol=1e-12)


def test_square_root_rows_leave_directions_without_information_at_zero():
    information, gradient, twice_cost = _quadratic(3)
    rounding = 1e-15 * np.random.default_rng(1).normal(size=(5, 5))
    A, e = square_root_rows(information + rounding @ rounding.T, gradient, twice_cost)
    assert np.isfinite(A).all() and np.isfinite(e).all()
    assert_allclose(A[:, 3:], 0.0, atol=1e-12)


def test_square_root_rows_keep_units_ten_orders_of_magnitude_apart():
    information, gradient, twice_cost = _quadratic(5)
    units = np.array([1.0, 1e-5, 1.0, 1e-5, 1.0])
    information = information * np.outer(units, units)
    A, e = square_root_rows(information, gradient * units, twice_cost)
    scaled = (A.T @ A) / np.outer(units, units)
    assert_allclose(scaled, information / np.outer(units, units), rtol=1e-4, atol=1e-4)
    assert_allclose(A.T @ e / units, gradient, rtol=1e-4, atol=1e-4)


def test_the_least_possible_cost_survives_rounding():
    """At twice_cost = g^T H^-1 g the last row is the root of a difference that may be negative."""
    information, gradient, _ = _quadratic(5)
    least = float(gradient @ np.linalg.solve(information, gradient))
    _, e = square_root_rows(information, gradient, least * (1 - 1e-15))
    assert np.isfinite(e).all()
    assert_allclose(e @ e, least, rtol=1e-12)
