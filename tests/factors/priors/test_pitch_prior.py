"""Pitch prior: a Gaussian about zero, and its normalised density."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.finite_differences import analytic_gradient, numeric_gradient, numeric_jacobian
from factors.priors.pitch_prior import pitch_log_density, pitch_prior_factor, pitch_prior_residual

PITCH = gtsam.symbol("h", 0)
PITCHES = {"zero": 0.0, "near zero": 1e-7, "generic": -0.03, "pi": np.pi}
SIGMA = 0.02


def _values(pitch):
    values = gtsam.Values()
    values.insert(PITCH, pitch)
    return values


@pytest.mark.parametrize("pitch", PITCHES.values(), ids=PITCHES.keys())
def test_jacobian_and_gradient_match_differences(pitch):
    factor, values = pitch_prior_factor(PITCH, SIGMA), _values(pitch)
    A, _ = factor.linearize(values).jacobian()
    assert_allclose(A, numeric_jacobian(factor, values, [1]), rtol=1e-6)
    assert_allclose(
        analytic_gradient(factor, values), numeric_gradient(factor, values, [1]), atol=1e-3
    )


def test_three_centimetres_a_radian_at_two_of_sigma_err_by_one_and_a_half():
    e, J = pitch_prior_residual(0.03, 0.02)
    assert_allclose([e, J], [1.5, 50.0])
    assert_allclose(pitch_prior_factor(PITCH, 0.02).error(_values(0.03)), 1.125)


def test_a_plain_hinge_costs_nothing():
    assert pitch_prior_factor(PITCH, SIGMA).error(_values(0.0)) == 0.0


def test_density_integrates_to_one():
    grid = np.linspace(-10 * SIGMA, 10 * SIGMA, 4001)
    density = np.exp([pitch_log_density(p, SIGMA) for p in grid])
    assert_allclose(np.trapezoid(density, grid), 1.0, rtol=1e-9)


def test_density_falls_by_the_factors_error():
    drop = pitch_log_density(0.0, SIGMA) - pitch_log_density(0.05, SIGMA)
    assert_allclose(drop, pitch_prior_factor(PITCH, SIGMA).error(_values(0.05)))


@pytest.mark.parametrize("sigma", [0.0, -0.02, np.nan, np.inf])
def test_a_sigma_that_is_not_positive_is_refused(sigma):
    with pytest.raises(ValueError, match=r"sigma_m_per_rad is .* expected > 0"):
        pitch_prior_factor(PITCH, sigma)
    with pytest.raises(ValueError, match=r"sigma_m_per_rad is .* expected > 0"):
        pitch_log_density(0.0, sigma)
