"""Compliant tracking of a timed path of gripper poses."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.records import FloatArray, TimedPath
from sim.impedance import bounded
from sim.kinematics import FrankaKinematics, pose_error


@dataclass(frozen=True, slots=True)
class TrackConfig:
    """Gains while holding a part whose model may be a little wrong."""

    stiffness_n_m: float = 700.0  # 1 cm of model error presses with 7 N
    damping_n_s_m: float = 90.0
    force_max_n: float = 60.0  # below what 70 N of squeeze holds by friction
    rotation_n_m_rad: float = 25.0
    rotation_damping: float = 5.0  # N m s/rad
    moment_max_n_m: float = 2.5
    integral_1_s: float = 2.5  # takes up the part's friction along the path
    integral_late_1_s: float = 5.0  # after its end: to turn the part back takes twice the friction
    integral_max_n: float = 25.0
    rest_m_s: float = 0.0015  # slower is at rest
    rest_s: float = 0.3  # for this long
    arrived_m: float = 0.0007  # the integral may go on until the error along the path is less
    settle_max_s: float = 3.0  # after the path's end, then give up waiting


def path_is_reachable(
    kinematics: FrankaKinematics, path: TimedPath, q_start: FloatArray, checks: int = 20
) -> bool:
    """Whether inverse kinematics finds one continuous joint path from `q_start`."""
    n = len(path.T_world_gripper)
    picks = np.unique(np.linspace(0, n - 1, min(n, checks)).round().astype(int))
    q: FloatArray | None = q_start
    for k in picks:
        assert q is not None
        q_next = kinematics.solve(path.T_world_gripper[k], q)
        if q_next is None:
            return False
        q = q_next
    return True


class PathTracker:
    """State of one followed path; `wrench` is called once a control step."""

    def __init__(self, path: TimedPath, config: TrackConfig) -> None:
        self._path, self._config = path, config
        self._time = 0.0
        self._rest_for = 0.0
        self._extra = np.zeros(3)  # integral force, N
        self._tangents = _tangents(path)
        self.finished = False

    def wanted(self, time_s: float) -> tuple[gtsam.Pose3, FloatArray]:
        """The pose at a time and its velocity (6,): linear, then angular, world axes."""
        stamps, poses = self._path.stamps_s, self._path.T_world_gripper
        if len(poses) == 1 or time_s >= stamps[-1]:
            return poses[-1], np.zeros(6)
        k = int(np.clip(np.searchsorted(stamps, time_s, side="right") - 1, 0, len(poses) - 2))
        span = float(stamps[k + 1] - stamps[k])
        share = float(np.clip((time_s - stamps[k]) / span, 0.0, 1.0))
        a, b = poses[k], poses[k + 1]
        R = a.rotation() * gtsam.Rot3.Expmap(
            share * gtsam.Rot3.Logmap(a.rotation().between(b.rotation()))
        )
        t = (1.0 - share) * a.translation() + share * b.translation()
        velocity = pose_error(b.matrix(), a.matrix()) / span
        return gtsam.Pose3(R, t), velocity

    def wrench(self, T: FloatArray, twist: FloatArray, dt: float) -> FloatArray:
        """Force and moment (6,) at the gripper, world axes.

        Args:
            T: measured T_world_gripper (4, 4).
            twist: measured (6,) linear, then angular speed, world axes.
            dt: control step, s.
        """
        c = self._config
        pose, velocity = self.wanted(self._time)
        error = pose_error(pose.matrix(), T)
        self._integrate(error[:3], dt)
        force = c.stiffness_n_m * error[:3] + c.damping_n_s_m * (velocity[:3] - twist[:3])
        moment = c.rotation_n_m_rad * error[3:] + c.rotation_damping * (velocity[3:] - twist[3:])
        self._advance(twist, abs(float(self._tangent() @ error[:3])), dt)
        return np.concatenate(
            [bounded(force + self._extra, c.force_max_n), bounded(moment, c.moment_max_n_m)]
        )

    def _integrate(self, error: FloatArray, dt: float) -> None:
        """Along the path's own direction alone, so that model error across it builds no force."""
        c = self._config
        tangent = self._tangent()
        late = self._time > float(self._path.stamps_s[-1])
        rate = c.integral_late_1_s if late else c.integral_1_s
        gain = rate * c.stiffness_n_m * dt
        along = float(np.clip(tangent @ error, -0.03, 0.03))
        if late and abs(along) < c.arrived_m:
            return
        self._extra = bounded(self._extra + gain * along * tangent, c.integral_max_n)
        self._extra = tangent * float(tangent @ self._extra)

    def _tangent(self) -> FloatArray:
        """Unit direction of the path now, or of its last moving stretch; zero if it stands."""
        k = int(np.searchsorted(self._path.stamps_s, self._time, side="right"))
        return self._tangents[min(max(k - 1, 0), len(self._tangents) - 1)]

    def _advance(self, twist: FloatArray, left_m: float, dt: float) -> None:
        c = self._config
        self._time += dt
        late = self._time - float(self._path.stamps_s[-1])
        if late <= 0.0:
            return
        moving = np.linalg.norm(twist[:3]) > c.rest_m_s or np.linalg.norm(twist[3:]) > 0.01
        moving |= left_m > c.arrived_m and late < 0.6 * c.settle_max_s
        self._rest_for = 0.0 if moving else self._rest_for + dt
        self.finished = self._rest_for >= c.rest_s or late >= c.settle_max_s


def _tangents(path: TimedPath) -> FloatArray:
    """(max(N - 1, 1), 3) unit direction of each stretch; a standing one has that before it."""
    points = np.array([T.translation() for T in path.T_world_gripper])
    result = np.zeros((max(len(points) - 1, 1), 3))
    for k, step in enumerate(np.diff(points, axis=0)):
        length = float(np.linalg.norm(step))
        if length > 1e-6:
            result[k] = step / length
        elif k > 0:
            result[k] = result[k - 1]
    return result
