"""From a path of hand poses to what the hand is asked to do at every control step.

Ruckig makes the time law, state to state and jerk-limited: one degree of freedom along the way and,
where the hand is off the path's first pose, six in which what it is off dies away. It is asked for
at every control step, so nothing is interpolated in time, and from any step on it can be made anew
to come to rest as fast as the limits allow. How fast the way may be gone follows from the joints'
limits: with q(s) the joints' angles along the way,

    dq = q' v,   ddq = q'' v^2 + q' a,   dddq = q''' v^3 + 3 q'' v a + q' j

for speed v, acceleration a and jerk j along it; each term gets an even part of its limit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import ruckig
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from akm_fg.arm.body.kinematics import DDDQ_MAX, DDQ_MAX, DQ_MAX, FrankaKinematics
from akm_fg.arm.motion.time_law import sampled
from akm_fg.records import FloatArray, HandPath, WayLimits

N_LAW = 7  # the way, and what the hand is off: m along three axes, and a rotation vector


@dataclass(frozen=True, slots=True)
class ReferenceConfig:
    """How a path becomes what the hand is asked to do."""

    # How a hand joins a path that begins elsewhere, along each axis.
    join_m: WayLimits = field(default_factory=lambda: WayLimits(0.08, 0.5, 5.0))
    join_rad: WayLimits = field(default_factory=lambda: WayLimits(0.4, 2.5, 25.0))
    share_max: float = 0.8  # of the joints' limits; what is left is for following the reference
    checks: int = 20  # poses of the path at which the joints are asked for

    def __post_init__(self) -> None:
        if not 0.0 < self.share_max <= 1.0:
            raise ValueError(f"share_max {self.share_max}, expected 0 < share_max <= 1")


class _Geometry:
    """The path's poses as functions of the way; a single pose is everywhere."""

    def __init__(self, path: HandPath) -> None:
        way, poses = path.way, np.array([T.matrix() for T in path.T_world_gripper])
        if len(poses) == 1:
            way, poses = np.array([0.0, 1.0]), np.repeat(poses, 2, axis=0)
        self._middle = Rotation.from_matrix(poses[len(poses) // 2, :3, :3])
        turns = (Rotation.from_matrix(poses[:, :3, :3]) * self._middle.inv()).as_rotvec()
        self._spline = CubicSpline(way, np.hstack([poses[:, :3, 3], turns]))
        self.length = float(path.way[-1])

    def points(self, s: FloatArray) -> tuple[FloatArray, Rotation]:
        """Places (N, 3) and orientations at ways (N,)."""
        at = self._spline(s)
        return at[:, :3], Rotation.from_rotvec(at[:, 3:]) * self._middle

    def directions(self, s: FloatArray) -> FloatArray:
        """(N, 3) unit, in which the hand goes there; 0 where it only turns."""
        going = self._spline(s, 1)[:, :3]
        length = np.linalg.norm(going, axis=1, keepdims=True)
        return np.asarray(np.where(length > 1e-7, going / np.maximum(length, 1e-7), 0.0))


@dataclass(frozen=True, slots=True)
class PoseReference:
    """Wanted hand poses, one a control step, the first where the hand is. World axes."""

    step_s: float
    p_world: FloatArray  # (N, 3) m
    R_world: FloatArray  # (N, 3, 3)
    twist: FloatArray  # (N, 6) linear m/s, then angular rad/s
    tangent: FloatArray  # (N, 3) unit direction of the way
    law: FloatArray  # (N, 3, 7) the way and what the hand is off, their speeds and accelerations
    _geometry: _Geometry
    _limits: FloatArray  # (3, 7) of speed, acceleration and jerk

    def __len__(self) -> int:
        return len(self.p_world)

    def braked(self, step: int) -> PoseReference:
        """From this control step on, to rest as fast as the limits allow, and no farther.

        Raises:
            MotionInfeasible: no such motion, which limits that are positive exclude.
        """
        state = self.law[min(step, len(self) - 1)]
        wanted = _asked(state, self._limits)
        wanted.control_interface = ruckig.ControlInterface.Velocity
        law = sampled(wanted, self.step_s)
        return _reference(self._geometry, law, self._limits, self.step_s)


def pose_reference(
    path: HandPath, T_start: FloatArray, step_s: float, config: ReferenceConfig | None = None
) -> PoseReference:
    """A reference along the path, at rest at both ends.

    Where the hand, at `T_start` (4, 4), is off the first pose (it has slipped, or was pulled
    there), the reference starts there, and what it is off dies away.

    Raises:
        MotionInfeasible: no time law, which limits that are positive exclude.
    """
    config, geometry = config or ReferenceConfig(), _Geometry(path)
    (p,), R = geometry.points(np.zeros(1))
    off = (Rotation.from_matrix(T_start[:3, :3]) * R[0].inv()).as_rotvec()
    state = np.zeros((3, N_LAW))
    state[0, 1:4], state[0, 4:] = T_start[:3, 3] - p, off
    each = [path.limits, *[config.join_m] * 3, *[config.join_rad] * 3]
    limits = np.array([[one.speed, one.acceleration, one.jerk] for one in each]).T
    wanted = _asked(state, limits)
    wanted.target_position = [geometry.length, *[0.0] * (N_LAW - 1)]
    return _reference(geometry, sampled(wanted, step_s), limits, step_s)


def _asked(state: FloatArray, limits: FloatArray) -> ruckig.InputParameter:
    """From a state (3, 7) of position, speed and acceleration, within limits (3, 7), to rest."""
    wanted = ruckig.InputParameter(N_LAW)
    wanted.current_position, wanted.current_velocity = state[0].tolist(), state[1].tolist()
    wanted.current_acceleration = state[2].tolist()
    wanted.max_velocity, wanted.max_acceleration = limits[0].tolist(), limits[1].tolist()
    wanted.max_jerk = limits[2].tolist()
    wanted.synchronization = ruckig.Synchronization.No
    return wanted


def _reference(
    geometry: _Geometry, law: FloatArray, limits: FloatArray, step_s: float
) -> PoseReference:
    p_way, R_way = geometry.points(law[:, 0, 0])
    p_world = p_way + law[:, 0, 1:4]
    R = Rotation.from_rotvec(law[:, 0, 4:]) * R_way
    twist = np.zeros((len(law), 6))
    twist[:-1, :3] = np.diff(p_world, axis=0) / step_s
    twist[:-1, 3:] = (R[1:] * R[:-1].inv()).as_rotvec() / step_s
    tangent = geometry.directions(law[:, 0, 0])
    return PoseReference(step_s, p_world, R.as_matrix(), twist, tangent, law, geometry, limits)


def within_joint_limits(
    kinematics: FrankaKinematics,
    path: HandPath,
    q_start: FloatArray,
    config: ReferenceConfig | None = None,
) -> HandPath | None:
    """The path, as fast as it and the joints allow; None where it is not reachable.

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
    limits = _joint_limits(path.way[picks], np.array(q[1:]), path.limits, config.share_max)
    return path if limits == path.limits else replace(path, limits=limits)


def _joint_limits(way: FloatArray, q: FloatArray, own: WayLimits, share: float) -> WayLimits:
    """The path's own limits, or lower ones for a share of the joints': see the module.

    Args:
        way: (K,) where the joints' angles are known.
        q: (K, 7) rad.
        own: of the path.
        share: of the joints' limits.
    """
    spline = CubicSpline(way, q)
    s = np.linspace(way[0], way[-1], 50 * len(q))
    d1, d2, d3 = (np.maximum(np.abs(spline(s, n)), 1e-12) for n in (1, 2, 3))
    top, most, jump = share * DQ_MAX, share * DDQ_MAX, share * DDDQ_MAX
    v = min(
        own.speed,
        float((top / d1).min()),
        float(np.sqrt(0.5 * most / d2).min()),
        float(np.cbrt(jump / 3.0 / d3).min()),
    )
    a = min(
        own.acceleration,
        float((0.5 * most / d1).min()),
        float((jump / 9.0 / (d2 * v)).min()),
    )
    return WayLimits(v, a, min(own.jerk, float((jump / 3.0 / d1).min())))
