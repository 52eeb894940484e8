"""What if something goes wrong while a part is moved: is it noticed, cured, or ended with a reason?

    python -m experiments.faults --models runs/closed-loop/furniture-dev/models --faults 18
    python -m experiments.faults --models runs/closed-loop/furniture-116/models --of 0 2

With the models that `experiments.closed_loop` has kept, tasks of the paper's kind are run while one
thing goes wrong (`experiments.trials.mishaps`). A fault is unnoticed where the run claims to be
within tolerance and is not; each such task is run again without the fault, which tells whether it
was to blame. A move is blind where it begins while the state believed is 2 cm or 2 deg off. With
a model of the wrong kind, or another object's, the target is in that model's unit, and half of the
parts begin closed, where such a model may be believed; a claim is right where the handle is within
2 cm of where the model has it at the target. Nothing is learned for the model. Rows are written as
they end, and none is run twice. Truth comes from the simulator and is used for scoring alone. About
20 s of processor time each.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.cli.object_argument import parse_object
from akm_fg.cli.running.run import run_request
from akm_fg.cli.running.simulated import Ran, run_in_simulator
from akm_fg.interfaces import Camera
from akm_fg.model.read import read_model
from akm_fg.model.records import ModelPart
from akm_fg.records import JointTruth
from experiments.closed_loop import (
    BIN,
    BINS,
    ERRORS,
    TOLERANCE,
    Task,
    arguments_of,
    kept_models,
    tasks_of,
)
from experiments.pages.tables import markdown, percent
from experiments.rows.json_lines import append_line, rows_of
from experiments.rows.provenance import note_run
from experiments.scores.statistics import share
from experiments.trials.mishaps import (
    IN_THE_MODEL,
    MISHAPS,
    NOTHING,
    OTHERS,
    Mishap,
    Way,
    handed_in,
)
from sim.episode import SimEpisode

OFF = {"prismatic": 0.02, "revolute": float(np.deg2rad(2.0))}  # of a state that is not known
HANDLE_OFF_M = 0.02
PRESSED_N = 20.0


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One fault in one run. None: not known, or no such thing."""

    name: str
    fault: str
    number: int
    happened: bool  # the run came as far
    start: float  # asked for, m or rad
    target: float  # in the unit of the model that was handed in
    claimed: bool
    within: bool  # truly where it should be
    final: float | None  # true state
    failure: str | None
    probability: float
    rounds: int
    looks: int
    regrasps: int
    blind: int  # moves that began with a state believed that was not so
    pressed_n: float
    limit_share: float  # largest, of the arm's limits
    cpu_s: float
    without: bool | None = None  # of what went unnoticed: within, or not claimed, without the fault

    @property
    def unnoticed(self) -> bool:
        """It claimed what is not so."""
        return self.claimed and not self.within


def run_fault(
    name: str, fault: str, number: int, seed: int, model: Path, other: Path | None = None
) -> FaultRow:
    """One run with one fault.

    Raises:
        ValueError: there is no such fault, or the models do not suffice for it.
    """
    kind = str(parse_object(name).spec(seed).kind)
    rng = np.random.default_rng([seed, number, *fault.encode(), *name.encode()])
    task = tasks_of(name, kind, seed + number, 1)[0]
    if fault in IN_THE_MODEL and number % 2:
        task = _from_closed(task)
    way = Way(task.start, task.target, BINS * BIN[kind])
    seen: list[Mishap] = []

    def through(world: SimEpisode) -> Camera:
        seen.append(Mishap(world, fault, way, rng))
        return seen[0]

    began = time.process_time()
    ran: Ran | None = None
    with tempfile.TemporaryDirectory(prefix="akm-fg-faults-") as scratch:
        given = handed_in(fault, model, other, way, Path(scratch) / "model")
        told = str(read_model(given).parts[0].joint.kind)
        target = task.target
        if told != kind:
            as_told = tasks_of(name, told, seed + number, 1)[0]
            target = (_from_closed(as_told) if number % 2 else as_told).target
        arguments = arguments_of(name, told, Task(0.0, target), seed, given, Path(scratch))
        try:
            request = replace(run_request(arguments), start=task.start, learn=False)
            ran = run_in_simulator(request, through)
            failure = ran.failure
        except ERRORS as error:
            failure = f"{type(error).__name__}: {error}"
    happened = bool(seen and seen[0].happened)
    wanted = Task(task.start, target)
    return _row(name, fault, number, happened, wanted, ran, failure, time.process_time() - began)


def _from_closed(task: Task) -> Task:
    """As far, of a part that is closed."""
    return Task(0.0, abs(task.target - task.start))


def _row(
    name: str, fault: str, number: int, happened: bool, task: Task, ran: Ran | None,
    failure: str | None, cpu_s: float,
) -> FaultRow:  # fmt: skip
    run = None if ran is None else ran.manipulation
    return FaultRow(
        name=name,
        fault=fault,
        number=number,
        happened=happened,
        start=task.start,
        target=task.target,
        claimed=bool(ran and ran.reached),
        within=ran is not None and _within(ran, task.target),
        final=None if ran is None else ran.final_state,
        failure=failure,
        probability=0.0 if run is None else run.probability,
        rounds=0 if run is None else run.rounds,
        looks=0 if run is None else run.clear_looks,
        regrasps=0 if run is None else run.regrasps,
        blind=0 if ran is None else _blind(ran),
        pressed_n=0.0 if ran is None else ran.pressed_n,
        limit_share=0.0 if ran is None else max(ran.limit_shares.values(), default=0.0),
        cpu_s=cpu_s,
    )


def _within(ran: Ran, target: float) -> bool:
    """Whether the part is truly where the run was to take it."""
    part, truth, final = ran.part, ran.truth, ran.final_state
    if part is None or truth is None or final is None or ran.goal is None:
        return False
    if str(part.joint.kind) == truth.kind:
        return abs(final - target) <= TOLERANCE[truth.kind]
    return _handle_off_m(part, truth, ran.goal.state, final) <= HANDLE_OFF_M


def _blind(ran: Ran) -> int:
    """How many moves began with a state believed that was not so."""
    part, truth, run = ran.part, ran.truth, ran.manipulation
    if part is None or truth is None:
        return 0
    count = 0
    for decision in run.decisions:
        if decision.action not in ("move", "pull", "push") or decision.state is None:
            continue
        true = float(truth.states[decision.looks - 1])
        if str(part.joint.kind) == truth.kind:
            off = abs(abs(decision.state - part.closed_state) - true) > OFF[truth.kind]
        else:
            off = _handle_off_m(part, truth, decision.state, true) > HANDLE_OFF_M
        count += off
    return count


def _handle_off_m(part: ModelPart, truth: JointTruth, q: float, true: float) -> float:
    """Between the handle where a model has it at a state, and where it truly is."""
    closed = part.contacts[0].T_part_grasp.translation()
    there = part.T_world_part(q).transformFrom(closed)
    if truth.pivot is None:
        return float(np.linalg.norm(there - closed - true * truth.axis))
    turn = gtsam.Rot3.AxisAngle(truth.axis, true).matrix()
    return float(np.linalg.norm(there - truth.pivot - turn @ (closed - truth.pivot)))


def table(rows: Sequence[FaultRow]) -> str:
    """One line a fault."""
    lines = []
    for fault in (*MISHAPS, "all"):
        of = [row for row in rows if fault in (row.fault, "all") and row.happened]
        if of:
            lines.append(
                [
                    fault,
                    str(len(of)),
                    percent(share([row.claimed and row.within for row in of])),
                    percent(share([not row.claimed for row in of])),
                    percent(share([row.unnoticed for row in of])),
                    str(sum(row.unnoticed and row.without is False for row in of)),
                    str(sum(row.blind for row in of)),
                    f"{np.mean([row.rounds for row in of]):.1f}",
                    str(sum(row.pressed_n > PRESSED_N for row in of)),
                    f"{np.median([row.limit_share for row in of]):.2f}",
                    f"{max(row.limit_share for row in of):.1f}",
                    f"{np.median([row.cpu_s for row in of]):.0f}",
                ]
            )
    header = ["what went wrong", "runs", "reached all the same %", "ended with a reason %"]
    header += ["unnoticed %", "of them beyond tolerance without the fault too", "blind moves"]
    header += ["moves", f"pressed with more than {PRESSED_N:g} N", "limits used, median", "largest"]
    return markdown([*header, "CPU s"], lines)


def reasons(rows: Sequence[FaultRow]) -> str:
    """How often each reason ended a run, by what had gone wrong; numbers in them left out."""
    counts = Counter(
        (row.fault, re.sub(r"[\d.]+", "#", row.failure or ""))
        for row in rows
        if row.happened and not row.claimed
    )
    order = sorted(counts, key=lambda key: (MISHAPS.index(key[0]), -counts[key]))
    lines = [[fault, why, str(counts[fault, why])] for fault, why in order]
    return markdown(["what went wrong", "ended with", "runs"], lines)


def main() -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=Path, required=True, help="folder of closed_loop's models")
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--of", type=int, nargs=2, default=(0, 1), metavar=("I", "N"),
                        help="share I of N, from 0, for several processes")  # fmt: skip
    parser.add_argument("--table", action="store_true", help="print the tables alone")
    arguments = parser.parse_args()
    folder = arguments.models.parent
    if not arguments.table:
        models = kept_models(arguments.models)
        if not models:
            told = f"{arguments.models} has no models: run experiments.closed_loop"
            raise SystemExit(f"faults: {told}")
        note_run(folder)
        _run_missing(arguments, folder, models)
    rows = [row for row in _rows(folder) if row.fault in MISHAPS and row.number < arguments.faults]
    if rows:
        print(table(rows), reasons(rows), sep="\n\n")
        for row in rows:
            if row.unnoticed:
                print(f"unnoticed: {row.name}, {row.fault} {row.number}: P {row.probability:.3f}")


def _rows(folder: Path) -> list[FaultRow]:
    return rows_of(FaultRow, *sorted(folder.glob("faults-*.jsonl")))


def _run_missing(
    arguments: argparse.Namespace, folder: Path, models: Sequence[tuple[str, int, Path]]
) -> None:
    done = {row.number for row in _rows(folder)}
    kinds = [str(read_model(model).parts[0].joint.kind) for _, _, model in models]
    part, parts = arguments.of
    for number in range(part, arguments.faults, parts):
        if number in done:
            continue
        fault, at = MISHAPS[number % len(MISHAPS)], _model_of(number, len(models))
        (name, seed, model), other = models[at], None
        if fault == OTHERS:
            alike = [m for (n, _, m), k in zip(models, kinds, strict=True)
                     if n != name and k == kinds[at]]  # fmt: skip
            other = alike[number % len(alike)] if alike else None
        try:
            row = run_fault(name, fault, number, seed, model, other)
        except ValueError as error:  # no such fault can be made of this model
            print(f"{number}: {name}, {fault}: {error}", file=sys.stderr, flush=True)
            continue
        if row.unnoticed and fault not in IN_THE_MODEL:
            again = run_fault(name, NOTHING, number, seed, model)
            row = replace(row, without=again.within or not again.claimed)
        append_line(folder / f"faults-{part}-of-{parts}.jsonl", json.dumps(asdict(row)))
        said = "UNNOTICED" if row.unnoticed else row.failure or "reached"
        happened = "" if row.happened else " (did not happen)"
        print(f"{number}: {name}, {fault}{happened}: {said}; blind {row.blind}, {row.cpu_s:.0f} s",
              file=sys.stderr, flush=True)  # fmt: skip


def _model_of(number: int, models: int) -> int:
    """Which model a fault is tried on: all before any comes again, in an order drawn once."""
    again, at = divmod(number, models)
    return int(np.random.default_rng(again).permutation(models)[at])


if __name__ == "__main__":
    main()
