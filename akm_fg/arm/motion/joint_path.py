"""Free motion along waypoints in joint space: which joint angles when.

Every leg between two waypoints is a straight line in joint space with a jerk-limited time law from
rest to rest; all joints share it, so that the arm stays on the line that was found to be free. A
leg begins before the one before it has ended, as early as the arm stays within a given distance of
the two lines: a corner costs little time, and the sum of two smooth legs is smooth.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import ruckig

from akm_fg.arm.body.kinematics import DDDQ_MAX, DDQ_MAX, DQ_MAX, limit_margin_rad
from akm_fg.arm.motion.time_law import sampled
from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray

# So far beyond its soft limits an arm may be pushed by what it holds and go back by itself: its
# hard limits lie four degrees beyond (0.0698 rad in every joint of the URDF that PyBullet brings).
RETURN_RAD = 0.075


@dataclass(frozen=True, slots=True)
class TimeLawConfig:
    """Shares of Franka's limits that a leg uses; two legs overlap, so at most one half each."""

    speed: float = 0.25
    acceleration: float = 0.15
    jerk: float = 0.02
    corner_rad: float = 0.03  # off the straight legs at a corner, norm over the joints

    def __post_init__(self) -> None:
        shares = (self.speed, self.acceleration, self.jerk)
        if not all(0.0 < share <= 0.5 for share in shares):
            raise ValueError(f"shares of the limits {shares}, expected 0 < share <= 0.5")


@dataclass(frozen=True, slots=True)
class JointMotion:
    """Joint references, one a control step, the first one step after the start."""

    q: FloatArray  # (N, 7) rad
    dq: FloatArray  # (N, 7) rad/s
    ddq: FloatArray  # (N, 7) rad/s^2


def joint_motion(
    waypoints: Sequence[FloatArray] | FloatArray, step_s: float, config: TimeLawConfig | None = None
) -> JointMotion:
    """Jerk-limited motion from rest at the first of the waypoints (K, 7) to rest at the last.

    Raises:
        ValueError: fewer than two waypoints.
        MotionInfeasible: a waypoint lies outside the joint limits; of the first, by `RETURN_RAD`.
    """
    config = config or TimeLawConfig()
    points = np.asarray(waypoints, dtype=float)
    if points.ndim != 2 or len(points) < 2:
        raise ValueError(f"waypoints {points.shape}, expected (K, 7) with K >= 2")
    for k, q in enumerate(points):
        if limit_margin_rad(q) < -(1e-3 if k else RETURN_RAD):
            raise MotionInfeasible(f"joint angles {np.round(q, 3)} are outside the limits")
    steps = np.diff(points, axis=0)
    legs = [(step, _leg(step, step_s, config)) for step in steps if np.abs(step).max() > 1e-6]
    if not legs:
        return JointMotion(points[-1:].copy(), np.zeros((1, 7)), np.zeros((1, 7)))
    starts = _starts(legs, config.corner_rad)
    length = max(start + len(law) for start, (_, law) in zip(starts, legs, strict=True))
    sums = np.zeros((3, length, 7))
    for start, (step, law) in zip(starts, legs, strict=True):
        end = start + len(law)
        sums[:, start:end] += law.T[:, :, None] * step
        sums[0, end:] += step
    return JointMotion(points[0] + sums[0], sums[1], sums[2])


def _leg(step: FloatArray, step_s: float, config: TimeLawConfig) -> FloatArray:
    """(n, 3) share of a leg covered, its rate and acceleration, every `step_s`, from 0 to 1."""
    inp = ruckig.InputParameter(1)
    inp.target_position = [1.0]
    reach = np.maximum(np.abs(step), 1e-9)
    inp.max_velocity = [float((config.speed * DQ_MAX / reach).min())]
    inp.max_acceleration = [float((config.acceleration * DDQ_MAX / reach).min())]
    inp.max_jerk = [float((config.jerk * DDDQ_MAX / reach).min())]
    law = sampled(inp, step_s)[1:, :, 0]
    law[-1] = [1.0, 0.0, 0.0]  # exactly
    return law


def _starts(legs: list[tuple[FloatArray, FloatArray]], corner_rad: float) -> list[int]:
    """The sample at which each leg begins; a leg meets none but its neighbours."""
    starts = [0]
    free_from = 0  # where the leg before the last one ends
    for (before, law_before), (after, law) in itertools.pairwise(legs):
        end = starts[-1] + len(law_before)
        latest = min(len(law_before), len(law), end - free_from)
        overlap = _overlap(before, law_before, after, law, corner_rad, latest)
        starts.append(end - overlap)
        free_from = end
    return starts


def _overlap(
    before: FloatArray,
    law_before: FloatArray,
    after: FloatArray,
    law_after: FloatArray,
    corner_rad: float,
    latest: int,
) -> int:
    """The largest number of samples that two legs may share within `corner_rad` of their lines.

    Where both run, the arm is off the corner by -(1 - a) `before` + b `after`, with a and b the
    shares covered; off the two lines by at most the shorter of these parts.
    """
    low, high = 0, latest
    while low < high:
        n = (low + high + 1) // 2
        left = np.linalg.norm(before) * (1.0 - law_before[len(law_before) - n :, 0])
        gone = np.linalg.norm(after) * law_after[:n, 0]
        if np.minimum(left, gone).max() <= corner_rad:
            low = n
        else:
            high = n - 1
    return low
