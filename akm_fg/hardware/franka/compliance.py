"""Where to put a spring's end so that it pulls as a law asks.

The laws of `akm_fg.arm` (`Pull`, `PathTracker`) say a wrench every few milliseconds. What runs at
the robot's own rate is a spring with a damper, K (x_ref - x) + D (v_ref - v), whose reference comes
from here. With

    x_ref = x + (F - D (v_ref - v)) / K

it gives the force F at that moment. Between two references, and if none comes any more, it goes on
as a spring: the hand goes at most as far as the spring was stretched and comes to rest, which a
constant force would not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from akm_fg.arm.body.impedance import bounded
from akm_fg.hardware.franka.config import SpringConfig
from akm_fg.records import FloatArray


@dataclass(frozen=True, slots=True)
class HandState:
    """The hand at one moment."""

    time_s: float  # of the robot's clock
    T_world_gripper: FloatArray  # (4, 4)
    twist: FloatArray  # (6,) linear m/s, then angular rad/s, world axes


@dataclass(frozen=True, slots=True)
class Reference:
    """Where the spring's end is to be, and how it moves."""

    T_world_gripper: FloatArray  # (4, 4)
    twist: FloatArray  # (6,) as in HandState


class Law(Protocol):
    """Says where the spring's end goes; called about every `period_s` of the robot's clock."""

    def __call__(self, hand: HandState, dt_s: float) -> Reference | None:
        """The next reference, or None when there is nothing left to do."""
        ...


class WrenchLaw(Protocol):
    """A compliant motion as a wrench: `Pull`, `PathTracker`."""

    @property
    def finished(self) -> bool:
        """Nothing is left to do."""
        ...

    def wrench(self, T: FloatArray, twist: FloatArray, dt: float) -> FloatArray:
        """Force [N] and moment [N m] (6,) at the hand, world axes."""
        ...


class SpringOfWrench:
    """The law that stretches a spring to exert another law's wrench.

    The inner law is asked once for each whole period that has passed: its steps are counted in
    periods.
    """

    def __init__(self, law: WrenchLaw, spring: SpringConfig, period_s: float) -> None:
        self._law, self._spring, self._period_s = law, spring, period_s

    def __call__(self, hand: HandState, dt_s: float) -> Reference | None:
        """See Law."""
        wrench = np.zeros(6)
        for _ in range(max(round(dt_s / self._period_s), 1)):
            if self._law.finished:
                return None
            wrench = self._law.wrench(hand.T_world_gripper, hand.twist, self._period_s)
        return stretched(hand, wrench, self._spring)


def stretched(hand: HandState, wrench: FloatArray, spring: SpringConfig) -> Reference:
    """The reference at which a spring exerts a wrench (6,) on the hand; at rest itself.

    The damper pulls back with D v; the spring is stretched by as much more. franky's damping is
    critical for a unit mass, D = 2 sqrt(K).
    """
    k, k_rot = spring.stiffness_n_m, spring.stiffness_rot
    d, d_rot = 2.0 * np.sqrt(k), 2.0 * np.sqrt(k_rot)
    way = (wrench[:3] + d * hand.twist[:3]) / k
    turn = (wrench[3:] + d_rot * hand.twist[3:]) / k_rot
    T = hand.T_world_gripper.copy()
    T[:3, 3] += bounded(way, spring.stretch_max_m)
    T[:3, :3] = pin.exp3(bounded(turn, spring.stretch_max_rad)) @ T[:3, :3]
    return Reference(T, np.zeros(6))
