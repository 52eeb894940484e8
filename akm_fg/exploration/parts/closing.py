"""Pushing a part shut that the hand holds, along its joint."""

from __future__ import annotations

import gtsam
import numpy as np

from akm_fg.errors import GraspFailed, MotionInfeasible
from akm_fg.exploration.config import PullConfig
from akm_fg.exploration.parts.config import PartsConfig
from akm_fg.interfaces import Arm
from akm_fg.planning.opening_path import plan_opening
from akm_fg.posterior import JointPosterior
from akm_fg.records import FloatArray

_STATES = 801  # of the search below: 1.5 mm, 0.25 deg
_FARTHEST = {"m": 0.6, "rad": float(np.deg2rad(100.0))}


def push_shut(
    arm: Arm, joint: JointPosterior, q: float, config: PartsConfig, pull: PullConfig
) -> None:
    """From a state to the closed one, which is zero, and a little beyond.

    Where the whole way is out of the arm's reach, the hand goes where the part lets it.

    Args:
        arm: holds the part.
        joint: of the part.
        q: its state, m or rad.
        config: of what is done with parts that are found.
        pull: of the hand's motions.
    """
    hand = arm.T_world_gripper()
    way = joint.joint.velocity(hand.translation())
    per_state = max(float(np.linalg.norm(way)), 1e-3)
    target = -float(np.sign(q)) * config.beyond_m / per_state
    try:
        for _ in arm.follow(plan_opening(joint, hand, q, target, pull.hand), pull.tick_s):
            pass
    except MotionInfeasible:
        back: FloatArray = -np.sign(q) * way / per_state
        for _ in arm.pull(back, abs(q) * per_state, pull.tick_s):
            pass


def take_and_push_shut(
    arm: Arm,
    joint: JointPosterior,
    T_world_closed_grasp: gtsam.Pose3,
    q: float,
    feel_m: float,
    config: PartsConfig,
    pull: PullConfig,
) -> bool:
    """Take hold of a part that stands open, and push it shut; False where no hold is to be had."""
    (R,), (t,) = joint.joint.motion(np.array([q]))
    T_world_grasp = gtsam.Pose3(gtsam.Rot3(R), t) * T_world_closed_grasp
    try:
        for _ in arm.grasp(T_world_grasp, pull.tick_s, feel_m):
            pass
    except (MotionInfeasible, GraspFailed):
        return False
    push_shut(arm, joint, q, config, pull)
    return True


def state_of_hand(
    joint: JointPosterior, T_world_closed_grasp: gtsam.Pose3, T_world_hand: gtsam.Pose3
) -> float:
    """The state at which a grasp of the closed part comes nearest to where the hand is now."""
    farthest = _FARTHEST[joint.kind.unit]
    q = np.linspace(-farthest, farthest, _STATES)
    R, t = joint.joint.motion(q)
    places = R @ T_world_closed_grasp.translation() + t
    off_m = np.linalg.norm(places - T_world_hand.translation(), axis=1)
    return float(q[off_m.argmin()])
