"""The joint of a part from the path of a hand that holds it, its prior being what a camera saw.

The hand turns in its grasp about a point c (3,) of its own, which goes with the part but for what
it slips. With xi ~ N(0, P) of the joint's tangent, calibration in it, and a length scale
kappa ~ N(0, s^2) of a slid state, in frame t, after a way l_t of the hand,

    p_t + R_t c + phi x (p_t - p_0) = M_xi((1 + kappa) q_t) (y + u l_t + sum_{i <= t} w_i) + noise

where y is free, phi ~ N(0, turn_rad^2) by what the arm's joint zeros are off, u ~ N(0, steady^2)
slips all along and w_i at once, the latter by a random walk with Student-t steps: grips settle
while the pull begins, and hold then. Noise is white, and that of q_t along the way. All of it is
linear (`Joint.motion_jacobians`) and solved at once; the variances of steps, of u and of P, whose
Student-t prior lets a camera that claims too much be overruled, follow by expectation
maximisation (Lange, Little and Taylor, Robust statistical modeling using the t distribution, 1989).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.special import gammaln

from akm_fg.estimation.config import HandPathConfig
from akm_fg.posterior import JointPosterior, StatePosterior
from akm_fg.records import FloatArray
from factors.joint import Joint, skew

LEAST_FRAMES = 6  # of the hold with a state: fewer tell less than they may mislead
LEAST_STEP_M = 1e-3  # in which a grip may slip while the hand stands
STEADY_DOF = 3.0  # of the Student-t prior of what slips all along
FREE_M = 1e3  # standard deviation of what nothing is known of


@dataclass(frozen=True, slots=True)
class HeldPath:
    """The hand while it holds, in T frames whose state is known."""

    q: FloatArray  # (T,)
    q_sd: FloatArray  # (T,)
    T_world_hand: FloatArray  # (T, 4, 4)

    @classmethod
    def of(
        cls,
        states: StatePosterior,
        hands: Mapping[int, gtsam.Pose3],
        frames: list[int],
        most: int,
    ) -> HeldPath:
        """The path in some frames, which all have a state: at most so many, spread over all."""
        if len(frames) > most:
            frames = [frames[k] for k in np.linspace(0, len(frames) - 1, most).round().astype(int)]
        T_world_hand = np.array([hands[k].matrix() for k in frames])
        return cls(states.mean[frames], states.sd[frames], T_world_hand)

    @property
    def p_world(self) -> FloatArray:
        """(T, 3) where it is."""
        return self.T_world_hand[:, :3, 3]

    @property
    def steps_m(self) -> FloatArray:
        """(T - 1,) how far it went from one frame to the next."""
        return np.linalg.norm(np.diff(self.p_world, axis=0), axis=1)


@dataclass(frozen=True, slots=True)
class JointByHand:
    """What it told."""

    joint: JointPosterior
    xi: FloatArray  # (d,) by which the joint was moved, in its observable tangent directions
    length_share: float  # lengths along a slid joint are 1 + this times what was seen
    length_share_sd: float
    camera_widened: float  # by which the prior's covariance had to be multiplied, no less than 1
    log_evidence: float  # of the path, by Laplace; between joints of the same frames


@dataclass(slots=True)
class _Variances:
    """Those that follow from what they explain."""

    step: FloatArray  # (T - 1, 3) m^2
    steady: FloatArray  # (3,)
    camera: float = 1.0


@dataclass(frozen=True, slots=True)
class _Said:
    """What the path says of the unknowns: normal equations, and what they leave out."""

    matrix: FloatArray  # (n, n)
    vector: FloatArray  # (n,)
    power: float  # of the residuals, whitened
    log_det: float  # of their weights

    def log_likelihood(self, found: FloatArray) -> float:
        """At the unknowns that were found; 2 pi left out, which all joints have alike."""
        misfit = self.power - 2.0 * found @ self.vector + found @ self.matrix @ found
        return 0.5 * (self.log_det - float(misfit))


class _Unknowns:
    """Where each of the unknowns is: xi and kappa, phi, u, c, y, w."""

    def __init__(self, d: int, frames: int) -> None:
        ends = np.cumsum([d + 1, 3, 3, 3, 3, 3 * (frames - 1)])
        starts = np.concatenate([[0], ends[:-1]])
        places = [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True)]
        self.joint, self.turn, self.steady, self.lever, self.held, self.steps = places
        self.size, self.length = int(ends[-1]), d


def joint_by_hand(
    joint: JointPosterior, path: HeldPath, length_sd: float, config: HandPathConfig
) -> JointByHand:
    """The joint, and the scale of lengths, with what the hand tells.

    Args:
        joint: as the camera saw it, its calibration's errors in the covariance.
        path: of the hand, two frames or more.
        length_sd: relative, of lengths as the camera sees them along a slid joint.
        config: the hand's noise.
    """
    known = list(joint.kind.observable)
    at = _Unknowns(len(known), len(path.q))
    prior = np.zeros((at.length + 1, at.length + 1))
    prior[: at.length, : at.length] = joint.cov[np.ix_(known, known)]
    prior[at.length, at.length] = max(length_sd, 1e-9) ** 2
    weight: FloatArray = np.asarray(np.linalg.inv(prior), dtype=np.float64)
    step = config.slip_m_per_sqrt_m**2 * np.maximum(path.steps_m, LEAST_STEP_M)
    own = _Variances(np.repeat(step[:, None], 3, axis=1), np.full(3, config.steady**2))
    now = replace(own)
    z: FloatArray = np.zeros(at.length + 1)
    cov: FloatArray = prior
    for _ in range(config.iterations):
        here = moved(joint.joint, known, z[: at.length])
        said = _normal_equations(here, known, path, float(z[-1]), at, config)
        told = said.vector.copy()
        told[at.joint] -= weight @ z / now.camera
        information = said.matrix + _prior_information(weight, now, at, config)
        cov = np.asarray(np.linalg.inv(information), dtype=np.float64)
        found = cov @ told
        z = z + found[at.joint]
        now = _explained(own, found, cov, z, weight, at, config)
    log_evidence = said.log_likelihood(found) + 0.5 * float(np.linalg.slogdet(cov)[1])
    log_evidence += _log_prior(own, found, z, weight, at, config)
    # A step's most probable variance is less than what it went, by as much as its prior says: of
    # what is then known, the covariance speaks with all that it went.
    squared = (found**2 + np.diag(cov))[at.steps].reshape(own.step.shape)
    sure = replace(now, step=np.maximum(now.step, squared))
    information = said.matrix + _prior_information(weight, sure, at, config)
    cov = np.asarray(np.linalg.inv(information), dtype=np.float64)
    d = at.length
    whole = joint.cov.copy()
    whole[np.ix_(known, known)] = 0.5 * (cov[:d, :d] + cov[:d, :d].T)
    there = replace(joint, joint=moved(joint.joint, known, z[:d]), cov=whole)
    return JointByHand(
        there, z[:d], float(z[d]), float(np.sqrt(cov[d, d])), now.camera, log_evidence
    )


def moved(joint: Joint, known: list[int], xi: FloatArray) -> Joint:
    """The joint, its frame moved by an increment of its observable directions on the right."""
    whole = np.zeros(6)
    whole[known] = xi
    T = gtsam.Pose3(joint.T_world_joint).compose(gtsam.Pose3.Expmap(whole))
    return replace(joint, T_world_joint=T.matrix())


def _normal_equations(
    joint: Joint,
    known: list[int],
    path: HeldPath,
    kappa: float,
    at: _Unknowns,
    config: HandPathConfig,
) -> _Said:
    """Of the unknowns, increments of xi and kappa among them; residuals are in the part."""
    frames, q = len(path.q), (1.0 + kappa) * path.q
    R, t = joint.motion(q)
    by_xi, by_q, _ = joint.motion_jacobians(q)
    in_part = np.einsum("tji,tj->ti", R, path.p_world - t)
    x = in_part.mean(axis=0)
    # Of a left twist of the motion, in the part: where the hand is, turned and shifted.
    G = np.concatenate([-skew(x), np.eye(3)], axis=1)  # (3, 6)
    way = by_q @ G.T  # (T, 3)
    J = np.zeros((frames, 3, at.size))
    J[..., at.joint] = np.concatenate(
        [(G @ by_xi)[..., known], (way * path.q[:, None])[..., None]], axis=2
    )
    to_part, since = R.swapaxes(1, 2), path.p_world - path.p_world[0]
    J[..., at.turn] = to_part @ np.array([skew(gone) for gone in since])
    went = np.concatenate([[0.0], np.cumsum(path.steps_m)])
    J[..., at.steady] = went[:, None, None] * np.eye(3)
    J[..., at.lever] = -to_part @ path.T_world_hand[:, :3, :3]
    J[..., at.held] = np.eye(3)
    taken = np.tril(np.ones((frames, frames - 1)), -1)
    J[..., at.steps] = np.kron(taken, np.eye(3)).reshape(frames, 3, -1)
    along = path.q_sd[:, None, None] ** 2 * (way[:, :, None] * way[:, None, :])
    W = np.linalg.inv(config.jitter_m**2 * np.eye(3) + along)
    weighed = (W @ J).reshape(-1, at.size)
    flat = J.reshape(-1, at.size)
    off = in_part - x
    power = float(np.einsum("ti,tij,tj->", off, W, off))
    log_det = float(np.linalg.slogdet(W)[1].sum())
    return _Said(flat.T @ weighed, weighed.T @ off.ravel(), power, log_det)


def _prior_information(
    weight: FloatArray, now: _Variances, at: _Unknowns, config: HandPathConfig
) -> FloatArray:
    information = np.zeros((at.size, at.size))
    information[at.joint, at.joint] = weight / now.camera
    variance = np.ones(at.size)
    variance[at.turn], variance[at.steady] = config.turn_rad**2, now.steady
    variance[at.lever], variance[at.held] = config.lever_m**2, FREE_M**2
    variance[at.steps] = now.step.ravel()
    others = np.arange(at.joint.stop, at.size)
    information[others, others] = 1.0 / variance[others]
    return information


def _log_prior(
    own: _Variances,
    found: FloatArray,
    z: FloatArray,
    weight: FloatArray,
    at: _Unknowns,
    config: HandPathConfig,
) -> float:
    """Log density of the unknowns before the path, but for what all joints have alike."""
    d, dof = at.length, config.camera_dof
    by_camera = weight[:d, :d]  # kappa is independent of it
    off = float(z[:d] @ by_camera @ z[:d])
    joint = gammaln((dof + d) / 2) - 0.5 * d * np.log(0.5 * dof)  # 2 pi as above
    joint += 0.5 * np.linalg.slogdet(by_camera)[1] - 0.5 * (dof + d) * np.log1p(off / dof)
    scale = 0.5 * np.log(weight[d, d]) - 0.5 * weight[d, d] * z[d] ** 2
    turn = -0.5 * float((found[at.turn] ** 2).sum()) / config.turn_rad**2
    lever = -0.5 * float((found[at.lever] ** 2).sum()) / config.lever_m**2
    steady = _log_t(found[at.steady], own.steady, STEADY_DOF)
    steps = _log_t(found[at.steps], own.step.ravel(), config.slip_dof)
    return float(joint + scale) + turn + lever + steady + steps


def _log_t(x: FloatArray, variance: FloatArray, dof: float) -> float:
    return -0.5 * (dof + 1.0) * float(np.log1p(x**2 / (dof * variance)).sum())


def _explained(
    own: _Variances,
    found: FloatArray,
    cov: FloatArray,
    z: FloatArray,
    weight: FloatArray,
    at: _Unknowns,
    config: HandPathConfig,
) -> _Variances:
    """The variances that expectation maximisation comes to next."""
    squared = found**2 + np.diag(cov)
    steps = squared[at.steps].reshape(own.step.shape)
    dof, d = config.slip_dof, at.length
    step = (dof * own.step + steps) / (dof + 1.0)
    steady = (STEADY_DOF * own.steady + squared[at.steady]) / (STEADY_DOF + 1.0)
    inverse = weight[:d, :d]  # kappa is of the calibration's own, and never claimed by a fit
    off = float(z[:d] @ inverse @ z[:d] + np.trace(inverse @ cov[:d, :d]))
    camera = (config.camera_dof + off) / (config.camera_dof + d)
    return _Variances(step, np.maximum(steady, own.steady), max(1.0, camera))
