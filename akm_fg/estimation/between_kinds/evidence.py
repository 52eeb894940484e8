"""From solved graphs to the probability of each kind, and whether any kind explains the data."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy import stats

from akm_fg.estimation.config import PriorConfig
from akm_fg.estimation.given.observations import Observations, dense_freedom
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.records import FloatArray
from factors.student_t import covariance_factor

_NEGLIGIBLE = 0.05  # correlations below it do not matter; of few residuals, chance is larger
_RANKS = 16  # nearest points that are looked at first: most noise errs together with few
_FREE_NUMBERS = {"prismatic": 3, "revolute": 6}  # of a frame's motion, for a joint to pick from
_TRACY_WIDOM_99 = 2.02  # quantile of the Tracy-Widom law of order one
_SOLVER_SHARE = 3e-3  # of the noise variance: what the solver's tolerances leave


def correlation_frames(fit: KindFit, observations: Observations) -> tuple[float, float]:
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
    observed = observations.tracks.observed
    if observed.shape[0] < 8:
        return 1.0, 1.0
    e = _clipped(fit, observations)
    variance = (e * e).sum() / observed.sum()
    variance = max(variance, _solver_variance(fit, observations))
    negligible = max(_NEGLIGIBLE, 2 / np.sqrt(3 * observed.sum()))
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
    hidden = 3 if observed.shape[1] < MIN_POINTS else 1
    visible = max(1 - hidden * tau / observed.shape[0], 1 / 3)
    return tau / visible, visible


def correlated_points(fit: KindFit, observations: Observations) -> float:
    """How many neighbouring points err together; at least one.

    One plus the sum of the residuals' correlations with the nearest, second nearest, ... point,
    averaged over the points, up to the first that is not positive: what `correlation_frames` is
    over time, over the part. Stereo depth errs alike over a matching window.
    """
    observed = observations.tracks.observed
    count = observed.shape[1]
    if count < 8:
        return 1.0
    e = _clipped(fit, observations)
    power = (e * e).sum(axis=(0, 2))
    power = np.maximum(power, _solver_variance(fit, observations) * observed.sum(axis=0))
    unit = e.transpose(1, 0, 2).reshape(count, -1) / np.sqrt(power + 1e-300)[:, None]
    together, distance2 = unit @ unit.T, _squared_distances(fit.x_joint)
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


def systematic_points(fit: KindFit, problem: FitProblem) -> float:
    """How many observations count as one beyond the correlated, for the sensor's systematic errors.

    n observations of variance s^2 average to s^2 / n; errors of variance b^2 with m independent
    modes add b^2 / m, whatever n is. The ratio of the two is what to count down by. Tracks noisier
    than told follow edges and slip along them: their systematic errors grow with their noise.
    """
    observed = problem.observations.tracks.observed
    if not observed.any():
        return 0.0
    variance = _noise_variance(fit, problem.observations)
    variance *= min(1.0, problem.config.sound_noise_scale / fit.scales.track) ** 2
    systematic_m = problem.systematic_m
    return _beyond_averaging(int(observed.sum()), max(variance, 1e-12), systematic_m, problem)


def _noise_variance(fit: KindFit, observations: Observations) -> float:
    """Typical variance of a coordinate (m^2): the given covariances, scaled as the fit found."""
    observed = observations.tracks.observed
    given = np.median((fit.squared_error_m2 / np.maximum(fit.d2, 1e-300))[observed])
    return float(given) * fit.scales.track**2


def _solver_variance(fit: KindFit, observations: Observations) -> float:
    """Mean squared residual (m^2) below which residuals are the solver's own, not the noise's."""
    return _SOLVER_SHARE * _noise_variance(fit, observations)


def _clipped(fit: KindFit, observations: Observations) -> FloatArray:
    """Residuals (T, N, 3), outliers pulled in: they are rejected, not averaged over."""
    observed = observations.tracks.observed
    d = np.sqrt(np.maximum(fit.d2, 1e-300))
    limit = 3 * np.median(d[observed])
    e = np.where(observed[..., None], fit.residual_joint, 0.0)
    return e * np.minimum(1.0, limit / np.maximum(d, 1e-12))[..., None]


def systematic_readings(fit: KindFit, problem: FitProblem) -> float:
    """The same of the dense patches' readings."""
    dense = problem.observations.dense
    if dense is None:
        return 0.0
    precision = dense.patches.precision[dense.patches.seen]
    variance = fit.scales.dense**2 / float(np.median(precision))
    return _beyond_averaging(precision.size, variance, problem.config.surface_systematic_m, problem)


def _beyond_averaging(
    count: int, variance: float, systematic_m: float, problem: FitProblem
) -> float:
    """Systematic variance over that of the mean of `count` observations of a variance (m^2)."""
    return count * systematic_m**2 / (problem.config.systematic_modes * variance)


def temper(fit: KindFit, tau: float, problem: FitProblem) -> KindFit:
    """The fit with one in `tau` observations counted; the solution stays.

    Systematic errors (see `systematic_points`) widen the covariance alone: errors of that size
    bend what is seen a little, but do not make a door of a drawer, as counting fewer observations
    in the evidence would.

    With the graph's information H = H_tracks + H_dense and true variances c times the claimed,
    the covariance is H^-1 (c_tracks H_tracks + c_dense H_dense) H^-1 (the sandwich; Huber and
    Ronchetti, Robust Statistics, 2009, sec. 3.2).
    """
    of_tracks = fit.cov_factor * (tau + systematic_points(fit, problem))
    cov = fit.cov / fit.cov_factor
    dense = problem.observations.dense
    others: list[tuple[float, FloatArray]] = []
    if dense is not None and fit.dense_cost is not None:
        d2 = fit.dense_cost.d2[dense.patches.seen]
        of_dense = covariance_factor(d2, problem.config.dof, 1, dense_freedom(dense.patches))
        of_dense *= tau + systematic_readings(fit, problem) / dense.count_as_one
        others.append((of_dense, fit.dense_information))
    if fit.grasp is not None and fit.T_world_joint is not None:
        others.append((fit.grasp.cov_factor, fit.grasp.information))
    if not others:
        return replace(fit, cov=cov * of_tracks, cov_factor=of_tracks, tau=tau)
    tracks = fit.information
    for _, information in others:
        tracks = tracks - information
    true = of_tracks * _positive(tracks, np.diag(fit.information))
    for factor, information in others:
        true = true + factor * information
    return replace(fit, cov=cov @ true @ cov, cov_factor=of_tracks, tau=tau)


def _positive(information: FloatArray, scale: FloatArray) -> FloatArray:
    """A difference of informations without the negative eigenvalues that rounding leaves."""
    d = np.sqrt(np.maximum(scale, 1e-300))
    eigenvalues, vectors = np.linalg.eigh(information / np.outer(d, d))
    clipped = (vectors * np.maximum(eigenvalues, 0.0)) @ vectors.T
    return np.asarray(clipped * np.outer(d, d))


def nested_screw(fits: list[KindFit], problem: FitProblem) -> list[KindFit]:
    """A screw may only win by a pitch that neither systematic errors nor a hinge's play explain.

    The hinge is the screw of pitch zero, or nearly: pitch ~ N(0, play^2) against N(0, sigma^2) of
    a screw. The ratio of their evidences is the mean, over the screw's posterior N(h, s^2) with
    systematic errors included, of the ratio of the two priors (without play the posterior over
    the prior at zero: Dickey, 1971):

        sigma / play sqrt(v / (v + s^2)) exp(-h^2 / (2 (v + s^2))),  1/v = 1/play^2 - 1/sigma^2.
    """
    by_kind = {fit.kind: fit for fit in fits}
    if not {"helical", "revolute"} <= by_kind.keys():
        return fits
    screw, prior = by_kind["helical"], problem.config.prior
    sigma, play = prior.pitch_sigma_m_per_rad, prior.hinge_play_m_per_rad
    v = 1 / (play**-2 - sigma**-2)
    width = v + screw.pitch_sd**2
    lag = math.log(sigma / play) + 0.5 * math.log(v / width) - screw.pitch**2 / (2 * width)
    excess = screw.log_evidence - (by_kind["revolute"].log_evidence - lag)
    return [replace(f, log_nested=min(-excess, 0.0)) if f is screw else f for f in fits]


def kind_probabilities(fits: list[KindFit], prior: PriorConfig) -> dict[str, float]:
    """Posterior probability of every kind in the prior; zero for one that could not be fitted."""
    log_p = {f.kind: f.log_evidence + math.log(prior.kind_probability[f.kind]) for f in fits}
    top = max(log_p.values())
    total = sum(math.exp(v - top) for v in log_p.values())
    return {
        kind: math.exp(log_p[kind] - top) / total if kind in log_p else 0.0
        for kind in prior.kind_probability
    }


def rest_is_shown(fits: list[KindFit], prior: PriorConfig) -> bool:
    """Whether the data show that nothing moved, not only that they show no motion.

    Its prior makes the evidence prefer rest to a motion near the noise. That is no ground to say
    that nothing moved. Rest is named where a test accepts it that would have found a motion that
    matters. At rest, a joint picks of the T - 1 free displacements' noise (three numbers of a
    drawer, six of a hinge) the direction of largest variance, so that twice the gain in log
    likelihood is distributed as the largest eigenvalue of a white Wishart matrix (Johnstone, On
    the distribution of the largest eigenvalue in principal components analysis, 2001, eqs. 1.3 to
    1.5); with a drawer moved by states evenly spread over the least motion that matters, it
    exceeds a chi-square variable of T - 1 degrees of freedom with their signal as noncentrality.
    """
    rest = next(fit for fit in fits if fit.kind == "rigid")
    for fit in fits:
        if fit.kind in _FREE_NUMBERS and fit.q.size > 2:
            limit = _largest_by_chance((fit.q.size - 1) / fit.tau, _FREE_NUMBERS[fit.kind])
            if 2 * (fit.evidence.log_likelihood - rest.evidence.log_likelihood) > limit:
                return False
            if fit.kind == "prismatic" and not _would_show(fit, limit, prior):
                return False
    return True


def _would_show(drawer: KindFit, limit: float, prior: PriorConfig) -> bool:
    """Whether the least motion that matters would pass the test's limit, in 99 of 100 cases."""
    states = drawer.q.size - 1
    information = float(np.diag(drawer.information)[-states:].sum()) / drawer.tau
    signal = information * prior.motion_that_matters_m**2 / 12
    return bool(stats.ncx2.cdf(limit, states / drawer.tau, signal) <= 0.01)


def _largest_by_chance(n: float, p: int) -> float:
    """99 % quantile of the largest eigenvalue of a white Wishart matrix, n samples of p numbers."""
    root_n, root_p = math.sqrt(max(n - 1, 1.0)), math.sqrt(p)
    width = (root_n + root_p) * (1 / root_n + 1 / root_p) ** (1 / 3)
    return (root_n + root_p) ** 2 + _TRACY_WIDOM_99 * width


def is_parametric(fit: KindFit, problem: FitProblem, tau: float) -> bool:
    """Whether the fit's residuals are noise: a chi-square test, the worst tenth trimmed.

    The noise is what can be seen without assuming a joint (`local_scale`), plus a systematic
    part proportional to the travel: real parts flex and have play. Where the surface says more
    than the tracks, it decides: its readings, smoothed as they are, must not be off by more than
    a single raw reading may be. A few tracks that slip along edges contradict no joint.
    """
    config, observed = problem.config, problem.observations.tracks.observed
    dense = problem.observations.dense
    if dense is not None:
        readings = float(dense.patches.seen.sum()) / (dense.count_as_one * tau)
        if readings > 3 * int(observed.sum()) / tau:
            return fit.scales.dense <= config.surface_noise_limit
    e2 = fit.squared_error_m2[observed]
    given = e2 / np.maximum(fit.d2[observed], 1e-300)
    systematic_m = config.systematic_share * problem.travel_m
    sigma2 = given * problem.local_scale**2 + systematic_m**2
    d2 = np.sort(e2 / sigma2)[: max(int(0.9 * e2.size), 1)]
    # Of three error components the states and latent points absorb a share: residuals shrink.
    independent = max(d2.size / tau, 2.0) * 3 * fit.freedom
    limit = stats.chi2.ppf(1 - config.parametric_p_value, independent) / independent
    return bool(d2.mean() / (fit.freedom * _trimmed_chi2_mean(3.0)) <= limit)


def _trimmed_chi2_mean(freedom: float) -> float:
    """Mean of a chi-square variable below its 90 % quantile."""
    q = stats.chi2.ppf(0.9, freedom)
    return float(freedom * stats.chi2.cdf(q, freedom + 2) / 0.9)
