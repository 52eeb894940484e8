"""Hand poses along the joint, and how fast the hand may go along it.

The hand keeps its pose relative to the part: T_world_gripper(q) = M(q) M(q_now)^-1
T_world_gripper(q_now), with M the joint's motion of the part (factors.joint_motion). The way is the
scalar state; its limits follow from those of the hand through the hand's speed per unit of state.
When the hand is where is the arm's to say, at its control rate (`akm_fg.arm.motion.reference`).
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.errors import MotionInfeasible
from akm_fg.posterior import JointPosterior
from akm_fg.records import HandPath, WayLimits


@dataclass(frozen=True, slots=True)
class HandLimits:
    """How fast the hand moves while it holds a part.

    Slow, so that the part follows quasi-statically and friction holds the grasp; far inside the
    arm's own limits.
    """

    speed_m_s: float = 0.10
    acceleration_m_s2: float = 0.3
    jerk_m_s3: float = 2.0
    turn_rad_s: float = 0.5
    # Between poses of the path: a cubic through poses so far apart leaves a circle's arc by
    # (step_rad^4 / 384) of its radius.
    step_m: float = 0.02
    step_rad: float = 0.05


def plan_opening(
    joint: JointPosterior,
    T_world_gripper: gtsam.Pose3,
    q_now: float,
    q_target: float,
    limits: HandLimits | None = None,
) -> HandPath:
    """Hand poses from state `q_now`, where the hand is, to `q_target`.

    Args:
        joint: the joint to follow.
        T_world_gripper: the hand's pose now, holding the part.
        q_now: present state, radians or metres.
        q_target: wanted state.
        limits: of the hand.

    Raises:
        MotionInfeasible: a state that is not finite.
    """
    limits = limits or HandLimits()
    if not np.isfinite([q_now, q_target]).all():
        raise MotionInfeasible(f"states {q_now} to {q_target}; expected finite numbers")
    way = q_target - q_now
    metres, radians = _speed_per_state(joint, T_world_gripper)
    steps = abs(way) * max(metres / limits.step_m, radians / limits.step_rad)
    q = np.linspace(0.0, way, max(int(np.ceil(steps)), 1) + 1) if way else np.zeros(1)
    # Moving from q_now by dq is the joint's motion by dq, whatever q_now is: screws commute.
    R_world, t_world = joint.joint.motion(q)
    poses = tuple(
        gtsam.Pose3(gtsam.Rot3(R), t) * T_world_gripper
        for R, t in zip(R_world, t_world, strict=True)
    )
    slowness = max(metres / limits.speed_m_s, radians / limits.turn_rad_s)
    speed = 1.0 / slowness
    shares = limits.acceleration_m_s2 / limits.speed_m_s, limits.jerk_m_s3 / limits.speed_m_s
    return HandPath(np.abs(q), poses, WayLimits(speed, shares[0] * speed, shares[1] * speed))


def _speed_per_state(joint: JointPosterior, T_world_gripper: gtsam.Pose3) -> tuple[float, float]:
    """The hand's metres and radians per unit of state."""
    if not joint.turns:
        return 1.0, 0.0
    arm = T_world_gripper.translation() - joint.joint.origin
    # Round the axis, and along it by the pitch: the two are at right angles.
    across = float(np.linalg.norm(np.cross(joint.axis, arm)))
    return float(np.hypot(across, joint.joint.pitch)), 1.0
