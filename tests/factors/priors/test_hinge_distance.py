"""Hinge-distance prior: log-normal in the distance, silent on everything else."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, numeric_gradient, numeric_jacobian
from factors.priors.hinge_distance import hinge_distance_factor, hinge_distance_residual

CENTROID = np.array([0.4, -0.2, 1.1])
MEDIAN_M, SIGMA_LOG = 0.3, 0.6
TURNS = {
    "zero": np.zeros(3),
    "near zero": np.array([1e-9, -1e-7, 1e-6]),
    "generic": np.array([0.4, -0.9, 0.6]),
    "pi": np.pi * np.array([0.6, 0.0, 0.8]),
}


def _values(turn, offset):
    """A joint whose axis passes the centroid at `offset`, given in the joint's axes."""
    R = gtsam.Rot3.Expmap(np.asarray(turn, dtype=float))
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(R, CENTROID - R.matrix() @ np.asarray(offset)))
    return values


def _factor():
    return hinge_distance_factor(0, CENTROID, MEDIAN_M, SIGMA_LOG)


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS.keys())
@pytest.mark.parametrize("offset", [[0.5, -0.2, 0.3], [1e-3, 0.0, 0.0], [40.0, 30.0, -2.0]])
def test_jacobian_matches_differences(turn, offset):
    values = _values(turn, offset)
    A, _ = _factor().linearize(values).jacobian()
    numeric = numeric_jacobian(_factor(), values, [6], step=1e-7)
    assert_allclose(A, numeric, rtol=1e-5, atol=1e-5 * np.abs(numeric).max())


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS.keys())
def test_gradient_is_that_of_the_cost(turn):
    values = _values(turn, [0.5, -0.2, 0.3])
    numeric = numeric_gradient(_factor(), values, [6])
    assert_allclose(analytic_gradient(_factor(), values), numeric, atol=1e-7)


def test_hinge_at_the_median_distance_costs_nothing():
    values = _values(TURNS["generic"], [0.18, 0.24, 5.0])  # 3-4-5: 0.3 m
    assert_allclose(_factor().error(values), 0.0, atol=1e-20)


def test_hinge_at_one_and_a_half_times_the_median_errs_by_log_one_and_a_half_over_sigma():
    pose = _values(TURNS["generic"], [0.45, 0.0, 0.0]).atPose3(0).matrix()
    e, _ = hinge_distance_residual(pose, CENTROID, MEDIAN_M, SIGMA_LOG)
    assert_allclose(e, np.log(1.5) / 0.6)


def test_hinge_twice_too_far_and_half_too_near_cost_the_same():
    far, near = (_factor().error(_values(np.zeros(3), [r, 0, 0])) for r in (0.6, 0.15))
    assert_allclose(far, near)
    assert far > 0.5


def test_sliding_along_and_turning_about_the_axis_change_nothing():
    pose = _values(TURNS["generic"], [0.5, -0.2, 0.3]).atPose3(0).matrix()
    _, J = hinge_distance_residual(pose, CENTROID, MEDIAN_M, SIGMA_LOG)
    assert_allclose(J[[2, 5]], 0.0, atol=1e-14)
    assert np.abs(J[[0, 1, 3, 4]]).min() > 1e-2


def test_moving_the_axis_away_from_the_part_raises_the_error():
    """By hand: d e / d vx = -1 / (rho sigma) for a centroid at x = rho."""
    pose = _values(np.zeros(3), [0.5, 0.0, 0.0]).atPose3(0).matrix()
    _, J = hinge_distance_residual(pose, CENTROID, MEDIAN_M, SIGMA_LOG)
    assert_allclose(J[3], -1 / (0.5 * 0.6))


def test_an_axis_through_the_centroid_stays_finite():
    values = _values(np.zeros(3), [0.0, 0.0, 0.4])
    A, b = _factor().linearize(values).jacobian()
    assert np.isfinite(A).all() and np.isfinite(b).all()


@pytest.mark.parametrize(
    ("median_m", "sigma_log"), [(0.0, 0.6), (-0.3, 0.6), (0.3, 0.0), (0.3, -1.0), (np.nan, 0.6)]
)
def test_a_median_or_sigma_that_is_not_positive_is_refused(median_m, sigma_log):
    with pytest.raises(ValueError, match=r"median_m .* and sigma_log .* expected > 0"):
        hinge_distance_factor(0, CENTROID, median_m, sigma_log)
