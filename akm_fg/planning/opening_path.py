"""Hand poses along the joint, timed without jerks.

The hand keeps its pose relative to the part: T_world_gripper(q) = M(q) M(q_now)^-1
T_world_gripper(q_now), with M the joint's motion of the part (factors.joint_motion). The scalar
state is timed by ruckig from rest to rest; its limits follow from those of the hand through the
hand's speed per unit of state.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import ruckig

from akm_fg.errors import MotionInfeasible
from akm_fg.posterior import JointPosterior
from akm_fg.records import FloatArray, TimedPath


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
    step_s: float = 0.02  # between poses of the path


def plan_opening(
    joint: JointPosterior,
    T_world_gripper: gtsam.Pose3,
    q_now: float,
    q_target: float,
    limits: HandLimits | None = None,
) -> TimedPath:
    """Hand poses from state `q_now`, where the hand is, to `q_target`.

    Args:
        joint: the joint to follow.
        T_world_gripper: the hand's pose now, holding the part.
        q_now: present state, radians or metres.
        q_target: wanted state.
        limits: of the hand.

    Raises:
        MotionInfeasible: a state that is not finite, or no time law within the limits.
    """
    limits = limits or HandLimits()
    if not np.isfinite([q_now, q_target]).all():
        raise MotionInfeasible(f"states {q_now} to {q_target}; expected finite numbers")
    stamps_s, q = _timed_states(q_target - q_now, _speed_per_state(joint, T_world_gripper), limits)
    # Moving from q_now by dq is the joint's motion by dq, whatever q_now is: screws commute.
    R_world, t_world = joint.joint.motion(q)
    poses = tuple(
        gtsam.Pose3(gtsam.Rot3(R), t) * T_world_gripper
        for R, t in zip(R_world, t_world, strict=True)
    )
    return TimedPath(stamps_s, poses)


def _speed_per_state(joint: JointPosterior, T_world_gripper: gtsam.Pose3) -> tuple[float, float]:
    """The hand's metres and radians per unit of state."""
    if not joint.turns:
        return 1.0, 0.0
    arm = T_world_gripper.translation() - joint.joint.origin
    # Round the axis, and along it by the pitch: the two are at right angles.
    across = float(np.linalg.norm(np.cross(joint.axis, arm)))
    return float(np.hypot(across, joint.joint.pitch)), 1.0


def _timed_states(
    distance: float, per_state: tuple[float, float], limits: HandLimits
) -> tuple[FloatArray, FloatArray]:
    """Times (N,) and states (N,) from rest to rest over `distance`, jerk-limited."""
    metres, radians = per_state
    slowness = max(metres / limits.speed_m_s, radians / limits.turn_rad_s)
    wanted = ruckig.InputParameter(1)
    wanted.target_position = [distance]
    wanted.max_velocity = [1 / slowness]
    wanted.max_acceleration = [limits.acceleration_m_s2 / limits.speed_m_s / slowness]
    wanted.max_jerk = [limits.jerk_m_s3 / limits.speed_m_s / slowness]
    trajectory = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(wanted, trajectory)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise MotionInfeasible(f"no jerk-limited motion over a state of {distance:.4g}: {result}")
    count = max(int(np.ceil(trajectory.duration / limits.step_s)), 1) + 1
    stamps_s = np.linspace(0.0, max(trajectory.duration, limits.step_s), count)
    q = np.array([trajectory.at_time(float(t))[0][0] for t in stamps_s])
    return stamps_s, q
