"""Compliant tracking of a path of gripper poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.arm.body.impedance import bounded
from akm_fg.arm.body.kinematics import rotation_vector
from akm_fg.arm.motion.reference import PoseReference
from akm_fg.records import FloatArray


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
    # Times as fast the integral falls where the hand is ahead of its reference as it grew where it
    # was behind: what it took to set a part going would carry it beyond the path's end.
    unwind: float = 5.0
    integral_error_m: float = 0.03  # a larger error counts as this
    rest_m_s: float = 0.0015  # slower is at rest
    rest_rad_s: float = 0.01
    rest_s: float = 0.3  # for this long
    arrived_m: float = 0.0007  # the integral may go on until the error along the path is less
    settle_max_s: float = 3.0  # after the path's end, then give up waiting


class PathTracker:
    """State of one followed path; `wrench` is called once a control step."""

    def __init__(self, reference: PoseReference, config: TrackConfig) -> None:
        self._reference, self._config = reference, config
        self._step = 0
        self._late_s = 0.0
        self._rest_for = 0.0
        self._extra = np.zeros(3)  # integral force, N
        self.finished = False

    @property
    def passed(self) -> bool:
        """Whether the reference has come to its end; the hand may still be on its way."""
        return self._step >= len(self._reference)

    def brake(self) -> None:
        """From now on the reference comes to rest as fast as its limits allow."""
        self._reference = self._reference.braked(self._step)
        self._step = 0

    def wrench(self, T: FloatArray, twist: FloatArray, dt: float) -> FloatArray:
        """Force and moment (6,) at the gripper, world axes.

        Args:
            T: measured T_world_gripper (4, 4).
            twist: measured (6,) linear, then angular speed, world axes.
            dt: control step, s.
        """
        c, reference = self._config, self._reference
        k = min(self._step, len(reference) - 1)
        error, lag = reference.p_world[k] - T[:3, 3], reference.twist[k] - twist
        turn = rotation_vector(reference.R_world[k] @ T[:3, :3].T)
        along = float(reference.tangent[k] @ error)
        self._integrate(along, reference.tangent[k], dt)
        force = c.stiffness_n_m * error + c.damping_n_s_m * lag[:3]
        moment = c.rotation_n_m_rad * turn + c.rotation_damping * lag[3:]
        self._advance(twist, abs(along), dt)
        return np.concatenate(
            [bounded(force + self._extra, c.force_max_n), bounded(moment, c.moment_max_n_m)]
        )

    def _integrate(self, along_m: float, tangent: FloatArray, dt: float) -> None:
        """Along the path's own direction alone, so that model error across it builds no force."""
        c = self._config
        late = self._late_s > 0.0
        if late and abs(along_m) < c.arrived_m:
            return
        rate = c.integral_late_1_s if late else c.integral_1_s
        gain = rate * c.stiffness_n_m * dt
        along_m = min(max(along_m, -c.integral_error_m), c.integral_error_m)
        before = float(tangent @ self._extra)
        if before * along_m < 0.0:
            most_m = abs(before / gain)  # takes all of it away, and no more
            along_m = min(max(c.unwind * along_m, -most_m), most_m)
        extra = before + gain * along_m
        self._extra = min(max(extra, -c.integral_max_n), c.integral_max_n) * tangent

    def _advance(self, twist: FloatArray, left_m: float, dt: float) -> None:
        c = self._config
        self._step += 1
        if not self.passed:
            return
        self._late_s += dt
        moving = twist[:3] @ twist[:3] > c.rest_m_s**2 or twist[3:] @ twist[3:] > c.rest_rad_s**2
        moving |= left_m > c.arrived_m and self._late_s < 0.6 * c.settle_max_s
        self._rest_for = 0.0 if moving else self._rest_for + dt
        self.finished = self._rest_for >= c.rest_s or self._late_s >= c.settle_max_s
