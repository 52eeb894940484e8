"""One row a trial, a JSON line written as the trial ends; what is there is not done again."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from akm_fg.records import JointTruth
from experiments.rows.json_lines import append_line, whole_lines
from experiments.scores.answers import Answer
from experiments.scores.scoring import Consistency, Errors, brier_score, consistency_of, errors_of

_SAY_EVERY_S = 10.0


@dataclass(frozen=True, slots=True, order=True)
class Key:
    """What makes a trial that one and no other."""

    cell: str  # of the grid, or the name of a recording
    method: str
    seed: int


@dataclass(frozen=True, slots=True)
class TrialRow:
    """Everything that tables and figures need of one trial. None: not known, or no such thing."""

    cell: str
    method: str
    seed: int
    kind_true: str
    travel: float  # largest true state, m or rad
    kind: str | None  # as named; None where the method failed
    kind_probability: dict[str, float] | None
    brier: float | None
    parametric: bool | None
    tracks_rejected: int | None
    errors: Errors
    consistency: Consistency
    time_s: dict[str, float]  # as the method reports it
    cpu_s: float | None  # of this process
    failure: str | None

    @property
    def key(self) -> Key:
        """Which trial this is."""
        return Key(self.cell, self.method, self.seed)

    @property
    def kind_right(self) -> bool:
        """Undecided is not right."""
        return self.kind == self.kind_true

    @property
    def confidently_wrong(self) -> bool:
        """A kind was named, and it is another."""
        return self.kind not in (None, "undecided", self.kind_true)

    def within(self, degrees_and_cm: float) -> bool:
        """The paper's ASR: kind right, axis within x degrees, axis lines within x centimetres."""
        axis, distance = self.errors.axis_error_deg, self.errors.line_distance_m
        if not self.kind_right or axis is None:
            return False
        near = self.kind_true == "prismatic" or (
            distance is not None and 100 * distance <= degrees_and_cm
        )
        return axis <= degrees_and_cm and near


def trial_row(key: Key, truth: JointTruth, answer: Answer, cpu_s: float | None) -> TrialRow:
    """Score an answer."""
    fit = answer.fits.get(truth.kind)
    probability = None if answer.kind_probability is None else dict(answer.kind_probability)
    return TrialRow(
        cell=key.cell,
        method=key.method,
        seed=key.seed,
        kind_true=truth.kind,
        travel=float(np.abs(truth.states - truth.states[0]).max()),
        kind=answer.kind,
        kind_probability=probability,
        brier=None if probability is None else brier_score(probability, truth.kind),
        parametric=answer.parametric,
        tracks_rejected=answer.tracks_rejected,
        errors=Errors() if fit is None else errors_of(fit, truth),
        consistency=Consistency() if fit is None else consistency_of(fit, truth),
        time_s=dict(answer.time_s),
        cpu_s=cpu_s,
        failure=answer.failure,
    )


def append_row(file: Path, row: TrialRow) -> None:
    """Add a row in one write, after a line that an interruption may have left unfinished."""
    append_line(file, json.dumps(_without_nan(asdict(row)), allow_nan=False))


def read_rows(folder: Path) -> list[TrialRow]:
    """The rows of all files of a folder, in the order of their keys; of twins the last.

    A line that is not JSON, as an interruption leaves it, is left out: its trial is done again.

    Raises:
        ValueError: a row with other fields, as another version wrote it.
    """
    rows: dict[Key, TrialRow] = {}
    for file in sorted(folder.glob("*.jsonl")):
        for number, data in whole_lines(file):
            row = _row_of(data, f"{file}:{number}")
            rows[row.key] = row
    return [rows[key] for key in sorted(rows)]


def fill(
    file: Path,
    wanted: Iterable[Key],
    run_batch: Callable[[Sequence[Key]], Iterable[TrialRow]],
    batch: int = 1,
) -> int:
    """Run the trials that no file of the folder has yet; returns how many were run.

    Args:
        file: gets the new rows.
        wanted: the trials.
        run_batch: gives the rows of some trials as they end.
        batch: how many trials at once.
    """
    done = {row.key for row in read_rows(file.parent)}
    missing = [key for key in wanted if key not in done]
    began = said = time.perf_counter()
    for first in range(0, len(missing), batch):
        for row in run_batch(missing[first : first + batch]):
            append_row(file, row)
        count, now = min(first + batch, len(missing)), time.perf_counter()
        if now - said > _SAY_EVERY_S or count == len(missing):
            said, left = now, (now - began) / count * (len(missing) - count)
            print(f"{file.stem}: {count} of {len(missing)}, {left:.0f} s left", file=sys.stderr)
    return len(missing)


def _row_of(data: dict[str, object], place: str) -> TrialRow:
    """A row from its JSON."""
    known = {field.name for field in fields(TrialRow)}
    if set(data) != known:
        raise ValueError(f"{place}: fields {sorted(set(data) ^ known)} differ; another version?")
    try:
        errors = Errors(**data.pop("errors"))  # type: ignore[arg-type]
        consistency = Consistency(**data.pop("consistency"))  # type: ignore[arg-type]
    except TypeError as error:
        raise ValueError(f"{place}: {error}; another version?") from error
    return TrialRow(**data, errors=errors, consistency=consistency)  # type: ignore[arg-type]


def _without_nan(value: object) -> object:
    """Unknown is null in JSON."""
    if isinstance(value, dict):
        return {key: _without_nan(entry) for key, entry in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def keys(cells: Iterable[str], methods: Iterable[str], seeds: Iterable[int]) -> Iterator[Key]:
    """All trials, the seeds of a cell one after the other."""
    seeds = list(seeds)
    methods = list(methods)
    for cell in cells:
        for method in methods:
            for seed in seeds:
                yield Key(cell, method, seed)
