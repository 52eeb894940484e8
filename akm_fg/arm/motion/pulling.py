"""The compliant pull: a force along the way the hand goes, nothing across it.

Knows only the hand's own pose and speed. The force grows with the speed error along the motion
direction, which follows the hand's measured path; across it there is damping alone, and the
wanted orientation follows the measured one, so that a door may take the hand round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from akm_fg.arm.body.impedance import bounded
from akm_fg.arm.body.kinematics import rotation_vector
from akm_fg.records import FloatArray


@dataclass(frozen=True, slots=True)
class PullConfig:
    """Gains and end conditions of the pull."""

    speed_m_s: float = 0.05  # slow enough for the part to be quasi-static
    ramp_m_s2: float = 0.05  # start and stop
    gain_n_m: float = 250.0  # force per metre of lag along the way
    damping_n_s_m: float = 60.0  # on the speed error along the way
    brake_n_s_m: float = 200.0  # on the speed above the wanted one: a part that suddenly gives
    unwind: float = 5.0  # times as fast the force falls then as it grew
    across_n_s_m: float = 40.0  # on speed across the way
    force_max_n: float = 40.0  # what gives at less is a moving part
    rotation_n_m_rad: float = 6.0
    rotation_damping: float = 1.0  # N m s/rad
    moment_max_n_m: float = 1.2  # what flat pads on a bar hold without tilting
    follow_s: float = 0.2  # time constant of the wanted orientation
    memory_m: float = 0.012  # path length over which the direction is measured
    stuck_s: float = 1.5  # no progress for this long at full force: it does not give
    progress_m: float = 0.002  # what counts as progress in that time
    settle_s: float = 0.4  # standing still at the end


class Pull:
    """State of one pull; `wrench` is called once a control step."""

    def __init__(
        self,
        direction_world: FloatArray,
        distance_m: float,
        T_start: FloatArray,
        config: PullConfig,
    ) -> None:
        self._config = config
        self._direction = direction_world / np.linalg.norm(direction_world)
        self._distance = distance_m
        self._trail = [T_start[:3, 3].copy()]  # one point a millimetre, at most memory_m long
        self._last = T_start[:3, 3].copy()
        self._R_wanted = T_start[:3, :3].copy()
        self._speed = 0.0
        self._lag_m = 0.0
        self._stuck_for = 0.0
        self._stuck_at = 0.0
        self._still_for = 0.0
        self.travelled_m = 0.0
        self.gave = True

    @property
    def finished(self) -> bool:
        """Gone far enough, or stopped because the part does not give; and at rest, without load."""
        return self._still_for >= self._config.settle_s

    def wrench(self, T: FloatArray, twist: FloatArray, dt: float) -> FloatArray:
        """Force and moment (6,) at the gripper, world axes.

        Args:
            T: measured T_world_gripper (4, 4).
            twist: measured (6,) linear, then angular speed, world axes.
            dt: control step, s.
        """
        c = self._config
        self._track(T[:3, 3])
        self._update_speed(dt)
        along = float(self._direction @ twist[:3])
        behind = self._speed - along  # m/s
        self._lag_m += (behind if behind > 0.0 or self._lag_m <= 0.0 else c.unwind * behind) * dt
        self._lag_m = min(max(self._lag_m, -0.02), c.force_max_n / c.gain_n_m)
        damping = c.damping_n_s_m if behind > 0.0 else c.brake_n_s_m
        push = c.gain_n_m * self._lag_m + damping * behind
        across = twist[:3] - along * self._direction
        force = min(push, c.force_max_n) * self._direction - c.across_n_s_m * across
        self._notice_stuck(dt)
        if not self.gave:
            self._unload(dt)
        return np.concatenate([bounded(force, 1.5 * c.force_max_n), self._moment(T, twist, dt)])

    def _moment(self, T: FloatArray, twist: FloatArray, dt: float) -> FloatArray:
        c = self._config
        behind = rotation_vector(self._R_wanted @ T[:3, :3].T)
        self._R_wanted = pin.exp3(-behind * dt / c.follow_s) @ self._R_wanted
        moment = c.rotation_n_m_rad * behind - c.rotation_damping * twist[3:]
        return bounded(moment, c.moment_max_n_m)

    def _track(self, position: FloatArray) -> None:
        """Path length, a point a millimetre, and the direction of the last `memory_m`."""
        step = position - self._trail[-1]
        length = float(np.sqrt(step @ step))
        if length < 1e-3:
            return
        self.travelled_m += length
        self._trail.append(position.copy())
        keep = round(self._config.memory_m / 1e-3)
        if len(self._trail) <= keep // 2:
            return
        self._trail = self._trail[-keep:]
        chord = self._trail[-1] - self._trail[0]
        # The chord points half its length behind: turn on by half of what it turned lately.
        middle = self._trail[len(self._trail) // 2]
        recent = _unit(self._trail[-1] - middle)
        self._direction = _unit(0.5 * _unit(chord) + 0.5 * recent)

    def _update_speed(self, dt: float) -> None:
        c = self._config
        left = max(self._distance - self.travelled_m, 0.0)
        wanted = min(c.speed_m_s, float(np.sqrt(2.0 * c.ramp_m_s2 * left)))
        self._speed = min(wanted, self._speed + c.ramp_m_s2 * dt)
        if left <= 1e-3:
            self._unload(dt)

    def _unload(self, dt: float) -> None:
        """The force fades: a hand that lets go under load springs."""
        self._speed = 0.0
        self._lag_m *= 1.0 - dt / 0.1
        self._still_for += dt

    def _notice_stuck(self, dt: float) -> None:
        if self.travelled_m - self._stuck_at > self._config.progress_m:
            self._stuck_at, self._stuck_for = self.travelled_m, 0.0
        elif self._config.gain_n_m * self._lag_m > 0.95 * self._config.force_max_n:
            self._stuck_for += dt
        self.gave = self.gave and self._stuck_for < self._config.stuck_s


def _unit(v: FloatArray) -> FloatArray:
    return v / np.linalg.norm(v)
