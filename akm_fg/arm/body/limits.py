"""The real arm's limits on what is commanded, and how much of them a motion used.

Joint limits are Franka's published ones (`akm_fg.arm.body.kinematics`); the torque rate is that of
the
Franka Control Interface ("Robot and interface specifications", Panda): 1000 N m/s in every joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.arm.body.kinematics import DDDQ_MAX, DDQ_MAX, DQ_MAX, Q_MAX, Q_MIN, TAU_MAX
from akm_fg.records import FloatArray

TAU_RATE_MAX = np.full(7, 1000.0)  # N m/s


class TorqueLimiter:
    """Keeps commanded torques within the published torques and torque rates."""

    def __init__(self, tau_start: FloatArray, step_s: float) -> None:
        """`tau_start` (7,) N m is what the motors give before the first command."""
        self._tau = np.clip(tau_start, -TAU_MAX, TAU_MAX)
        self._change_max = TAU_RATE_MAX * step_s

    def limited(self, tau: FloatArray) -> FloatArray:
        """The torques (7,) N m nearest to `tau` that may follow the last ones."""
        low = np.maximum(self._tau - self._change_max, -TAU_MAX)
        high = np.minimum(self._tau + self._change_max, TAU_MAX)
        self._tau = np.minimum(np.maximum(tau, low), high)
        return self._tau


@dataclass(frozen=True, slots=True)
class LimitUsage:
    """The largest share of each limit that any joint used at any sample; 1 is the limit."""

    position_margin_rad: float  # smallest distance to the soft limits, negative outside
    velocity: float
    acceleration: float
    jerk: float
    torque: float
    torque_rate: float

    @property
    def within(self) -> bool:
        """Whether all of it stayed inside the limits."""
        shares = (self.velocity, self.acceleration, self.jerk, self.torque, self.torque_rate)
        return self.position_margin_rad >= 0.0 and max(shares) <= 1.0 + 1e-6


@dataclass(frozen=True, slots=True)
class ExecutedMotion:
    """What the arm did, one sample a control step, without gaps.

    Accelerations and jerks are differences over one control step of the joint speeds. Where a
    finger meets a bar, rigid-body physics changes a speed within one step: see `filtered`.
    """

    step_s: float
    q: FloatArray  # (N, 7) rad, after the step
    dq: FloatArray  # (N, 7) rad/s, after the step
    tau: FloatArray  # (N, 7) N m, commanded during the step

    @property
    def ddq(self) -> FloatArray:
        """(N - 1, 7) rad/s^2."""
        return np.diff(self.dq, axis=0) / self.step_s

    @property
    def dddq(self) -> FloatArray:
        """(N - 2, 7) rad/s^3."""
        return np.diff(self.dq, 2, axis=0) / self.step_s**2

    def filtered(self, cutoff_hz: float = 100.0) -> ExecutedMotion:
        """The same with the joint speeds behind a first-order low-pass, as libfranka's own.

        The default is libfranka's cut-off (`franka::kDefaultCutoffFrequency`).
        """
        gain = self.step_s / (self.step_s + 1.0 / (2.0 * np.pi * cutoff_hz))
        dq, state = np.empty_like(self.dq), self.dq[0]
        for k, sample in enumerate(self.dq):
            state = state + gain * (sample - state)
            dq[k] = state
        return ExecutedMotion(self.step_s, self.q, dq, self.tau)

    def usage(self) -> LimitUsage:
        """How much of Franka's limits the motion used.

        Raises:
            ValueError: fewer than three samples.
        """
        if len(self.q) < 3:
            raise ValueError(f"{len(self.q)} samples, expected at least 3")
        return LimitUsage(
            position_margin_rad=float(np.minimum(self.q - Q_MIN, Q_MAX - self.q).min()),
            velocity=_share(self.dq, DQ_MAX),
            acceleration=_share(self.ddq, DDQ_MAX),
            jerk=_share(self.dddq, DDDQ_MAX),
            torque=_share(self.tau, TAU_MAX),
            torque_rate=_share(np.diff(self.tau, axis=0) / self.step_s, TAU_RATE_MAX),
        )


def _share(values: FloatArray, limit: FloatArray) -> float:
    return float((np.abs(values) / limit).max())


class MotionRecorder:
    """Collects executed samples while an arm moves (`SimFranka.record`)."""

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self._samples: list[tuple[FloatArray, FloatArray, FloatArray]] = []

    def __len__(self) -> int:
        return len(self._samples)

    def add(self, q: FloatArray, dq: FloatArray, tau: FloatArray) -> None:
        """One step: joint angles and speeds after it, the torques commanded during it."""
        self._samples.append((q, dq, tau))

    def motion(self, first: int = 0, end: int | None = None) -> ExecutedMotion:
        """What was recorded, from sample `first` to before sample `end`."""
        q, dq, tau = np.array(self._samples[first:end]).reshape(-1, 3, 7).transpose(1, 0, 2)
        return ExecutedMotion(self._step_s, q, dq, tau)
