"""Mean and covariance of a joint that the data leave so vague that Laplace's method misleads.

Short openings in noise leave an axis open by many degrees and a hinge by a factor; the states are
then as uncertain as they are large, and a Gaussian at the mode, with states that are free one by
one, is too narrow: half as many truths again lie outside its 95 % regions. Here joint and travel
are sampled, the states integrated out:

- the tracks speak through their quadratic form over free motions (`factors.motion_information`);
- the states of frames 1.. are one draw each from N(m, spread^2), as arcs at the part's middle, with
  m and log spread flat: a motion near the noise is not to be explained by noise. (The first frame,
  where the part is often closed, is an end of its travel and not one of them.)
- given joint and spread the arcs are Gaussian, one Gauss-Newton step from their mean;
- importance sampling from a Student-t that adapts to its own samples (population Monte Carlo;
  Cappe et al., 2004) over `joint_chart` and log spread. The draws are a fixed low-discrepancy
  set: the same data give the same answer;
- where the samples never come to match (several shapes of the motion explain the data), those that
  the next proposal would be made from answer: flattened, so rather too wide than too narrow;
- the covariance is such that its 95 % ellipsoid holds 95 % of the samples: tails are heavy.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import special
from scipy.stats import qmc

from akm_fg.estimation.config import PriorConfig, SamplingConfig
from akm_fg.estimation.given.motion_fit import log_se3
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.one_kind.joint_chart import JointChart, Joints
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.estimation.sources.tracks import TRACKS
from akm_fg.geometry.batches import inverses, solutions
from akm_fg.records import BoolArray, FloatArray
from factors.joint import Joint

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Data:
    """What the tracks say, counted as the fit counts them."""

    R_free: FloatArray  # (T, 3, 3) the free motions
    t_free: FloatArray  # (T, 3)
    information: FloatArray  # (6 T, 6 T)
    gradient: FloatArray  # (6 T,)
    arcs: FloatArray  # (T,) of the solved joint
    prior: PriorConfig
    config: SamplingConfig


@dataclass(frozen=True, slots=True)
class _States:
    """The arcs' Gaussians at S joints."""

    mean: FloatArray  # (S, T), the first zero
    precision: FloatArray  # (S, T - 1, T - 1)
    log_weight: FloatArray  # (S,) log posterior of joint and spread, arcs integrated out


@dataclass(frozen=True, slots=True)
class _Samples:
    """Weighted joints; the weights (S,) sum to one."""

    u: FloatArray  # (S, k + 1) coordinates and log spread
    joints: Joints
    states: _States
    weights: FloatArray

    @property
    def effective(self) -> float:
        """Effective share of the samples (Kong, 1992)."""
        return float(1 / (self.weights**2).sum() / self.weights.size)

    def flattened(self, learnable: float) -> _Samples:
        """With weights to the first power of 1, 1/2, 1/4 .. that leaves enough to learn from."""
        samples = self
        even = 0.99 * np.count_nonzero(self.weights) / self.weights.size  # no more can be had
        while samples.effective < min(learnable, even):
            weights = np.sqrt(samples.weights)
            samples = replace(samples, weights=weights / weights.sum())
        return samples

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Weighted mean (k + 1,) and covariance of the coordinates."""
        mean = self.weights @ self.u
        off = self.u - mean
        return mean, off.T @ (self.weights[:, None] * off)


def sampled(fit: KindFit, problem: FitProblem) -> KindFit:
    """The fit with the mean and the covariance of its posterior where that is vague; or as it is.

    Joint, pitch, states, `cov` and `x_joint` change; what the evidence is made of does not.

    Args:
        fit: a solved kind, tempered.
        problem: it was solved for.
    """
    if not _tells(fit, problem):
        return fit
    chart = JointChart.at(fit.moving, problem.centroid_world)
    cov = chart.covariance(fit)
    config = problem.config.sampling
    if np.sqrt(np.diag(cov)[:4]).max() < config.vague:
        return fit
    try:
        samples = _sample(chart, cov, _data(fit, problem, chart))
        if samples.effective < config.too_few:
            samples = samples.flattened(config.learnable)
        return _with_moments(fit, chart, samples, config.region)
    except np.linalg.LinAlgError as error:  # samples without width: the mode's Gaussian stays
        log.warning("%s: the %s joint is not sampled: %s", problem.name, fit.kind, error)
        return fit


def _tells(fit: KindFit, problem: FitProblem) -> bool:
    """Whether the tracks, and nothing else, are what the fit knows."""
    if fit.joint is None or problem.motions is None or fit.q.size <= 3:
        return False
    others = (said for name, said in fit.said.items() if name != TRACKS)
    return not any(other.information.any() for other in others)


def _data(fit: KindFit, problem: FitProblem, chart: JointChart) -> _Data:
    """The form over free motions, with the weight that the graph gives the tracks.

    Free motions leave smaller residuals than a joint's, which weighs their observations higher.
    """
    motions = problem.motions
    assert motions is not None
    T = fit.q.size
    zero = np.zeros((1, chart.size))
    S = chart.joints(zero).unit_twists()[0] * chart.distance
    blocks = motions.information.reshape(T, 6, T, 6)
    of_states = np.array([S @ blocks[t, :, t] @ S for t in range(1, T)])
    graph = np.diag(fit.tracks.information)[-(T - 1) :]
    told = of_states > 0  # a frame in which no track is seen tells no weight
    if not told.any():
        raise np.linalg.LinAlgError("no frame tells of the states")
    weight = float(np.median(graph[told] / of_states[told])) / fit.track_variance_ratio
    return _Data(
        motions.R_world,
        motions.t_world,
        weight * motions.information,
        weight * motions.gradient,
        chart.distance * fit.q,
        problem.config.prior,
        problem.config.sampling,
    )


def _sample(chart: JointChart, cov: FloatArray, data: _Data) -> _Samples:
    frames = data.arcs.size - 1
    least = data.prior.least_travel_m  # as a standard deviation well inside what is possible
    mean = np.append(np.zeros(chart.size), np.log(max(float(np.std(data.arcs[1:])), least)))
    cov = np.pad(cov, (0, 1))
    cov[-1, -1] = 1 / frames  # twice that of a known spread's estimate
    config = data.config
    draws, dof = _draws(mean.size, config.samples, config.tail_dof), config.tail_dof
    log_proposal = -0.5 * (dof + mean.size) * np.log1p((draws**2).sum(axis=1) / dof)
    for _ in range(config.passes):
        root = np.linalg.cholesky(cov + 1e-12 * np.trace(cov) * np.eye(mean.size))
        u = mean + config.wider * draws @ root.T
        joints = chart.joints(u[:, :-1])
        states = _states(u, joints, data)
        log_weights = states.log_weight - log_proposal
        log_weights = np.where(np.isfinite(log_weights), log_weights, -np.inf)  # singular: none
        if not np.isfinite(log_weights).any():
            raise np.linalg.LinAlgError("no sample is possible")
        weights = np.exp(log_weights - log_weights.max())
        samples = _Samples(u, joints, states, weights / weights.sum())
        if samples.effective > config.enough:
            break
        mean, cov = samples.flattened(config.learnable).moments()
    return samples


@cache
def _draws(dimensions: int, samples: int, dof: float) -> FloatArray:
    """(S, d) of a spherical Student-t, evenly spread."""
    even = qmc.Sobol(dimensions + 1, rng=np.random.default_rng(1)).random(samples)
    even = np.clip(even, 1e-9, 1 - 1e-9)
    chi2 = special.chdtri(dof, 1 - even[:, -1])
    draws: FloatArray = special.ndtri(even[:, :-1]) * np.sqrt(dof / chi2)[:, None]
    return draws


def _states(u: FloatArray, joints: Joints, data: _Data) -> _States:
    """The arcs at every joint, by two Gauss-Newton steps from those of the solved joint."""
    S, T = len(u), data.arcs.size
    twists = joints.unit_twists()
    pairs = (twists[:, :, None] * twists[:, None, :]).reshape(S, 36)
    form = data.information.reshape(T, 6, T, 6).transpose(1, 3, 0, 2).reshape(36, T * T)
    centring = np.eye(T - 1) - 1 / (T - 1)
    tied = centring * np.exp(-2 * u[:, -1])[:, None, None]
    precision = (pairs @ form).reshape(S, T, T)[:, 1:, 1:] + tied
    arcs = np.repeat(data.arcs[None], S, axis=0)
    for _ in range(2):
        twice_cost, slope = _cost(arcs, joints, twists, data)
        pull = np.einsum("sij,sj->si", tied, arcs[:, 1:])
        twice_cost = twice_cost + (pull * arcs[:, 1:]).sum(axis=1)
        step = -solutions(precision, (slope + pull)[..., None])[..., 0]
        twice_cost = twice_cost + ((slope + pull) * step).sum(axis=1)
        arcs[:, 1:] += step
    log_det = np.linalg.slogdet(precision)[1]
    log_weight = -0.5 * (twice_cost + log_det) - (T - 2) * u[:, -1]
    log_weight = np.where(_possible(u[:, -1], data.prior), log_weight, -np.inf)
    return _States(arcs, precision, log_weight + _log_prior(u, joints, data.prior))


def _possible(log_spread: FloatArray, prior: PriorConfig) -> BoolArray:
    """Whether states with that spread fill a travel between the least and the largest."""
    travel = np.exp(log_spread) * np.sqrt(12)
    return (travel >= prior.least_travel_m) & (travel <= prior.largest_travel_m)


def _cost(
    arcs: FloatArray, joints: Joints, twists: FloatArray, data: _Data
) -> tuple[FloatArray, FloatArray]:
    """Twice the tracks' cost (S,), and half its slope by the arcs (S, T - 1)."""
    S, T = arcs.shape
    R, t = joints.motions(arcs)
    back = data.R_free.transpose(0, 2, 1)
    d = log_se3(
        (back @ R).reshape(-1, 3, 3),
        np.einsum("tij,stj->sti", back, t - data.t_free).reshape(-1, 3),
    ).reshape(S, 6 * T)
    pulled = d @ data.information + data.gradient
    slope = np.einsum("stj,sj->st", pulled.reshape(S, T, 6), twists)[:, 1:]
    return (d * (pulled + data.gradient)).sum(axis=1), slope


def _log_prior(u: FloatArray, joints: Joints, prior: PriorConfig) -> FloatArray:
    """Log prior density (S,) over the chart: axis uniform, the hinge as in `log_joint_prior`."""
    tilt = np.linalg.norm(u[:, :2], axis=1)
    total = np.log(np.maximum(np.sinc(np.minimum(tilt / np.pi, 1)), 1e-9))  # of the sphere's area
    if joints.turns:
        z = np.log(joints.distance / prior.hinge_distance_m) / prior.hinge_distance_sigma_log
        total = total - 0.5 * (z**2 + (joints.pitch / prior.pitch_sigma_m_per_rad) ** 2)
    return total


def _with_moments(fit: KindFit, chart: JointChart, samples: _Samples, region: float) -> KindFit:
    k, weights = chart.size, samples.weights
    per_arc = 1 / samples.joints.distance
    q = samples.states.mean[:, 1:] * per_arc[:, None]
    numbers = np.where(weights[:, None] > 0, np.concatenate([samples.u[:, :k], q], axis=1), 0.0)
    mean = weights @ numbers
    off = numbers - mean
    cov = off.T @ (weights[:, None] * off)
    counted = weights > 0
    within = inverses(samples.states.precision[counted])
    cov[k:, k:] += np.einsum("s,sij->ij", (weights * per_arc**2)[counted], within)
    cov *= _heavier_tails(off[:, :k], cov[:k, :k], weights, region)
    T_world_joint, by_chart = chart.frame(mean[:k])
    J = np.eye(mean.size)
    J[:k, :k] = by_chart
    joint = fit.moving
    T_new_old = np.linalg.inv(T_world_joint) @ joint.T_world_joint
    pitch = joint.pitch + float(mean[4]) if joint.kind.has_pitch else joint.pitch
    x = T_new_old[:3, :3] @ fit.tracks.x_joint + T_new_old[:3, 3:]
    return replace(
        fit,
        joint=Joint(joint.kind, T_world_joint, pitch),
        q=np.concatenate([[0.0], mean[k:]]),
        cov=J @ cov @ J.T,
        said={**fit.said, TRACKS: replace(fit.tracks, x_joint=x)},
    )


def _heavier_tails(off: FloatArray, cov: FloatArray, weights: FloatArray, region: float) -> float:
    """By how much a covariance has to grow for its ellipsoid to hold what it should; at least 1.

    Args:
        off: (S, k) samples from their mean.
        cov: (k, k) their covariance.
        weights: (S,) theirs, with the sum one.
        region: share of the posterior that the ellipsoid of that probability is to hold.
    """
    squared = np.einsum("si,si->s", off, np.linalg.solve(cov, off.T).T)
    order = np.argsort(squared)
    reached = np.interp(region, np.cumsum(weights[order]), squared[order])
    return max(1.0, float(reached / special.chdtri(off.shape[1], 1 - region)))
