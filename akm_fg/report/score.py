"""How far an estimate is from the truth. Pure functions; truth is used here and nowhere else.

Measures as in the paper: the angle between axes without sign, and for the pivot the distance
between axis lines. Beside a pivot's bound stands the distance of the true line from the
estimated pivot, because that is what the bound speaks of; it is never the smaller of the two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.posterior import ArticulationPosterior, StatePosterior, normal_bound
from akm_fg.records import FloatArray, JointTruth

_PARALLEL = 1e-9  # sine of the angle below which two lines have no common normal


@dataclass(frozen=True, slots=True)
class Score:
    """Errors of one posterior. None where there is nothing to compare."""

    kind_correct: bool  # an undecided answer is not a correct one
    axis_error_rad: float | None  # without sign
    pivot_error_m: float | None  # of the true axis line from the estimated pivot
    axis_distance_m: float | None  # between the two axis lines
    state_errors: FloatArray | None  # (T,) estimate - truth, m or rad; NaN where not seen

    @property
    def state_rms(self) -> float | None:
        """Root mean square of the states' errors."""
        return _finite_rms(self.state_errors)

    @property
    def last_state_error(self) -> float | None:
        """Of the last frame in which the part was seen."""
        if self.state_errors is None or not np.isfinite(self.state_errors).any():
            return None
        return float(self.state_errors[np.isfinite(self.state_errors)][-1])


def _finite_rms(errors: FloatArray | None) -> float | None:
    if errors is None or not np.isfinite(errors).any():
        return None
    return float(np.sqrt(np.nanmean(errors**2)))


def axis_angle_rad(a: FloatArray, b: FloatArray) -> float:
    """Angle in [0, pi/2] between two directions (3,), without sign."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(np.dot(a, b))))


def point_line_distance_m(p: FloatArray, on_line: FloatArray, direction: FloatArray) -> float:
    """Distance of a point (3,) from the line through `on_line` along `direction`."""
    unit = direction / np.linalg.norm(direction)
    return float(np.linalg.norm(np.cross(p - on_line, unit)))


def line_distance_m(p: FloatArray, a: FloatArray, q: FloatArray, b: FloatArray) -> float:
    """Shortest distance between the line through p along a and the line through q along b."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    normal = np.cross(a, b)
    sine = float(np.linalg.norm(normal))
    if sine < _PARALLEL:
        return point_line_distance_m(q, p, a)
    return float(abs(np.dot(q - p, normal)) / sine)


def aligned_truth(states: StatePosterior, axis: FloatArray, truth: JointTruth) -> FloatArray:
    """True states (T,) as the estimate counts them: its zero, and along its axis.

    The zero is the first frame in which the part was seen, or where it is closed; the sign is that
    of the angle between the axes. Frames beyond the truth's are NaN.
    """
    n = len(states.mean)
    true = np.full(n, np.nan)
    known = min(n, len(truth.states))
    true[:known] = truth.states[:known]
    seen = np.flatnonzero(np.isfinite(states.mean) & np.isfinite(true))
    if not seen.size:
        return np.full(n, np.nan)
    sign = -1.0 if np.dot(axis, truth.axis) < 0 else 1.0
    return sign * (true if states.from_closed else true - true[seen[0]])


def score(
    posterior: ArticulationPosterior, truth: JointTruth, states: StatePosterior | None = None
) -> Score:
    """Score the most probable kind's fit. Joints of different kinds are not compared.

    Args:
        posterior: the estimate.
        truth: in the same world frame.
        states: scored in place of the posterior's own, same zero and axis.
    """
    correct = posterior.kind == truth.kind
    best = posterior.best
    joint = best.joint
    if joint is None or joint.kind != truth.kind:
        return Score(correct, None, None, None, None)
    pivot_error = distance = None
    if joint.pivot is not None and truth.pivot is not None:
        pivot_error = point_line_distance_m(joint.pivot, truth.pivot, truth.axis)
        distance = line_distance_m(joint.pivot, joint.axis, truth.pivot, truth.axis)
    states = states or best.states
    errors = None
    if states is not None:
        errors = states.mean - aligned_truth(states, joint.axis, truth)
    return Score(correct, axis_angle_rad(joint.axis, truth.axis), pivot_error, distance, errors)


def coverage(states: StatePosterior, errors: FloatArray, level: float = 0.95) -> float | None:
    """Share of frames (T,) whose error lies within the bound; the frame that is zero aside."""
    counted = np.isfinite(errors) & (states.sd > 0)
    if not counted.any():
        return None
    inside = np.abs(errors[counted]) <= normal_bound(level) * states.sd[counted]
    return float(inside.mean())
