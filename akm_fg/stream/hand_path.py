"""What the hand that holds a part tells of its joint, beside a camera whose calibration errs.

Errors of the camera's calibration are the same in all frames, so what it saw says nothing of them;
the hand's own path, known by the arm's joints, does (`held_point`). Nor does what the camera saw
say when a plain front was followed along itself: a hand that goes with the part knows it to a
fraction of a millimetre.

What the hand corrects is shared out between the joint as the camera sees it and the camera's
calibration, by their covariances: of xi_world = xi_seen + c, with covariances P = P_seen + P_c,
xi_seen given xi_world is G xi_world + N(0, P_seen - G P_seen) with G = P_seen P^-1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from akm_fg.estimation.config import GraspConfig, HandPathConfig
from akm_fg.posterior import ArticulationPosterior, JointPosterior, StatePosterior
from akm_fg.records import CameraCorrection, FloatArray
from akm_fg.stream.gripper_state import with_gripper_states
from akm_fg.stream.held_point import LEAST_FRAMES, HeldPath, JointByHand, joint_by_hand, moved

HIDDEN_M = 0.1  # along its way, that nothing but the hand says where a hidden part is


@dataclass(frozen=True, slots=True)
class ToldByHand:
    """A posterior with what the hand told."""

    posterior: ArticulationPosterior
    correction: CameraCorrection  # by how much the camera's world is off
    carried: StatePosterior  # its states, and those of hidden frames as the hand has them


def with_hand_path(
    posterior: ArticulationPosterior,
    seen: JointPosterior,
    hands: Mapping[int, gtsam.Pose3],
    length_sd: float,
    config: HandPathConfig,
) -> ToldByHand | None:
    """The best kind's joint, and the scale of its states, with what the hand tells.

    States that are nowhere near where the hand was are left out: what depth shows there is
    something else. Frames in which the part is hidden tell the joint too, but not where along its
    way the part is.

    Args:
        posterior: by the camera, its calibration's errors in the covariances.
        seen: the best kind's joint without them.
        hands: T_world_gripper by the frames in which it holds.
        length_sd: relative, of lengths as the camera sees them along a slid joint.
        config: the hand's noise.

    Returns:
        None where the hand tells nothing.
    """
    best = posterior.best
    if best.joint is None or best.states is None:
        return None
    states, most = _near_the_hand(best.joint, best.states, hands, config), config.most_frames
    known = _frames(states, hands)
    if len(known) < LEAST_FRAMES:
        return None
    slides = 0.0 if best.joint.turns else length_sd
    told = joint_by_hand(best.joint, HeldPath.of(states, hands, known, most), slides, config)
    by_seen = _with(posterior, told, states, slides)
    hidden = _by_hand(by_seen, hands)
    carried = _frames(hidden, hands)
    if len(carried) > len(known):
        vague = _vague_where_hidden(told, hidden, states, hands)
        path = HeldPath.of(vague, hands, carried, most)
        told = joint_by_hand(best.joint, path, slides, config)
        by_seen = _with(posterior, told, states, slides)
        hidden = _by_hand(by_seen, hands)
    return ToldByHand(by_seen, _shared_out(best.joint, seen, told, slides > 0.0), hidden)


def _near_the_hand(
    joint: JointPosterior,
    states: StatePosterior,
    hands: Mapping[int, gtsam.Pose3],
    config: HandPathConfig,
) -> StatePosterior:
    """The states, NaN where the part would be elsewhere than the hand that holds it."""
    known = _frames(states, hands)
    if not known:
        return states
    q, p = states.mean[known], np.array([hands[k].translation() for k in known])
    R, t = joint.joint.motion(q)
    x = np.median(np.einsum("tji,tj->ti", R, p - t), axis=0)
    off_m = np.linalg.norm(p - R @ x - t, axis=1)
    vague_m = np.linalg.norm(joint.joint.velocity(p), axis=1) * states.sd[known]
    far = off_m > config.away_m + np.minimum(config.away_sigmas * vague_m, config.away_m)
    if 2 * far.sum() > far.size:
        return states  # which of the two is astray is not to be told
    mean, sd = states.mean.copy(), states.sd.copy()
    mean[np.array(known)[far]], sd[np.array(known)[far]] = np.nan, np.nan
    return replace(states, mean=mean, sd=sd)


def _frames(states: StatePosterior, hands: Mapping[int, gtsam.Pose3]) -> list[int]:
    return [k for k in sorted(hands) if np.isfinite(states.mean[k])]


def _with(
    posterior: ArticulationPosterior, told: JointByHand, states: StatePosterior, slides: float
) -> ArticulationPosterior:
    """With the joint that was told, and slid states in its lengths."""
    if slides > 0.0:
        own = np.sqrt(np.maximum(states.sd**2 - (slides * states.mean) ** 2, 0.0))
        sd = np.hypot(own, told.length_share_sd * states.mean)
        states = replace(states, mean=(1.0 + told.length_share) * states.mean, sd=sd)
    kind = replace(posterior.best, joint=told.joint, states=states)
    alternatives = {**posterior.alternatives, str(told.joint.kind): kind}
    return replace(posterior, alternatives=alternatives)


def _by_hand(posterior: ArticulationPosterior, hands: Mapping[int, gtsam.Pose3]) -> StatePosterior:
    """States with those of hidden frames by where the hand was."""
    places = {k: T.translation() for k, T in hands.items()}
    states = with_gripper_states(posterior, places, GraspConfig()).best.states
    assert states is not None
    return states


def _vague_where_hidden(
    told: JointByHand,
    carried: StatePosterior,
    states: StatePosterior,
    hands: Mapping[int, gtsam.Pose3],
) -> StatePosterior:
    """In the camera's lengths; what the hand itself told of a state tells the joint nothing."""
    mean, sd = states.mean.copy(), states.sd.copy()
    for k in hands:
        if not np.isfinite(mean[k]) and np.isfinite(carried.mean[k]):
            way = told.joint.joint.velocity(hands[k].translation())
            mean[k] = carried.mean[k] / (1.0 + told.length_share)
            sd[k] = HIDDEN_M / max(float(np.linalg.norm(way)), 1e-6)
    return replace(states, mean=mean, sd=sd)


def _shared_out(
    before: JointPosterior, seen: JointPosterior, told: JointByHand, slides: bool
) -> CameraCorrection:
    """How much of what the hand told is the calibration's, and what is known of the joint seen."""
    known = list(before.kind.observable)
    P, P_seen, Q = (j.cov[np.ix_(known, known)] for j in (before, seen, told.joint))
    G = P_seen @ np.linalg.inv(P)
    T_seen = moved(seen.joint, known, G @ told.xi).T_world_joint
    own = told.camera_widened * (P_seen - G @ P_seen) + G @ Q @ G.T
    cov: FloatArray = seen.cov.copy()
    cov[np.ix_(known, known)] = 0.5 * (own + own.T)
    T_world_seen = gtsam.Pose3(told.joint.T_world_joint) * gtsam.Pose3(T_seen).inverse()
    share_sd = told.length_share_sd if slides else 0.0
    return CameraCorrection(T_world_seen, cov, told.length_share, share_sd)
