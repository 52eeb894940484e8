"""Evidence of a hinge whose distance the positions of a marker leave vague.

A short or slightly bent path fits hinges from half a metre to infinity: the posterior over the
distance is no Gaussian around its mode, and Laplace's evidence there may be off by a factor of ten
either way. The prior of the distance is a log-normal, and so a mixture of narrow ones,

    N(log m, s^2) = sum over k of w_k N(log m_k, n^2),    w_k ~ N(log m_k; log m, s^2 - n^2),

for nodes log m_k closer together than n. Under each narrow prior the rest is nearly Gaussian, and
Laplace's method is good there: the evidence is the weighted mean of theirs.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from akm_fg.errors import AxisUnobservable
from akm_fg.estimation.config import PriorConfig
from akm_fg.estimation.given.motion_fit import nearest_origin
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.one_kind.joint_chart import JointChart
from akm_fg.estimation.one_kind.kind_fit import fit_kind
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.geometry.joint_guess import JointGuess

_VAGUE = 0.15  # sd of the log distance beyond which the mode does not speak for the posterior
_NARROW = 0.4  # share of the prior's spread that a node keeps for itself, log distance
_NEGLIGIBLE = 5.0  # nats behind the best node, beyond which those farther out do not count
_ROUNDS = 2  # of the noise scale: neighbours have nearly the same
_REACH = 3.5  # of the prior's standard deviations that the nodes cover


def with_vague_hinges(fits: list[KindFit], problem: FitProblem) -> list[KindFit]:
    """The kinds with the evidence of vague hinges over all distances; as they are, else."""
    if not problem.marker or problem.motions is not None:  # turns tell the distance
        return fits
    return [_over_distances(fit, problem) if _is_vague(fit, problem) else fit for fit in fits]


def _is_vague(fit: KindFit, problem: FitProblem) -> bool:
    if fit.joint is None or not fit.joint.kind.turns:
        return False
    chart = JointChart.at(fit.joint, problem.centroid_world)
    return bool(np.sqrt(chart.covariance(fit)[2, 2]) > _VAGUE)


def _over_distances(fit: KindFit, problem: FitProblem) -> KindFit:
    """With `log_beyond` so that its evidence is that of the mixture."""
    prior = problem.config.prior
    middle, spread = math.log(prior.hinge_distance_m), prior.hinge_distance_sigma_log
    if spread <= _NARROW:
        return fit
    between = math.sqrt(spread**2 - _NARROW**2)
    count = 2 * math.ceil(_REACH * between / _NARROW) + 1
    nodes = np.linspace(-_REACH, _REACH, count)
    log_weights = -0.5 * nodes**2 - np.log(np.exp(-0.5 * nodes**2).sum())
    log_evidence = np.full(count, -np.inf)
    _, here = nearest_origin(fit.moving, problem.centroid_world)
    first = int(np.argmin(np.abs(middle + between * nodes - math.log(here))))
    for way in (range(first, count), range(first - 1, -1, -1)):  # each from its neighbour
        near, most = fit, -np.inf
        for k in way:
            narrow = replace(
                prior,
                hinge_distance_m=math.exp(middle + between * float(nodes[k])),
                hinge_distance_sigma_log=_NARROW,
            )
            try:
                near = _at_distance(near, problem, narrow).tempered(fit.as_one)
            except AxisUnobservable:
                break
            log_evidence[k] = near.log_evidence
            most = max(most, log_weights[k] + log_evidence[k])
            if log_weights[k] + log_evidence[k] < most - _NEGLIGIBLE:
                break
    terms = log_weights + log_evidence
    top = float(terms.max())
    if not math.isfinite(top):
        return fit
    return replace(fit, log_beyond=top + math.log(np.exp(terms - top).sum()) - fit.log_evidence)


def _at_distance(fit: KindFit, problem: FitProblem, prior: PriorConfig) -> KindFit:
    """Solved again under a narrow prior of the distance, from the hinge moved there."""
    T, rho = nearest_origin(fit.moving, problem.centroid_world)
    T[:3, 3] += (prior.hinge_distance_m - rho) * T[:3, 0]
    q = fit.q * rho / prior.hinge_distance_m
    there = JointGuess(replace(fit.moving, T_world_joint=T), q)
    config = replace(problem.config, prior=prior, scale_iterations=_ROUNDS)
    narrowed = replace(problem, config=config)
    return fit_kind(there, narrowed, effort="rough")
