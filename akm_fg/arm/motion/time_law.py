"""Ruckig's jerk-limited motions, and its word on those that there are none of."""

from __future__ import annotations

import numpy as np
import ruckig

from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray, HandPath


def jerk_limited(wanted: ruckig.InputParameter) -> ruckig.Trajectory:
    """The fastest motion from state to state within its limits.

    Raises:
        MotionInfeasible: there is none.
    """
    n = wanted.degrees_of_freedom
    trajectory = ruckig.Trajectory(n)
    result = ruckig.Ruckig(n).calculate(wanted, trajectory)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise MotionInfeasible(f"no jerk-limited motion to {wanted.target_position}: {result}")
    return trajectory


def sampled(wanted: ruckig.InputParameter, step_s: float) -> FloatArray:
    """Positions, speeds and accelerations (N, 3, K) of such a motion at every control step.

    The first are those of now, the last those of its end.

    Raises:
        MotionInfeasible: there is none.
    """
    trajectory = jerk_limited(wanted)
    count = max(int(np.ceil(trajectory.duration / step_s - 1e-9)), 1) + 1
    times_s = np.minimum(step_s * np.arange(count), trajectory.duration)
    return np.array([trajectory.at_time(t) for t in times_s.tolist()])


def duration_s(path: HandPath) -> float:
    """How long a path's way takes within its limits, from rest to rest."""
    wanted, limits = ruckig.InputParameter(1), path.limits
    wanted.target_position = [float(path.way[-1])]
    wanted.max_velocity, wanted.max_acceleration = [limits.speed], [limits.acceleration]
    wanted.max_jerk = [limits.jerk]
    return float(jerk_limited(wanted).duration)
