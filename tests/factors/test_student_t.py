"""The Student-t kernel against scipy's density, its own derivative, and Monte Carlo."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from factors.finite_differences import central_difference
from factors.student_t import (
    covariance_factor,
    log_normaliser,
    twice_negative_log_kernel,
    weight,
)

DOFS = [1.0, 4.0, 6.0, 50.0]


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_log_density_is_scipys(dof, dim):
    e = np.random.default_rng(0).normal(size=(20, dim)) * 3
    ours = log_normaliser(dof, dim) - 0.5 * twice_negative_log_kernel((e**2).sum(1), dof, dim)
    assert_allclose(ours, stats.multivariate_t(np.zeros(dim), df=dof).logpdf(e), rtol=1e-12)


def test_kernel_of_a_unit_error_is_worked_by_hand():
    """(4 + 3) log(1 + 4/4) = 7 log 2; the weight there is 7/8."""
    assert_allclose(twice_negative_log_kernel(np.array(4.0), 4.0, 3), 7 * np.log(2))
    assert_allclose(weight(np.array(4.0), 4.0, 3), 7 / 8)


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("d2", [0.0, 1e-6, 1.0, 25.0, 1e4])
def test_weight_is_the_derivative_of_the_kernel(dof, d2):
    at, step = np.array([d2]), 1e-4 * max(d2, 1e-2)
    numeric = central_difference(lambda x: twice_negative_log_kernel(x, dof, 3), at, step)
    assert_allclose(weight(at, dof, 3), numeric[0], rtol=1e-6)


def test_kernel_is_zero_at_the_mode_and_the_squared_error_for_many_degrees_of_freedom():
    d2 = np.array([0.0, 0.3, 9.0])
    assert twice_negative_log_kernel(d2, 4.0, 3)[0] == 0
    assert_allclose(twice_negative_log_kernel(d2, 1e9, 3), d2, rtol=1e-7)
    assert_allclose(weight(d2, 1e9, 3), 1.0, rtol=1e-7)


def test_weight_falls_towards_zero_for_wild_errors():
    w = weight(np.array([0.0, 1.0, 1e2, 1e6]), 4.0, 3)
    assert (np.diff(w) < 0).all() and w[-1] < 1e-5


def test_covariance_factor_of_a_gaussian_kernel_is_the_mean_squared_error():
    d2 = np.array([1.0, 2.0, 3.0, 6.0])
    assert_allclose(covariance_factor(d2, 1e12, 3), 1.0, rtol=1e-9)
    assert_allclose(covariance_factor(4 * d2, 1e12, 3), 4.0, rtol=1e-9)


@pytest.mark.parametrize("dof", [3.0, 6.0, 20.0])
def test_covariance_factor_reaches_the_fisher_information_of_the_t_distribution(dof):
    """On true t noise the information of a location is (dof + p) / (dof + p + 2)."""
    rng = np.random.default_rng(0)
    d2 = (rng.normal(size=(400_000, 3)) ** 2).sum(1) / (rng.chisquare(dof, 400_000) / dof)
    variance = covariance_factor(d2, dof, 3) / weight(d2, dof, 3).mean()
    assert_allclose(variance, (dof + 5) / (dof + 3), rtol=0.02)


@pytest.mark.parametrize("count", [6, 12, 60])
def test_covariance_factor_gives_the_spread_of_robust_means_of_gaussian_noise(count):
    """Also of few errors a mean: residuals are smaller than errors, their weights larger."""
    rng = np.random.default_rng(0)
    e = rng.normal(size=(200_000 // count, count, 3))
    mean = np.zeros((len(e), 1, 3))
    for _ in range(15):
        w = weight(((e - mean) ** 2).sum(-1), 4.0, 3)[..., None]
        mean = (w * e).sum(1, keepdims=True) / w.sum(1, keepdims=True)
    d2 = ((e - mean) ** 2).sum(-1).ravel()
    factor = covariance_factor(d2, 4.0, 3, freedom=1 - 1 / count)
    predicted = factor / (count * weight(d2, 4.0, 3).mean())
    assert_allclose((mean**2).mean(), predicted, rtol=0.025)
