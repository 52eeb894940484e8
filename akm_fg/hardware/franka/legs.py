"""Free motion leg by leg, as the robot's own motion generator goes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.arm.body.kinematics import DDDQ_MAX, DDQ_MAX, DQ_MAX
from akm_fg.arm.motion.joint_path import TimeLawConfig
from akm_fg.records import FloatArray

LEAST_SHARE = 0.02  # of the largest joint's limit: a joint that hardly moves is not held back by it


@dataclass(frozen=True, slots=True)
class LegLimits:
    """Limits of each joint on one leg, (7,) each: rad/s, rad/s^2, rad/s^3."""

    rates: FloatArray
    accelerations: FloatArray
    jerks: FloatArray


def leg_limits(step_rad: FloatArray, law: TimeLawConfig) -> LegLimits:
    """Limits in the ratio of the joints' ways, all of them within the law's shares.

    The robot's generator times each joint by its own limits; with limits in this ratio all joints
    have the same profile, and the arm stays on the straight line that was found to be free.

    Args:
        step_rad: (7,) what the joints turn by.
        law: shares of Franka's limits.
    """
    way = np.abs(step_rad)
    ratio = np.maximum(way / max(float(way.max()), 1e-9), LEAST_SHARE)

    def limits(most: FloatArray) -> FloatArray:
        return np.asarray(ratio * (most / ratio).min())

    return LegLimits(
        limits(law.speed * DQ_MAX), limits(law.acceleration * DDQ_MAX), limits(law.jerk * DDDQ_MAX)
    )
