"""Likelihood of errors that change on the way."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.sources.orientations import OrientationContribution, OrientationSource
from akm_fg.estimation.sources.slow_errors import SlowErrors, slow_correlations


def _errors(frames=12, sigma=0.01, slow=0.03):
    path = np.column_stack([np.linspace(0, 0.3, frames), np.zeros(frames), np.zeros(frames)])
    return SlowErrors(slow_correlations(path, np.tile(np.eye(3), (frames, 1, 1))), sigma, slow)


def test_correlations_by_hand_at_the_ends_of_a_straight_way():
    a = _errors().alike
    assert_allclose(np.diag(a), 1.0)
    assert_allclose(a[0, -1], np.exp(-1.0))  # both halves: the whole extent, and the whole way


def test_places_seen_again_err_alike_more_than_new_ones_as_late_on_the_way():
    there = np.linspace(0, 0.3, 10)
    x = np.concatenate([there, there[::-1]])
    path = np.column_stack([x, np.zeros(20), np.zeros(20)])
    a = slow_correlations(path, np.tile(np.eye(3), (20, 1, 1)))
    assert a[0, 19] > a[0, 10]
    assert_allclose(a[0, 19], (1 + np.exp(-1.0)) / 2)


def test_likelihood_is_that_of_a_gaussian_with_a_flat_offset():
    """By a very wide offset's own Gaussian: density times its width."""
    errors, rng = _errors(), np.random.default_rng(0)
    e = 0.03 * rng.normal(size=(12, 2)) + 0.7
    wide = 20.0
    cov = errors.sigma_slow**2 * errors.alike + errors.sigma**2 * np.eye(12) + wide**2
    want = sum(stats.multivariate_normal(np.zeros(12), cov).logpdf(e[:, k]) for k in range(2))
    want += 2 * np.log(wide * np.sqrt(2 * np.pi))
    assert_allclose(errors.log_likelihood(e), want, atol=3e-3)


def test_residuals_drawn_from_it_are_once_as_large_as_known():
    errors, rng = _errors(60), np.random.default_rng(1)
    cov = errors.sigma_slow**2 * errors.alike + errors.sigma**2 * np.eye(60)
    e = np.linalg.cholesky(cov) @ rng.normal(size=(60, 3))
    assert errors.times(e) == pytest.approx(1.0, abs=0.15)
    assert errors.wider(2.0).times(e) == pytest.approx(errors.times(e) / 2)


def test_a_ramp_below_the_slow_errors_tells_little_and_one_far_above_tells_much():
    errors = _errors(60, sigma=1e-4)
    ramp = np.linspace(-0.5, 0.5, 60)[:, None]
    none = errors.log_likelihood(0 * ramp)
    assert none - errors.log_likelihood(0.03 * ramp) < 1.0
    assert none - errors.log_likelihood(0.5 * ramp) > 30.0


def test_restricted_errors_are_those_of_the_frames():
    errors = _errors()
    some = np.array([0, 3, 7])
    assert_allclose(errors.restricted(some).alike, errors.alike[np.ix_(some, some)])


def _said(residual_rad):
    none = np.zeros((0, 0))
    return OrientationContribution(
        information=none,
        held=np.zeros(0),
        sigma_rad=0.01,
        R_ref=np.eye(3),
        residual_rad=residual_rad,
    )


def test_kinds_are_judged_at_one_level_that_the_best_of_them_leaves():
    """Both kinds leave more than is known: the level grows, and the worse one is less far off."""
    errors, rng = _errors(40), np.random.default_rng(2)
    better = 0.08 * rng.normal(size=(40, 3)).clip(-1.5, 1.5)
    worse = 1.3 * better
    source = OrientationSource(np.tile(np.eye(3), (40, 1, 1)), errors, FitConfig())
    one, two = source.levelled([_said(better), _said(worse)])
    factor = errors.times(better)
    assert factor > 2
    assert_allclose(one.log_correlated, errors.wider(factor).log_likelihood(better))
    assert_allclose(two.log_correlated, errors.wider(factor).log_likelihood(worse))
    assert one.log_correlated - two.log_correlated == pytest.approx(0.5 * 117 * (1.3**2 - 1))
    assert not one.explained  # more than three times what is known


def test_what_even_the_best_kind_calls_an_outlier_tells_of_none():
    errors, rng = _errors(40), np.random.default_rng(3)
    e = 0.01 * rng.normal(size=(40, 3)).clip(-1.5, 1.5)
    flipped = e.copy()
    flipped[17] += [2.0, 0.0, 0.0]
    source = OrientationSource(np.tile(np.eye(3), (40, 1, 1)), errors, FitConfig())
    (said,) = source.levelled([_said(flipped)])
    kept = np.delete(np.arange(40), 17)
    assert said.explained
    assert_allclose(said.log_correlated, errors.restricted(kept).log_likelihood(e[kept]))
