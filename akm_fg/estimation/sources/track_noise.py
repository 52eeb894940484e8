"""How many observations of the tracks err together: over time and over the part."""

from __future__ import annotations

import numpy as np

from akm_fg.estimation.sources.tracks import TrackContribution
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.records import BoolArray, FloatArray

_NEGLIGIBLE = 0.05  # correlations below it do not matter; of few residuals, chance is larger
_RANKS = 16  # nearest points that are looked at first: most noise errs together with few
_SOLVER_SHARE = 3e-3  # of the noise variance: what the solver's tolerances leave
_LEAST_FRAMES = 8  # with fewer nothing is said of time
_LEAST_POINTS = 8  # nor of space


def correlation_frames(tracks: TrackContribution) -> tuple[float, float]:
    """Integrated autocorrelation time of the residuals in frames, and their visible share.

    Noise of neighbouring frames that errs together (a marker's bias, a drifting track) counts
    once, not once a frame. The sum of the autocorrelations up to the first that is not positive
    (Geyer, Practical Markov Chain Monte Carlo, 1992, sec. 3.3), averaged over tracks.

    The fit hides the slowest errors: of a path's deviation the offset, the slope and the bend,
    of a whole part's tracks their offsets. What is left shows only a share of variance and
    correlation time (cf. Marriott and Pope, Bias in the estimation of autocorrelations, 1954).

    Returns:
        The time, at least one and corrected for what is hidden; the share of the variance that
        the residuals show, between 1/3 and 1.
    """
    observed = tracks.observed
    if observed.shape[0] < _LEAST_FRAMES:
        return 1.0, 1.0
    hidden = 3 if observed.shape[1] < MIN_POINTS else 1
    return correlation_time(_clipped(tracks), observed, hidden, _solver_variance(tracks))


def correlation_time(
    e: FloatArray, observed: BoolArray, hidden: int, least_variance: float
) -> tuple[float, float]:
    """Integrated autocorrelation time of residuals in frames, and their visible share.

    The sum ends where a correlation falls below what can be told from none, c = max(0.05,
    2 / sqrt(numbers)). What follows is left out: nothing of noise that errs together over a few
    frames only (moving averages); of noise of first order, r^k, a share 2 c / (1 + r) of the time
    (1 + r) / (1 - r), six per cent for r = 0.8. To add that tail would make the times of moving
    averages up to half too long; the data do not say which noise it is. What the fit hides is
    corrected for to first order in the time seen over the frames: with one hidden term and r = 0.8
    a tenth is missing in all in 200 frames, a quarter in 60.

    Args:
        e: (T, N, p) residuals, zero where not observed.
        observed: (T, N).
        hidden: slow terms of each series that the fit takes away (offset, slope, bend).
        least_variance: of a residual's coordinate, below which it is the solver's own.
    """
    numbers = e.shape[-1] * observed.sum()
    variance = max((e * e).sum() / observed.sum(), least_variance)
    if not variance > 0:  # an exact path: nothing is left that could be correlated
        return 1.0, 1.0
    negligible = max(_NEGLIGIBLE, 2 / np.sqrt(numbers))
    tau = 1.0
    for lag in range(1, observed.shape[0] // 2):
        pairs = int((observed[lag:] & observed[:-lag]).sum())
        if pairs == 0:
            break
        rho = float((e[lag:] * e[:-lag]).sum() / pairs / variance)
        if rho <= negligible:
            break
        tau += 2 * rho
    if tau == 1.0:
        return 1.0, 1.0
    visible = max(1 - hidden * tau / observed.shape[0], 1 / 3)
    return tau / visible, visible


def correlated_points(tracks: TrackContribution) -> float:
    """How many neighbouring points err together; at least one.

    One plus the sum of the residuals' correlations with the nearest, second nearest, ... point,
    averaged over the points, up to the first that is not positive: what `correlation_frames` is
    over time, over the part. Stereo depth errs alike over a matching window.
    """
    observed = tracks.observed
    count = observed.shape[1]
    if count < _LEAST_POINTS:
        return 1.0
    e = _clipped(tracks)
    power = (e * e).sum(axis=(0, 2))
    power = np.maximum(power, _solver_variance(tracks) * observed.sum(axis=0))
    unit = e.transpose(1, 0, 2).reshape(count, -1) / np.sqrt(power + 1e-300)[:, None]
    together, distance2 = unit @ unit.T, _squared_distances(tracks.x_joint)
    negligible = max(_NEGLIGIBLE, 3 / np.sqrt(3 * observed.sum()))
    for ranks in (_RANKS, count):
        by_rank = _by_rank(together, distance2, min(ranks, count))
        below = np.flatnonzero(by_rank[1:] <= negligible)
        if below.size:
            break
    last = int(below[0]) if below.size else count - 1
    return 1.0 + float(by_rank[1 : 1 + last].sum())


def _squared_distances(x: FloatArray) -> FloatArray:
    """(N, N) between points (3, N); each is its own nearest."""
    squares = (x * x).sum(axis=0)
    distance2: FloatArray = squares[:, None] + squares - 2 * (x.T @ x)
    np.fill_diagonal(distance2, -1.0)
    return distance2


def _by_rank(together: FloatArray, distance2: FloatArray, ranks: int) -> FloatArray:
    """Mean over the points of `together` (N, N) with the nearest, second nearest, ..., (ranks,)."""
    near = np.argpartition(distance2, ranks - 1, axis=1)[:, :ranks]
    order = np.argsort(np.take_along_axis(distance2, near, axis=1), axis=1)
    near = np.take_along_axis(near, order, axis=1)
    return np.asarray(np.take_along_axis(together, near, axis=1).mean(axis=0))


def _solver_variance(tracks: TrackContribution) -> float:
    """Mean squared residual (m^2) below which residuals are the solver's own, not the noise's."""
    return _SOLVER_SHARE * tracks.noise_variance


def _clipped(tracks: TrackContribution) -> FloatArray:
    """Residuals (T, N, 3), outliers pulled in: they are rejected, not averaged over."""
    observed = tracks.observed
    d = np.sqrt(np.maximum(tracks.d2, 1e-300))
    limit = 3 * np.median(d[observed])
    e = np.where(observed[..., None], tracks.residual_joint, 0.0)
    return e * np.minimum(1.0, limit / np.maximum(d, 1e-12))[..., None]
