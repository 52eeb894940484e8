"""The table of a run: each quantity with its 95 % bound and the true error beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.posterior import (
    ArticulationPosterior,
    JointPosterior,
    StatePosterior,
    normal_bound,
)
from akm_fg.records import JointTruth
from akm_fg.report.score import Score, coverage, score
from akm_fg.report.summary import Goal, RunSummary
from akm_fg.report.wording import NONE, chosen, per_cent, signed, size, state, vector


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    quantity: str
    estimate: str
    bound: str = NONE
    error: str = NONE
    good: bool | None = None  # right, or inside its bound; None where it is not known


def score_rows(summary: RunSummary) -> tuple[Row, ...]:
    """All quantities that the run has. Empty where it has no posterior."""
    posterior = summary.posterior
    if posterior is None:
        return ()
    rows = estimate_rows(posterior, summary.truth, summary.states)
    return (*rows, *_final_rows(summary))


def estimate_rows(
    posterior: ArticulationPosterior,
    truth: JointTruth | None,
    states: StatePosterior | None = None,
) -> tuple[Row, ...]:
    """What was estimated, against the truth where that is known.

    Args:
        posterior: the estimate.
        truth: in the same world frame.
        states: shown in place of the posterior's own, same zero and axis.
    """
    found = None if truth is None else score(posterior, truth, states)
    rows = [_kind_row(posterior, truth, found)]
    best = posterior.best
    if best.joint is not None:
        rows += [_axis_row(best.joint, found), _pivot_row(best.joint, found)]
    states = states or best.states
    if states is not None:
        rows += _state_rows(states, found)
    return tuple(rows)


def kind_words(posterior: ArticulationPosterior) -> str:
    """The answer, and what is most probable where there is none."""
    if posterior.kind != "undecided":
        return posterior.kind
    return f"undecided (most probable: {most_probable(posterior)})"


def most_probable(posterior: ArticulationPosterior) -> str:
    """The kind with the largest probability, also where that does not decide."""
    return max(posterior.kind_probability, key=posterior.kind_probability.__getitem__)


def _kind_row(
    posterior: ArticulationPosterior, truth: JointTruth | None, found: Score | None
) -> Row:
    bound = "probability " + per_cent(posterior.kind_probability[most_probable(posterior)])
    if truth is None or found is None:
        return Row("joint kind", kind_words(posterior), bound)
    if found.kind_correct:
        return Row("joint kind", kind_words(posterior), bound, "right", True)
    verb = "undecided" if posterior.kind == "undecided" else "wrong"
    error = f"{verb}: truly {truth.kind}"
    return Row("joint kind", kind_words(posterior), bound, error, False)


def _axis_row(joint: JointPosterior, found: Score | None) -> Row:
    bound = joint.axis_bound_rad()
    error = found.axis_error_rad if found is not None else None
    return Row(
        "axis direction",
        vector(joint.axis),
        size(bound, "rad"),
        size(error, "rad"),
        None if error is None else error <= bound,
    )


def _pivot_row(joint: JointPosterior, found: Score | None) -> Row:
    bound = joint.pivot_bound_m()
    if joint.pivot is None or bound is None:
        return Row("pivot", "none: a sliding joint has no pivot")
    error = found.pivot_error_m if found is not None else None
    text = size(error, "m")
    if found is not None and found.axis_distance_m is not None:
        text += f" (axis lines {size(found.axis_distance_m, 'm')} apart)"
    return Row(
        "pivot",
        vector(joint.pivot, digits=1, scale=100) + " cm",
        size(bound, "m"),
        text,
        None if error is None else error <= bound,
    )


def _state_rows(states: StatePosterior, found: Score | None) -> list[Row]:
    last = states.last_seen
    if last is None:
        return [Row("state", "the part was not seen in any frame")]
    unit = states.unit
    bound = normal_bound() * float(states.sd[last])
    errors = found.state_errors if found is not None else None
    error = None if errors is None else float(errors[last])
    known = error is not None and np.isfinite(error)
    seen = np.isfinite(states.mean)
    typical = normal_bound() * float(np.median(states.sd[seen]))
    over = Row("state, all frames", f"{seen.sum()} of {seen.size} frames seen", size(typical, unit))
    if found is not None and errors is not None and found.state_rms is not None:
        share = coverage(states, errors)
        inside = "" if share is None else f", {100 * share:.0f} % of frames inside"
        over = Row(
            over.quantity, over.estimate, over.bound, f"rms {size(found.state_rms, unit)}{inside}"
        )
    return [
        Row(
            f"state, frame {last}",
            state(float(states.mean[last]), unit),
            size(bound, unit),
            signed(error, unit),
            bool(abs(error) <= bound) if error is not None and known else None,
        ),
        over,
    ]


def target_words(goal: Goal) -> str:
    """Where the part was wanted, and how exactly ("30 cm ± 1 cm")."""
    return f"{chosen(goal.target, goal.unit)} ± {chosen(goal.tolerance, goal.unit)}"


def _final_rows(summary: RunSummary) -> list[Row]:
    """What the closed loop ended with; the target is in the row's name."""
    goal = summary.goal
    if goal is None or not summary.rounds:
        return []
    end = summary.rounds[-1]
    bound = normal_bound() * end.state_sd
    true = summary.final_state_true
    error = None if true is None else end.state_mean - true
    return [
        Row(
            f"final state (target {target_words(goal)})",
            state(end.state_mean, goal.unit),
            size(bound, goal.unit),
            signed(error, goal.unit),
            None if error is None else abs(error) <= bound,
        ),
        Row(
            "within tolerance",
            f"probability {per_cent(end.p_within_tolerance)}",
            NONE,
            _within_words(summary),
            None if summary.truly_within is None else summary.truly_within,
        ),
    ]


def _within_words(summary: RunSummary) -> str:
    """The true distance from the target."""
    if summary.goal is None or summary.final_error is None:
        return NONE
    return f"{signed(summary.final_error, summary.goal.unit)} from the target"
