"""`akm-fg score`: answers against the truth."""

from __future__ import annotations

import json as json_module
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from akm_fg.cli.console.lines import console
from akm_fg.cli.exit_codes import DONE, GOAL_NOT_REACHED
from akm_fg.cli.output import json_output, write_line
from akm_fg.errors import InputError

if TYPE_CHECKING:
    from akm_fg.posterior import ArticulationPosterior
    from akm_fg.records import JointTruth

DEG = math.degrees(1.0)
SCHEMA = "akm-fg/score/1"
TRUTH = "a recording with a truth, or a JSON file with one"


@dataclass(frozen=True)
class ScoreArguments:
    """Example: akm-fg score posteriors.jsonl recordings/door recordings/drawer

    Holds answers against the true joint: kind, axis, pivot and states, each error beside the bound
    that was claimed. The exit code is 1 where a kind is wrong or undecided.
    """

    answer: Annotated[Path, tyro.conf.Positional]
    """What fit or demo wrote: a file of posteriors (one JSON object a line), or a folder."""
    truth: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Recordings with a truth, or JSON files with one (kind, axis, pivot, states): one for each
    answer, or one for all. If absent, each answer's own input."""
    json: str | None = None
    """Write one JSON object an answer to this file; - is standard output (no table then)."""


def score(arguments: ScoreArguments) -> int:
    """Run the command.

    Raises:
        InputError: an answer or a truth that cannot be read, or that has no partner.
        OutputError: the file cannot be written.
    """
    from akm_fg.io.scoring.answers import read_answers

    answers = read_answers(arguments.answer)
    truths = _truths(arguments, answers)
    code = DONE
    out = console()
    with json_output(arguments.json) as results:
        for answer, truth in zip(answers, truths, strict=True):
            found = _as_dict(answer, truth)
            code = code if found["kind_correct"] else GOAL_NOT_REACHED
            if results is not None:
                write_line(results, json_module.dumps(found, allow_nan=False))
            if arguments.json != "-":
                from akm_fg.report.rows import estimate_rows
                from akm_fg.report.tables import rows_table
                from akm_fg.report.wording import printable

                rows = estimate_rows(answer, truth)
                out.print(rows_table(printable(answer.name), rows, out.options.ascii_only))
    return code


def _truths(
    arguments: ScoreArguments, answers: Sequence[ArticulationPosterior]
) -> list[JointTruth]:
    places = arguments.truth or tuple(Path(answer.name) for answer in answers)
    if len(places) == 1:
        return [_truth(places[0])] * len(answers)
    if len(places) != len(answers):
        wrong = f"{len(places)} truths for {len(answers)} answers"
        raise InputError(arguments.answer, wrong, "one for each, or one for all")
    return [_truth(place) for place in places]


def _truth(place: Path) -> JointTruth:
    from akm_fg.io.recording import read_truth
    from akm_fg.io.scoring.truths import read_truth_file

    if place.is_dir():
        found = read_truth(place)
        if found is None:
            raise InputError(place, "says nothing of the true joint", TRUTH)
        return found
    if not place.exists():
        raise InputError(place, "does not exist", TRUTH)
    return read_truth_file(place)


def _as_dict(answer: ArticulationPosterior, truth: JointTruth) -> dict[str, Any]:
    """One line of JSON (docs/conventions.md); what there is nothing to compare of is null."""
    from akm_fg.report.score import coverage
    from akm_fg.report.score import score as scored

    found = scored(answer, truth)
    states = answer.best.states
    joint = answer.best.joint if found.axis_error_rad is not None else None  # else another kind's
    within = None
    if states is not None and found.state_errors is not None:
        within = coverage(states, found.state_errors)
    return {
        "schema": SCHEMA,
        "input": answer.name,
        "kind": answer.kind,
        "kind_true": truth.kind,
        "kind_correct": found.kind_correct,
        "probability_of_true_kind": answer.kind_probability.get(truth.kind, 0.0),
        "axis_error_deg": _finite(found.axis_error_rad, DEG),
        "axis_bound_deg": _finite(None if joint is None else joint.axis_bound_rad(), DEG),
        "pivot_error_m": _finite(found.pivot_error_m),
        "pivot_bound_m": _finite(None if joint is None else joint.pivot_bound_m()),
        "axis_distance_m": _finite(found.axis_distance_m),
        "unit": None if states is None else states.unit,
        "state_rms": _finite(found.state_rms),
        "last_state_error": _finite(found.last_state_error),
        "states_within_95": _finite(within),
    }


def _finite(value: float | None, factor: float = 1.0) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value) * factor
