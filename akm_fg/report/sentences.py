"""What a report says in words (plain text; page.py escapes it)."""

from __future__ import annotations

from akm_fg.report.rows import kind_words, most_probable
from akm_fg.report.score import score
from akm_fg.report.summary import CONFIDENCE, RunSummary
from akm_fg.report.wording import chosen, per_cent, signed, size
from factors.joint import JointKind

_NEEDED = f"{100 * CONFIDENCE:.0f} %"


def what_was_done(summary: RunSummary) -> str:
    """The run in one sentence."""
    if summary.paths is not None:
        return _of_paths(*summary.paths.p_world.shape[:2])
    frames = summary.frame_count
    count = 0 if summary.tracks is None else summary.tracks.pixels.visible.shape[1]
    watched = f"{count} points followed through {_frames(frames)} of one fixed RGB-D camera"
    watched += _surface_words(summary)
    if summary.goal is None:
        return (
            f"From {watched}, a factor graph worked out what moved and how: the kind of joint, its "
            "axis, and its state in every frame, each with its uncertainty."
            if summary.posterior is not None
            else f"From {watched}, a factor graph was to work out what moved and how."
        )
    goal = chosen(summary.goal.target, summary.goal.unit)
    if summary.tracks is None and summary.posterior is not None:
        return (
            f"A robot that has a model of an object followed its part through {_frames(frames)} of "
            f"one fixed RGB-D camera and moved it towards {goal}, looking again after each move."
        )
    begin = "A robot pulled at an object that it had never seen"
    if summary.posterior is None:
        return f"{begin}, to learn how it moves and then to move the part to {goal}."
    learnt = f"{begin}, worked out from {watched} how it moves"
    if not summary.rounds:
        return f"{learnt}, and was to move the part to {goal}."
    return f"{learnt}, and then moved the part towards {goal}, looking again after each move."


def _of_paths(frames: int, points: int) -> str:
    what = "the path of one point" if points == 1 else f"{points} points followed"
    return (
        f"From {what} through {_frames(frames)}, a factor graph worked out what moved and how: the "
        "kind of joint, its axis, and its state in every frame, each with its uncertainty."
    )


def _surface_words(summary: RunSummary) -> str:
    fit = None if summary.posterior is None else summary.posterior.fit
    if fit is None or not fit.patches_used:
        return ""
    return f" and the part's surface in {len(fit.keyframes_registered)} of them"


def _frames(n: int) -> str:
    return "1 frame" if n == 1 else f"{n} frames"


def verdict(summary: RunSummary) -> tuple[str, str]:
    """The verdict's first words, and the rest of the line."""
    heads = {
        "reached": "Target reached.",
        "not reached": "Target not reached.",
        "modelled": "Joint found.",
        "wrong": "Wrong joint kind.",
        "undecided": "Joint kind undecided.",
        "failed": "No joint found.",
    }
    parts = [_kind_part(summary), *_goal_parts(summary)]
    if summary.failure is not None:
        parts.append(f"Cause: {summary.failure.rstrip('.')}.")
    return heads[summary.verdict], " ".join(part for part in parts if part)


def _kind_part(summary: RunSummary) -> str:
    posterior = summary.posterior
    if posterior is None:
        return ""
    p = per_cent(posterior.kind_probability[most_probable(posterior)])
    words = kind_words(posterior)
    text = f"{words[0].upper()}{words[1:]}, probability {p}."
    truth = summary.truth
    if truth is not None and truth.kind != posterior.kind:
        text += f" The true joint is {truth.kind}."
    if not posterior.fit.parametric:
        text += " No joint kind explains the data."
    return text


def _goal_parts(summary: RunSummary) -> list[str]:
    goal = summary.goal
    if goal is None:
        return _error_parts(summary)
    tolerance = f"tolerance {chosen(goal.tolerance, goal.unit)}"
    parts = []
    if summary.final_error is not None:
        parts.append(f"Final error {signed(summary.final_error, goal.unit)} ({tolerance}).")
    elif summary.rounds:
        miss = summary.rounds[-1].state_mean - goal.target
        words = f"Final error {signed(miss, goal.unit)} by the program's own belief ({tolerance};"
        parts.append(f"{words} the truth is not known).")
    if not summary.rounds:
        return [*parts, "The closed loop did not run."]
    belief = per_cent(summary.rounds[-1].p_within_tolerance)
    if summary.claims_reached and summary.truly_within is False:
        parts.append(f"The program wrongly believed that it was there (probability {belief}).")
    elif not summary.claims_reached and summary.truly_within:
        parts.append(
            f"The part is within the tolerance, but the program was not sure (probability {belief},"
            f" needed {_NEEDED})."
        )
    else:
        parts.append(f"The program's probability of being within the tolerance is {belief}.")
    return parts


def _error_parts(summary: RunSummary) -> list[str]:
    """Where nothing was to be reached, the final error is the model's."""
    states = summary.frame_states
    if summary.posterior is None or summary.truth is None:
        return []
    found = score(summary.posterior, summary.truth, summary.states)
    errors = []
    if found.axis_error_rad is not None:
        errors.append(f"axis {size(found.axis_error_rad, 'rad')}")
    if found.pivot_error_m is not None:
        errors.append(f"pivot {size(found.pivot_error_m, 'm')}")
    if states is not None and found.last_state_error is not None:
        errors.append(f"last state {signed(found.last_state_error, states.unit)}")
    return [f"Final error: {', '.join(errors)}."] if errors else []


def reading(summary: RunSummary) -> list[tuple[str, str]]:
    """(term, explanation) for everything drawn or listed."""
    rows = [
        (
            "Estimate and bound",
            "All numbers come from one probabilistic model. The true value lies within the 95 % "
            "bound with 95 % probability, if the model is right: about one bound in twenty is "
            "expected to be exceeded.",
        ),
        (
            "True error",
            "Estimate minus truth, known here from the simulator or a measurement. The estimator "
            "never sees the truth; it is used for scoring alone."
            if _has_truth(summary)
            else "Not shown: no truth is known for this run.",
        ),
        ("State", _state_words(summary)),
    ]
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    if joint is not None and summary.recording is not None:
        rows.append(("Axis in the pictures", _axis_words(joint.kind)))
    return rows + (_plot_words() if summary.posterior is not None else [])


def _plot_words() -> list[tuple[str, str]]:
    return [
        (
            "State over time",
            "Above: the estimate with its 95 % band (1.96 standard deviations to either side). "
            "Below: the same band around zero on its own scale, since the band is often thinner "
            "than a line; where the truth is known, the dots are the error and 95 % of them belong "
            "inside. Gaps are frames in which the part was not seen.",
        ),
        (
            "Joint kind",
            "Probabilities of all kinds that were tried. A log₁₀ odds of +3 means a thousand to "
            f"one. A kind is named from {_NEEDED} on (dotted line); below, the answer is "
            "“undecided”, and the numbers shown are those of the most probable kind.",
        ),
    ]


def _has_truth(summary: RunSummary) -> bool:
    return summary.truth is not None or summary.final_state_true is not None


def _state_words(summary: RunSummary) -> str:
    states = summary.frame_states
    unit = states.unit if states is not None else summary.goal.unit if summary.goal else "m"
    what = "angle" if unit == "rad" else "distance"
    return f"The {what} by which the part has moved since the first frame, where it is zero."


def _axis_words(kind: JointKind) -> str:
    if not kind.turns:
        return (
            "The arrow starts at the middle of the tracked part and points where it slides as the "
            "state grows. The translucent cone around it holds the true direction with 95 % "
            "probability; the ellipse is the cone's end, at the arrow's tip."
        )
    return (
        "The line is the hinge axis, half a metre to either side of the pivot (dot), which is the "
        "point of the axis nearest to the moving points; the arrow head gives the sense of turning "
        "(right-hand rule). At each place along it the true axis passes through the translucent "
        "band with 95 % probability; the ellipse is the 95 % region of the pivot. The line is "
        "drawn over everything, also where the axis lies behind or inside the object."
    )
