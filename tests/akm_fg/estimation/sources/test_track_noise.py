"""Noise that errs together, over time and over the part, with correlations that are known."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.sources.source import NoiseLevel
from akm_fg.estimation.sources.track_noise import (
    correlated_points,
    correlation_frames,
    correlation_time,
)
from akm_fg.estimation.sources.tracks import TrackContribution, TrackSource
from factors.measurements.track_cost import TrackObservations


def averaged(rng: np.random.Generator, T: int, N: int, frames: int) -> np.ndarray:
    """(T, N, 3) of unit variance: each the sum of the last so many white numbers.

    Correlations fall from 1 to 0 evenly, 1 - k / frames: the time is 1 + 2 (frames - 1) / 2.
    """
    white = np.concatenate([np.zeros((1, N, 3)), rng.normal(size=(T + frames, N, 3))])
    sums = white.cumsum(axis=0)
    return (sums[frames : frames + T] - sums[:T]) / np.sqrt(frames)


def without_slow_terms(e: np.ndarray, terms: int) -> np.ndarray:
    """What a fit of offset, slope, bend ... of each series leaves."""
    T = len(e)
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, T), terms, increasing=True))
    flat = e.reshape(T, -1)
    return (flat - basis @ (basis.T @ flat)).reshape(e.shape)


def said(residual: np.ndarray, x_joint: np.ndarray | None = None) -> TrackContribution:
    """Tracks with these residuals, in units of their noise of 1 mm."""
    T, N, _ = residual.shape
    x = np.random.default_rng(5).uniform(size=(3, N)) if x_joint is None else x_joint
    return TrackContribution(
        information=np.eye(6),
        held=np.ones(T),
        observed=np.ones((T, N), bool),
        d2=(residual**2).sum(axis=-1),
        residual_joint=0.001 * residual,
        slips=None,
        x_joint=x,
        scale=1.0,
        freedom=1.0,
    )


@pytest.mark.parametrize(("frames", "T", "terms"), [(2, 20, 3), (2, 40, 1), (4, 60, 3), (4, 80, 1)])
def test_the_correlation_time_is_that_of_the_noise_whatever_the_fit_has_hidden(
    frames: int, T: int, terms: int
):
    """A fit of offset, slope and bend takes `terms` of the T / frames independent values away.

    What is left has correlations smaller by about c = terms * frames / T of the variance: for
    four frames in 60 and three terms 3.25 frames would show, for two in 20 1.57.
    """
    rng = np.random.default_rng(0)
    left = without_slow_terms(averaged(rng, T, 200, frames), terms)
    time, visible = correlation_time(left, np.ones((T, 200), bool), terms, 0.0)
    assert_allclose(time, frames, rtol=0.08)
    assert_allclose(visible, (left**2).mean(), atol=0.08)


def test_of_noise_of_first_order_the_time_lacks_the_tail_that_cannot_be_told_from_none():
    """Of (1 + r) / (1 - r) = 9 frames a share 2 * 0.05 / (1 + r): what is left out below 0.05."""
    rng, r, times = np.random.default_rng(6), 0.8, []
    for _ in range(10):
        e = rng.normal(size=(60, 40, 3))
        for t in range(1, 60):
            e[t] = r * e[t - 1] + np.sqrt(1 - r * r) * e[t]
        times.append(correlation_time(e, np.ones((60, 40), bool), 0, 0.0)[0])
    assert_allclose(np.mean(times), 9 * (1 - 2 * 0.05 / (1 + r)), rtol=0.04)


def test_the_time_of_tracks_is_that_of_their_noise():
    rng = np.random.default_rng(1)
    time, visible = correlation_frames(said(without_slow_terms(averaged(rng, 80, 60, 4), 1)))
    assert_allclose(time, 4.0, rtol=0.08)
    assert_allclose(visible, 1 - 4 / 80, atol=0.03)


def test_independent_noise_errs_for_one_frame():
    e = np.random.default_rng(2).normal(size=(50, 40, 3))
    assert correlation_frames(said(e)) == (1.0, 1.0)
    assert correlated_points(said(e)) == 1.0


def test_a_few_gross_outliers_do_not_tell_of_time():
    """One track in sixty is thirty deviations off for ten frames: it is rejected, not averaged."""
    rng = np.random.default_rng(3)
    quiet = rng.normal(size=(80, 60, 3))
    quiet[30:40, 7] += 30.0
    assert correlation_frames(said(quiet))[0] < 1.5
    assert correlated_points(said(quiet)) < 1.5


def test_points_in_groups_that_err_alike_count_as_their_groups():
    """Twelve heaps of five points, far apart: 1 + 4 correlations of one."""
    rng = np.random.default_rng(4)
    e = np.repeat(rng.normal(size=(60, 12, 3)), 5, axis=1)
    heaps = np.arange(12)[:, None] + 0.01 * rng.normal(size=(12, 5))
    x = np.stack([heaps.ravel(), np.zeros(60), np.zeros(60)])
    assert_allclose(correlated_points(said(e, x)), 5.0, atol=0.1)
    # Half of the variance of each alone: 1 + 4 * 0.5.
    half = np.sqrt(0.5) * (e + rng.normal(size=e.shape))
    assert_allclose(correlated_points(said(half, x)), 3.0, atol=0.25)


def test_too_few_frames_or_points_say_nothing():
    e = np.ones((7, 20, 3))
    assert correlation_frames(said(e)) == (1.0, 1.0)
    assert correlated_points(said(np.ones((30, 7, 3)))) == 1.0


def source(**settings) -> TrackSource:
    """Tracks of 50 points in 40 frames, every coordinate 1 mm."""
    p = np.random.default_rng(0).normal(size=(40, 50, 3))
    cov = np.tile(1e-6 * np.eye(3), (40, 50, 1, 1))
    config = replace(FitConfig(), dof=1e9)
    seen = TrackObservations.from_points(p, cov)
    return TrackSource(seen, False, 1.0, config, **settings)


def test_the_noise_scale_is_that_of_the_noise_where_the_fit_hides_a_share_of_it():
    """Of squared residuals of 3 a point one fifth is hidden, another tenth was fitted."""
    d2 = np.full((40, 50), 3 * 0.8 * 0.9)
    assert_allclose(source(visible_share=0.8).rescaled(d2, 1.0, 0.9, None), 1.0)
    # A level of 2, known as well as by as many observations, against the 1 that is seen.
    level = NoiseLevel(2.0, 3 * 40 * 50 * 0.9)
    got = source(visible_share=1.0).rescaled(np.full((40, 50), 3 * 0.9), 1.0, 0.9, level)
    assert_allclose(got**2, (1.0 + 4.0) / 2)


def test_systematic_errors_count_observations_down_to_their_modes():
    """2000 of 1 mm average to 1 mm^2 / 2000, systematic 0.2 mm in 4 ways to 0.04 mm^2 / 4."""
    config = FitConfig()
    tracks = source(systematic_m=2e-4)
    ratio = (0.04 / 4) / (1.0 / 2000)
    assert_allclose(tracks.systematic_points(config.sound_noise_scale, 1e-6), ratio)
    # Twice as noisy as on texture: they slip, and their systematic errors are twice as large.
    assert_allclose(tracks.systematic_points(2 * config.sound_noise_scale, 1e-6), 4 * ratio)
    assert tracks.numbers == (3 * 2000, 3 * 50)
