"""From solved graphs to the probability of each kind, and whether any kind explains the data."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy import stats

from akm_fg.estimation.config import PriorConfig
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.one_kind.laplace import KindFit
from factors.joint import JointKind

SCREW, HINGE = JointKind.HELICAL, JointKind.REVOLUTE
# Numbers of a frame's motion, for a joint to pick from.
_FREE_NUMBERS = {JointKind.PRISMATIC: 3, JointKind.REVOLUTE: 6}
_TRACY_WIDOM_99 = 2.02  # quantile of the Tracy-Widom law of order one


def levelled(fits: list[KindFit], problem: FitProblem) -> list[KindFit]:
    """The kinds with each source's noise at a level that all share, as far as it knows one."""
    for source in problem.sources:
        at = [i for i, fit in enumerate(fits) if source.name in fit.said]
        for i, said in zip(
            at, source.levelled([fits[i].said[source.name] for i in at]), strict=True
        ):
            fits[i] = replace(fits[i], said={**fits[i].said, source.name: said})
    return fits


def left_out_warnings(problem: FitProblem) -> list[str]:
    """That rows of a pose log were left out, and how many."""
    count, rows = problem.rows_left_out, problem.points.p_world.shape[0]
    if not count:
        return []
    return [f"{count} of {rows} rows jump away and come back; they were left out"]


def turn_warnings(fit: KindFit, problem: FitProblem) -> list[str]:
    """Between which frames a part turned so far that full turns cannot be counted."""
    frames = problem.known_frames
    if fit.joint is None or not fit.joint.kind.turns or frames.size < 2:
        return []
    q = np.interp(frames, problem.keyframes, fit.q)
    steps = np.abs(np.diff(q))
    worst = int(np.argmax(steps))
    if steps[worst] <= problem.config.countable_turn_rad:
        return []
    degrees = math.degrees(float(steps[worst]))
    return [
        f"between frames {frames[worst]} and {frames[worst + 1]} the part turned by {degrees:.0f} "
        "deg or that and full turns: frames are too far apart to count them"
    ]


def nested_screw(fits: list[KindFit], problem: FitProblem) -> list[KindFit]:
    """A screw may only win by a pitch that neither systematic errors nor a hinge's play explain.

    The hinge is the screw of pitch zero, or nearly: pitch ~ N(0, play^2) against N(0, sigma^2) of
    a screw. The ratio of their evidences is the mean, over the screw's posterior N(h, s^2) with
    systematic errors included, of the ratio of the two priors (without play the posterior over
    the prior at zero: Dickey, 1971):

        sigma / play sqrt(v / (v + s^2)) exp(-h^2 / (2 (v + s^2))),  1/v = 1/play^2 - 1/sigma^2.

    Play is a length, and what slides in it goes to and fro: over n times the turn in which it is
    given, the slide is that of n independent ones, whose trend is n^-3/2 times as steep.
    """
    by_kind = {fit.kind: fit for fit in fits}
    if not {SCREW, HINGE} <= by_kind.keys():
        return fits
    screw, prior = by_kind[SCREW], problem.config.prior
    sigma = prior.pitch_sigma_m_per_rad
    turned = max(float(np.ptp(screw.q)), prior.hinge_play_turn_rad)
    play = prior.hinge_play_m_per_rad * (prior.hinge_play_turn_rad / turned) ** 1.5
    v = 1 / (play**-2 - sigma**-2)
    width = v + screw.pitch_sd**2
    lag = math.log(sigma / play) + 0.5 * math.log(v / width) - screw.moving.pitch**2 / (2 * width)
    excess = screw.log_evidence - (by_kind[HINGE].log_evidence - lag)
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
        free = None if fit.joint is None else _FREE_NUMBERS.get(fit.joint.kind)
        if free is not None and fit.q.size > 2:
            limit = _largest_by_chance((fit.q.size - 1) / fit.as_one, free)
            if 2 * (fit.evidence.log_likelihood - rest.evidence.log_likelihood) > limit:
                return False
            if fit.kind == JointKind.PRISMATIC and not _would_show(fit, limit, prior):
                return False
    return True


def _would_show(drawer: KindFit, limit: float, prior: PriorConfig) -> bool:
    """Whether the least motion that matters would pass the test's limit, in 99 of 100 cases."""
    states = drawer.q.size - 1
    information = float(np.diag(drawer.information)[-states:].sum()) / drawer.as_one
    signal = information * prior.motion_that_matters_m**2 / 12
    return bool(stats.ncx2.cdf(limit, states / drawer.as_one, signal) <= 0.01)


def _largest_by_chance(n: float, p: int) -> float:
    """99 % quantile of the largest eigenvalue of a white Wishart matrix, n samples of p numbers."""
    root_n, root_p = math.sqrt(max(n - 1, 1.0)), math.sqrt(p)
    width = (root_n + root_p) * (1 / root_n + 1 / root_p) ** (1 / 3)
    return (root_n + root_p) ** 2 + _TRACY_WIDOM_99 * width


def is_parametric(fit: KindFit, problem: FitProblem, as_one: float) -> bool:
    """Whether the fit's residuals are noise: a chi-square test, the worst tenth trimmed.

    The noise is what can be seen without assuming a joint (`local_scale`), plus a systematic
    part proportional to the travel: real parts flex and have play. Where another source says more
    than the tracks (the surface: its readings, smoothed as they are, must not be off by more than
    a single raw reading may be), it decides. A few tracks that slip along edges contradict no
    joint.

    What is smooth looks like correlated noise, of which little is independent: a chi-square test
    of that little lets large misfits pass. So the misfit's mean square, less the noise that can be
    seen without a joint, may also not exceed the systematic part in both directions across the way.
    """
    tracks = fit.tracks
    if problem.marker and any(said.explained is False for said in fit.said.values()):
        return False
    others = [said for said in fit.said.values() if said.explained is not None]
    most = max(others, key=lambda said: said.readings, default=None)
    if most is not None and most.readings > tracks.readings:
        return bool(most.explained)
    e2 = tracks.squared_error_m2[tracks.observed]
    given = e2 / np.maximum(tracks.d2[tracks.observed], 1e-300)
    systematic_m = problem.config.systematic_share * problem.travel_m
    sigma2 = given * problem.local_scale**2 + systematic_m**2
    d2 = np.sort(e2 / sigma2)[: max(int(0.9 * e2.size), 1)]
    # Of three error components the states and latent points absorb a share: residuals shrink.
    independent = max(d2.size / as_one, 2.0) * 3 * tracks.freedom
    limit = stats.chi2.ppf(1 - problem.config.parametric_p_value, independent) / independent
    share = tracks.freedom * _trimmed_chi2_mean(3.0)
    if d2.mean() / share > limit:
        return False
    if _is_mostly_noise(fit, problem):
        return False
    order = np.argsort(e2 / sigma2)[: d2.size]
    seen_m2 = share * float((given * problem.local_scale**2)[order].mean())
    return bool(e2[order].mean() - limit * seen_m2 <= 2 * systematic_m**2)


def _is_mostly_noise(fit: KindFit, problem: FitProblem) -> bool:
    """Whether a typical residual is too large a share of how far apart all positions lie.

    Points that jump about at random fit no rigid part, and their noise, which is found in the data,
    passes any test against itself. A joint has to explain most of where they are.
    """
    tracks = fit.tracks
    one = tracks.observed.shape[1] == 1
    if problem.tracks.noise_known or (fit.joint is None and one):
        return False  # one point at rest is nothing but noise about its place
    p_world = problem.tracks.observations.p_world.transpose(0, 2, 1)[tracks.observed]
    apart_m2 = float(np.median(((p_world - np.median(p_world, axis=0)) ** 2).sum(axis=-1)))
    rest_m2 = float(np.median(tracks.squared_error_m2[tracks.observed]))
    return rest_m2 > problem.config.largest_rest**2 * apart_m2


def _trimmed_chi2_mean(freedom: float) -> float:
    """Mean of a chi-square variable below its 90 % quantile."""
    q = stats.chi2.ppf(0.9, freedom)
    return float(freedom * stats.chi2.cdf(q, freedom + 2) / 0.9)
