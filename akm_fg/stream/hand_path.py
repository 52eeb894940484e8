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
from dataclasses import replace

import gtsam
import numpy as np

from akm_fg.estimation.config import HandPathConfig
from akm_fg.posterior import ArticulationPosterior, JointPosterior, StatePosterior
from akm_fg.records import CameraCorrection, FloatArray
from akm_fg.stream.held_point import HeldPath, JointByHand, joint_by_hand, moved

LEAST_FRAMES = 6  # of the hold with a state: fewer tell less than they may mislead


def with_hand_path(
    posterior: ArticulationPosterior,
    seen: JointPosterior,
    hands: Mapping[int, gtsam.Pose3],
    length_sd: float,
    config: HandPathConfig,
) -> tuple[ArticulationPosterior, CameraCorrection | None]:
    """The best kind's joint, and the scale of its states, with what the hand tells.

    Second comes by how much the camera's world is off; None where the hand tells nothing.

    Args:
        posterior: by the camera, its calibration's errors in the covariances.
        seen: the best kind's joint without them.
        hands: T_world_gripper by the frames in which it holds.
        length_sd: relative, of lengths as the camera sees them along a slid joint.
        config: the hand's noise.
    """
    best = posterior.best
    if best.joint is None or best.states is None:
        return posterior, None
    path = _path_of(best.states, hands, config.most_frames)
    if path is None:
        return posterior, None
    slides = 0.0 if best.joint.turns else length_sd
    told = joint_by_hand(best.joint, path, slides, config)
    states = best.states
    if slides > 0.0:
        own = np.sqrt(np.maximum(states.sd**2 - (slides * states.mean) ** 2, 0.0))
        sd = np.hypot(own, told.length_share_sd * states.mean)
        states = replace(states, mean=(1.0 + told.length_share) * states.mean, sd=sd)
    kind = replace(best, joint=told.joint, states=states)
    alternatives = {**posterior.alternatives, str(told.joint.kind): kind}
    correction = _shared_out(best.joint, seen, told, slides > 0.0)
    return replace(posterior, alternatives=alternatives), correction


def _path_of(
    states: StatePosterior, hands: Mapping[int, gtsam.Pose3], most: int
) -> HeldPath | None:
    known = [k for k in sorted(hands) if np.isfinite(states.mean[k])]
    if len(known) < LEAST_FRAMES:
        return None
    if len(known) > most:
        known = [known[k] for k in np.linspace(0, len(known) - 1, most).round().astype(int)]
    T_world_hand = np.array([hands[k].matrix() for k in known])
    return HeldPath(states.mean[known], states.sd[known], T_world_hand)


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
