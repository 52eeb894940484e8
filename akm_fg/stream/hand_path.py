"""What the hand that holds a part tells of its joint, beside a camera whose calibration errs.

Errors of the camera's calibration are the same in all frames, so what it saw says nothing of them;
the hand's own path, known by the arm's joints, does. With the camera's posterior xi ~ N(0, P) of
the joint's tangent, calibration in it, and a length scale kappa ~ N(0, s^2) of a slid state, the
hand's point x (3,), where it is at state zero, goes

    p_t = M_xi((1 + kappa) q_t) x + noise,      x free,

linearised by `Joint.motion_jacobians`. Noise is that of a hand on a handle, and of q_t along the
way; neighbouring frames err together. Where the path is off by more than the noise says, the noise
is what it is off by. x is marginalised in closed form; xi and kappa are solved by Gauss-Newton.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from akm_fg.estimation.config import GraspConfig
from akm_fg.posterior import ArticulationPosterior, JointPosterior, StatePosterior
from akm_fg.records import FloatArray
from factors.joint import Joint, skew

LEAST_FRAMES = 6  # of the hold with a state: fewer tell less than they may mislead
ITERATIONS = 4


@dataclass(frozen=True, slots=True)
class _Path:
    """The hand while it holds, in frames whose state is known."""

    q: FloatArray  # (T,)
    q_sd: FloatArray  # (T,)
    p_world: FloatArray  # (T, 3)


def with_hand_path(
    posterior: ArticulationPosterior,
    hands_world: Mapping[int, FloatArray],
    length_sd: float,
    grasp: GraspConfig,
) -> tuple[ArticulationPosterior, tuple[gtsam.Pose3, float, float] | None]:
    """The best kind's joint, and the scale of its states, with what the hand tells.

    Second comes where that puts the camera's world, (4, 4), and the scale with its deviation; None
    where the hand tells nothing.

    Args:
        posterior: by the camera, its calibration's errors in the covariances.
        hands_world: (3,) of the gripper by the frames in which it holds.
        length_sd: relative, of lengths as the camera sees them along a slid joint.
        grasp: the hand's noise.
    """
    best = posterior.best
    if best.joint is None or best.states is None:
        return posterior, None
    path = _path_of(best.states, hands_world)
    if path is None:
        return posterior, None
    slides = 0.0 if best.joint.turns else length_sd
    seen = best.joint.T_world_joint
    joint, kappa, kappa_sd = _fused(best.joint, path, slides, grasp)
    states = best.states
    if slides > 0.0:
        own = np.sqrt(np.maximum(states.sd**2 - (slides * states.mean) ** 2, 0.0))
        sd = np.hypot(own, kappa_sd * states.mean)
        states = replace(states, mean=(1.0 + kappa) * states.mean, sd=sd)
    kind = replace(best, joint=joint, states=states)
    alternatives = {**posterior.alternatives, str(joint.kind): kind}
    T_world_joint, T_seen_joint = (gtsam.Pose3(T) for T in (joint.T_world_joint, seen))
    told = T_world_joint * T_seen_joint.inverse(), kappa, kappa_sd if slides > 0.0 else 0.0
    return replace(posterior, alternatives=alternatives), told


def _path_of(states: StatePosterior, hands_world: Mapping[int, FloatArray]) -> _Path | None:
    known = [k for k in sorted(hands_world) if np.isfinite(states.mean[k])]
    if len(known) < LEAST_FRAMES:
        return None
    return _Path(states.mean[known], states.sd[known], np.array([hands_world[k] for k in known]))


def _fused(
    joint: JointPosterior, path: _Path, length_sd: float, grasp: GraspConfig
) -> tuple[JointPosterior, float, float]:
    """The joint, and the scale of lengths with its standard deviation."""
    known = list(joint.kind.observable)
    d = len(known)
    prior = np.zeros((d + 1, d + 1))
    prior[:d, :d] = joint.cov[np.ix_(known, known)]
    prior[d, d] = max(length_sd, 1e-9) ** 2
    weight = np.linalg.inv(prior)
    z: FloatArray = np.zeros(d + 1)
    cov: FloatArray = prior
    for _ in range(ITERATIONS):
        here = _moved(joint.joint, known, z[:d])
        A, b, off = _normal_equations(here, known, path, float(z[d]), grasp)
        # A path that is off by more than its noise is that noisy.
        scale = max(1.0, off)
        information = weight + A / scale
        cov = np.asarray(np.linalg.inv(information), dtype=np.float64)
        step = cov @ (b / scale - weight @ z)
        z = np.asarray(z + step, dtype=np.float64)
        if float(np.abs(step).max()) < 1e-9:
            break
    moved = _moved(joint.joint, known, z[:d])
    whole = joint.cov.copy()
    whole[np.ix_(known, known)] = 0.5 * (cov[:d, :d] + cov[:d, :d].T)
    return replace(joint, joint=moved, cov=whole), float(z[d]), float(np.sqrt(cov[d, d]))


def _moved(joint: Joint, known: list[int], xi: FloatArray) -> Joint:
    """The joint, its frame moved by an increment of its observable directions on the right."""
    whole = np.zeros(6)
    whole[known] = xi
    T = gtsam.Pose3(joint.T_world_joint).compose(gtsam.Pose3.Expmap(whole))
    return replace(joint, T_world_joint=T.matrix())


def _normal_equations(
    joint: Joint, known: list[int], path: _Path, kappa: float, grasp: GraspConfig
) -> tuple[FloatArray, FloatArray, float]:
    """A, b of the increments (xi, kappa), x marginalised, and chi-square per degree of freedom."""
    q = (1.0 + kappa) * path.q
    R, t = joint.motion(q)
    by_xi, by_q, _ = joint.motion_jacobians(q)
    # Of a left twist of the motion, world axes: where the hand is, turned and shifted.
    x = np.einsum("tji,tj->ti", R, path.p_world - t).mean(axis=0)
    G = np.concatenate([-skew(x), np.eye(3)], axis=1)  # (3, 6)
    J_xi = R @ (G @ by_xi)[..., known]  # (T, 3, d)
    way = np.einsum("tij,tj->ti", R @ G, by_q)  # (T, 3)
    J = np.concatenate([J_xi, (way * path.q[:, None])[..., None]], axis=2)
    r = path.p_world - (np.einsum("tij,j->ti", R, x) + t)
    noise = grasp.sigma_trans_m**2 * np.eye(3) + path.q_sd[:, None, None] ** 2 * (
        way[:, :, None] * way[:, None, :]
    )
    W = np.linalg.inv(noise)
    whole = np.concatenate([J, R], axis=2)  # x last
    H = np.einsum("tki,tkl,tlj->ij", whole, W, whole)
    g = np.einsum("tki,tkl,tl->i", whole, W, r)
    d = J.shape[2]
    gain = np.linalg.solve(H[d:, d:], np.column_stack([H[d:, :d], g[d:]]))
    A, b = H[:d, :d] - H[:d, d:] @ gain[:, :d], g[:d] - H[:d, d:] @ gain[:, d]
    chi2 = float(np.einsum("ti,tij,tj->", r, W, r)) / max(3 * len(q) - 3, 1)
    share = 1.0 / grasp.frames_as_one
    return share * A, share * b, chi2
