"""States of frames in which the part is hidden, by the hand that holds it.

While the gripper holds, it is a point of the part: where it was in frames whose state is known says
where it sits in the part, and then where it is says the state. What it is off by there is its
noise. A hand that is off the part's way by more has slipped, or lets go: it tells nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from akm_fg.estimation.config import GraspConfig
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import FloatArray
from factors.joint import Joint

_MAD_TO_SD = 1.4826
_STEPS = 8  # of Gauss-Newton on one state
_STEP = 1e-6  # of the state, for the way's direction


@dataclass(frozen=True, slots=True)
class GripperStateConfig:
    """When the hand is believed."""

    least_frames: int = 3  # known ones in the hold, that say where the hand sits
    sigmas: float = 4.0  # that a hand may be off the part's way


def with_gripper_states(
    posterior: ArticulationPosterior,
    hands_world: Mapping[int, FloatArray],
    grasp: GraspConfig,
    config: GripperStateConfig | None = None,
) -> ArticulationPosterior:
    """With the best kind's states in frames that nothing but the hand tells of.

    Args:
        posterior: its states are NaN where the part was not seen.
        hands_world: (3,) of the gripper by the frames in which it holds.
        grasp: its noise.
        config: tuning.
    """
    config, best = config or GripperStateConfig(), posterior.best
    if best.joint is None or best.states is None:
        return posterior
    joint, states = best.joint.joint, best.states
    seen = [k for k in sorted(hands_world) if np.isfinite(states.mean[k])]
    hidden = [k for k in sorted(hands_world) if not np.isfinite(states.mean[k])]
    if len(seen) < config.least_frames or not hidden:
        return posterior
    in_part = np.array([_back(joint, states.mean[k], hands_world[k]) for k in seen])
    x = np.median(in_part, axis=0)
    mean, sd = states.mean.copy(), states.sd.copy()
    own = [_solved(joint, x, hands_world[k], float(states.mean[k])) for k in seen]
    along = np.array([q - states.mean[k] for (q, _, _), k in zip(own, seen, strict=True)])
    metres = float(np.median([way for _, _, way in own]))
    if metres < 1e-6:
        return posterior  # the hand sits on the axis: it turns and does not move
    noise = max(_MAD_TO_SD * float(np.median(np.abs(along))), grasp.sigma_trans_m / metres)
    off = _MAD_TO_SD * float(np.median([across for _, across, _ in own]))
    limit_m = config.sigmas * max(off, grasp.sigma_trans_m)
    told = np.array(seen)
    for k in hidden:
        q, across, _ = _solved(joint, x, hands_world[k], float(np.interp(k, told, mean[told])))
        if across <= limit_m:
            beside = float(np.interp(k, told, states.sd[told]))
            mean[k], sd[k] = q, float(np.hypot(noise, beside))
    return posterior.with_states(mean, sd)


def _back(joint: Joint, q: float, p_world: FloatArray) -> FloatArray:
    """A point (3,) where it was at state zero."""
    (R,), (t,) = joint.motion(np.array([q]))
    return np.asarray(R.T @ (p_world - t))


def _solved(
    joint: Joint, x_world: FloatArray, p_world: FloatArray, start: float
) -> tuple[float, float, float]:
    """State that brings a point nearest to a place; how far off it stays, and its way per unit."""
    q, way, e = start, np.zeros(3), np.zeros(3)
    for _ in range(_STEPS):
        R, t = joint.motion(np.array([q, q + _STEP]))
        here, there = R @ x_world + t
        way, e = (there - here) / _STEP, p_world - here
        q += float(way @ e) / max(float(way @ way), 1e-12)
    R, t = joint.motion(np.array([q]))
    return q, float(np.linalg.norm(p_world - R[0] @ x_world - t[0])), float(np.linalg.norm(way))
