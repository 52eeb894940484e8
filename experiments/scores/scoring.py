"""From an answer and the truth to the numbers that the tables are made of.

Errors and normalised errors are those of the fit of the *true* kind, whatever kind was named;
whether the kind was named rightly stands beside them. Axis errors have no sign. Truth is used
here and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from akm_fg.geometry.lines import line_in_joint_frame
from akm_fg.posterior import StatePosterior, normal_bound
from akm_fg.records import FloatArray, JointTruth
from akm_fg.report.score import (
    aligned_truth,
    axis_angle_rad,
    line_distance_m,
    point_line_distance_m,
)
from experiments.scores.answers import JointFit, Uncertainty

LEVEL = 0.95  # of the regions whose coverage is counted
_AXIS, _PIVOT = [0, 1], [3, 4]  # directions of the tangent that move the axis line


@dataclass(frozen=True, slots=True)
class Errors:
    """How far a fit is from the truth. None where there is nothing to compare."""

    axis_error_deg: float | None = None
    pivot_error_m: float | None = None  # of the true axis line from the estimated pivot
    line_distance_m: float | None = None  # between the axis lines: the paper's measure
    last_state_error: float | None = None  # estimate - truth, m or rad
    state_rms_error: float | None = None


@dataclass(frozen=True, slots=True)
class Consistency:
    """Errors over what the posterior claims: squared Mahalanobis lengths (NEES) and coverage."""

    nees_axis: float | None = None  # 2 degrees of freedom
    nees_pivot: float | None = None  # 2; None for prismatic
    nees_joint: float | None = None
    dof_joint: int | None = None  # 4, or 2 for prismatic
    nees_last_state: float | None = None  # 1
    axis_inside95: bool | None = None
    pivot_inside95: bool | None = None
    joint_inside95: bool | None = None
    last_state_inside95: bool | None = None
    axis_inside_bound: bool | None = None  # the radius that the program prints
    pivot_inside_bound: bool | None = None
    states_inside95: float | None = None  # share of the frames


def axis_off(
    axis: FloatArray, pivot: FloatArray | None, truth: JointTruth
) -> tuple[float, float | None]:
    """Degrees between an axis (3,) and the true one, metres between their lines, if both have one.

    The paper's measures of a joint.
    """
    distance_m = None
    if pivot is not None and truth.pivot is not None:
        distance_m = line_distance_m(pivot, axis, truth.pivot, truth.axis)
    return float(np.degrees(axis_angle_rad(axis, truth.axis))), distance_m


def within(axis_error_deg: float | None, line_m: float | None, degrees_and_cm: float) -> bool:
    """The paper's ASR_x of a joint whose kind is right; None: no axis, or nothing that turns."""
    if axis_error_deg is None:
        return False
    return axis_error_deg <= degrees_and_cm and 100.0 * (line_m or 0.0) <= degrees_and_cm


def errors_of(fit: JointFit, truth: JointTruth) -> Errors:
    """Errors of a fit of the true kind."""
    pivot_error = None
    if fit.pivot is not None and truth.pivot is not None:
        pivot_error = point_line_distance_m(fit.pivot, truth.pivot, truth.axis)
    axis_error_deg, distance = axis_off(fit.axis, fit.pivot, truth)
    state_errors = _state_errors(fit, truth)
    known = state_errors[np.isfinite(state_errors)]
    return Errors(
        axis_error_deg=axis_error_deg,
        pivot_error_m=pivot_error,
        line_distance_m=distance,
        last_state_error=float(known[-1]) if known.size else None,
        state_rms_error=float(np.sqrt((known**2).mean())) if known.size else None,
    )


def consistency_of(fit: JointFit, truth: JointTruth) -> Consistency:
    """Whether the fit's covariance tells the truth; empty where it claims none."""
    if fit.uncertainty is None:
        return Consistency()
    claimed = fit.uncertainty
    on_axis = claimed.T_world_joint[:3, 3] if truth.pivot is None else truth.pivot
    xi = line_in_joint_frame(claimed.T_world_joint, truth.axis, on_axis)
    axis = _nees(xi, claimed.cov, _AXIS)
    if truth.pivot is None:
        pivot, joint, dof = None, axis, 2
    else:
        pivot, joint, dof = (
            _nees(xi, claimed.cov, _PIVOT),
            _nees(xi, claimed.cov, _AXIS + _PIVOT),
            4,
        )
    last, share = _states_over_claim(_state_errors(fit, truth), claimed)
    angle = axis_angle_rad(fit.axis, truth.axis)
    bound_m = claimed.pivot_bound_m
    return Consistency(
        nees_axis=axis,
        nees_pivot=pivot,
        nees_joint=joint,
        dof_joint=dof,
        nees_last_state=last,
        axis_inside95=_inside(axis, 2),
        pivot_inside95=_inside(pivot, 2),
        joint_inside95=_inside(joint, dof),
        last_state_inside95=_inside(last, 1),
        axis_inside_bound=bool(angle <= claimed.axis_bound_rad),
        pivot_inside_bound=None if bound_m is None else bool(np.linalg.norm(xi[_PIVOT]) <= bound_m),
        states_inside95=share,
    )


def brier_score(kind_probability: dict[str, float], kind: str) -> float:
    """Sum over the kinds of (probability - truth)^2 (Brier, 1950): 0 best, 2 worst."""
    return sum((p - float(name == kind)) ** 2 for name, p in kind_probability.items())


def _state_errors(fit: JointFit, truth: JointTruth) -> FloatArray:
    """(T,) estimate - truth, zero and sign as the estimate counts them."""
    states = StatePosterior("rad", fit.states, np.zeros_like(fit.states))  # in either unit
    return fit.states - aligned_truth(states, fit.axis, truth)


def _states_over_claim(
    errors: FloatArray, claimed: Uncertainty
) -> tuple[float | None, float | None]:
    """Squared normalised error of the last state, and share of the frames inside 95 %."""
    counted = np.isfinite(errors) & (claimed.state_sd > 0)
    if not counted.any():
        return None, None
    ratio = errors[counted] / claimed.state_sd[counted]
    return float(ratio[-1] ** 2), float((np.abs(ratio) <= normal_bound(LEVEL)).mean())


def _nees(xi: FloatArray, cov: FloatArray, directions: list[int]) -> float:
    block = cov[np.ix_(directions, directions)]
    return float(xi[directions] @ np.linalg.pinv(block) @ xi[directions])


def _inside(nees: float | None, dof: int) -> bool | None:
    return None if nees is None else bool(nees <= stats.chi2.ppf(LEVEL, dof))
