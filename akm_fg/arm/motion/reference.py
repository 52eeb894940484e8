"""From a timed path of hand poses to what the hand is asked to do at every control step.

The poses become a twice differentiable motion that starts where the hand is and ends at rest, and
that takes longer than asked where the joints would otherwise be asked for more than they can give.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from akm_fg.arm.body.kinematics import DDDQ_MAX, DDQ_MAX, DQ_MAX, FrankaKinematics
from akm_fg.records import FloatArray, TimedPath


@dataclass(frozen=True, slots=True)
class ReferenceConfig:
    """How a path becomes what the hand is asked to do."""

    blend_s: float = 0.5  # within which it joins a path that begins elsewhere
    share_max: float = 0.8  # of the joints' limits; what is left is for following the reference
    checks: int = 20  # poses of the path at which the joints are asked for

    def __post_init__(self) -> None:
        if not 0.0 < self.share_max <= 1.0:
            raise ValueError(f"share_max {self.share_max}, expected 0 < share_max <= 1")


@dataclass(frozen=True, slots=True)
class PoseReference:
    """Wanted hand poses, one a control step, the first where the hand is. World axes."""

    step_s: float
    p_world: FloatArray  # (N, 3) m
    R_world: FloatArray  # (N, 3, 3)
    twist: FloatArray  # (N, 6) linear m/s, then angular rad/s
    tangent: FloatArray  # (N, 3) unit direction of the way; where it stands, that of before

    def __len__(self) -> int:
        return len(self.p_world)


def pose_reference(
    path: TimedPath, T_start: FloatArray, step_s: float, blend_s: float = 0.5
) -> PoseReference:
    """A reference through the path's poses at its times, at rest at both ends.

    Where the hand, at `T_start` (4, 4), is off the first pose (it has slipped, or was pulled
    there), the reference starts there and joins the path within `blend_s`.
    """
    stamps = path.stamps_s
    poses = np.array([T.matrix() for T in path.T_world_gripper])
    if len(poses) == 1:
        stamps, poses = np.array([0.0, blend_s]), np.repeat(poses, 2, axis=0)
    count = max(int(np.ceil((stamps[-1] - stamps[0]) / step_s)), 1)
    t = np.minimum(stamps[0] + step_s * np.arange(count + 1), stamps[-1])
    middle = Rotation.from_matrix(poses[len(poses) // 2, :3, :3])
    turns = (Rotation.from_matrix(poses[:, :3, :3]) * middle.inv()).as_rotvec()
    spline = CubicSpline(stamps, np.hstack([poses[:, :3, 3], turns]), bc_type="clamped")(t)
    x = np.clip((t - stamps[0]) / blend_s, 0.0, 1.0)[:, None]
    left = 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)  # of the way from the start to the path
    R = Rotation.from_rotvec(spline[:, 3:]) * middle
    off = (Rotation.from_matrix(T_start[:3, :3]) * R[0].inv()).as_rotvec()
    R = Rotation.from_rotvec(left * off) * R
    p_world = spline[:, :3] + left * (T_start[:3, 3] - spline[0, :3])
    twist = np.zeros((len(t), 6))
    twist[:-1, :3] = np.diff(p_world, axis=0) / step_s
    twist[:-1, 3:] = (R[1:] * R[:-1].inv()).as_rotvec() / step_s
    return PoseReference(step_s, p_world, R.as_matrix(), twist, _tangents(spline[:, :3]))


def _tangents(p_world: FloatArray) -> FloatArray:
    """(N, 3) directions of the way at each of the points (N, 3), zero before it first moves."""
    steps = np.diff(p_world, axis=0, append=p_world[-1:])
    lengths = np.linalg.norm(steps, axis=1)
    moves = lengths > 1e-7
    last = np.maximum.accumulate(np.where(moves, np.arange(len(steps)), -1))
    if not moves.any():
        return np.zeros_like(steps)
    last = np.where(last < 0, int(np.argmax(moves)), last)
    result: FloatArray = steps[last] / lengths[last, None]
    return result


def within_joint_limits(
    kinematics: FrankaKinematics,
    path: TimedPath,
    q_start: FloatArray,
    step_s: float,
    config: ReferenceConfig | None = None,
) -> TimedPath | None:
    """The path, slowed down as a whole where the joints ask for it; None where it is not reachable.

    Joint angles along the path come from inverse kinematics at some of its poses, one solution
    following the other from `q_start` (7,) on, and a spline between them.
    """
    config, n = config or ReferenceConfig(), len(path.T_world_gripper)
    picks = np.unique(np.linspace(0, n - 1, min(n, config.checks)).round().astype(int))
    q = [q_start]
    for k in picks:
        q_next = kinematics.solve(path.T_world_gripper[k], q[-1])
        if q_next is None:
            return None
        q.append(q_next)
    if n == 1:
        return path
    stretch = _stretch(path.stamps_s[picks], np.array(q[1:]), step_s, config.share_max)
    return path if stretch <= 1.0 else TimedPath(stretch * path.stamps_s, path.T_world_gripper)


def _stretch(stamps_s: FloatArray, q: FloatArray, step_s: float, share: float) -> float:
    """By how much a motion through q (K, 7) must take longer for a share of the joints' limits."""
    spline = CubicSpline(stamps_s, q, bc_type="clamped")
    t = np.linspace(stamps_s[0], stamps_s[-1], 50 * len(q))
    ddq = spline(t, 2)
    velocity = (np.abs(spline(t, 1)) / DQ_MAX).max()
    acceleration = (np.abs(ddq) / DDQ_MAX).max()
    # At both ends the acceleration begins and ends within one control step.
    ends = np.abs(ddq[[0, -1]]).max(axis=0) / step_s
    jerk = (np.maximum(np.abs(spline(t, 3)).max(axis=0), ends) / DDDQ_MAX).max()
    shares = np.array([velocity, acceleration, jerk]) / share
    return float(max(shares[0], np.sqrt(shares[1]), np.sqrt(shares[2])))
