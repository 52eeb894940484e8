"""Does the part get where it should be, from anywhere, and is the probability of it true?

    python -m experiments.closed_loop --suite furniture-dev --seed 3 --limit 4
    python -m experiments.closed_loop --suite furniture-116 --of 0 2
    python -m experiments.closed_loop --suite furniture-116 --methods blind --every 3

The paper's 12 tasks an object: it starts uniformly in one of four bins of 0 to 40 cm or degrees,
and its target is the same offset in another bin, so 10, 20 or 30 cm or degrees away, opening or
closing. So many of them an object are drawn by the seed. Every object is explored first, camera and
robot erring as a calibrated rig does, and its model is kept and used for all methods; where
exploration fails, its tasks are failures. While nobody looks the part is put where a task begins.
MSR_y is the share of tasks that end within y % of the commanded distance. What exploration did is
told by `python -m experiments.exploration --table --suite SUITE --out OUT/exploration`. Rows are
written as they
end, and none is run twice. Truth comes from the simulator and is used for scoring alone. About 80 s
of processor time an object, and 20 s a task.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from akm_fg.cli.exploring.explore import ExploreArguments, explore_request
from akm_fg.cli.exploring.simulated import explore_in_simulator
from akm_fg.cli.object_argument import parse_object
from akm_fg.cli.running.run import RunArguments, run_request
from akm_fg.cli.running.simulated import Ran, run_in_simulator
from akm_fg.errors import AkmError
from akm_fg.model.read import FILE
from experiments.exploration import row_of
from experiments.pages.tables import markdown, percent
from experiments.rows.json_lines import append_line, rows_of
from experiments.rows.provenance import note_run
from experiments.scores.statistics import share
from sim.objects.suites.catalogue import ALL_SUITES, find_suite

METHODS: dict[str, dict[str, object]] = {"covariance": {}, "blind": {"planner": "blind"}}
BIN = {"prismatic": 0.10, "revolute": float(np.deg2rad(10.0))}
BINS = 4
EXPLORED = "exploration"  # folder of the rows that experiments.exploration --table reads
# Of what MSR_10 allows at least: a half. m, rad.
TOLERANCE = {"prismatic": 0.005, "revolute": float(np.deg2rad(0.5))}
ERRORS = (AkmError, ArithmeticError, ValueError, RuntimeError)


@dataclass(frozen=True, slots=True)
class Task:
    """From where to where, m or rad from closed."""

    start: float
    target: float


@dataclass(frozen=True, slots=True)
class ClosedLoopRow:
    """What became of one task. None: not known, or no such thing."""

    name: str
    method: str
    seed: int
    task: int
    kind_true: str
    start: float  # asked for
    target: float
    explored: bool  # there was a model
    kind: str | None  # of the model
    claimed: bool  # P(within tolerance) reached what was asked
    probability: float
    final: float | None  # true, m or rad
    tolerance: float
    rounds: int
    looks: int
    regrasps: int
    after_round: list[float]  # true state after each move
    found: float | None  # first state believed, less the true one
    found_sd: float | None
    nees: float | None  # mean square of belief's error over its sd, of the frames tracked
    learned: str | None
    pressed_n: float
    limit_shares: dict[str, float]
    cpu_s: float
    failure: str | None

    @property
    def off(self) -> float:
        """Of the target, as a share of the commanded distance; a failure has gone nowhere."""
        final = self.start if self.final is None else self.final
        return abs(final - self.target) / abs(self.target - self.start)

    @property
    def within(self) -> bool:
        """Whether it ended within the tolerance it was asked for."""
        return self.final is not None and abs(self.final - self.target) <= self.tolerance


def tasks_of(name: str, kind: str, seed: int, count: int) -> list[Task]:
    """So many of the paper's twelve tasks, drawn by object and seed."""
    rng = np.random.default_rng([seed, *name.encode()])
    cells = [(i, j) for i in range(BINS) for j in range(BINS) if i != j]
    drawn = [cells[k] for k in rng.choice(len(cells), count, replace=False)]
    starts = [BIN[kind] * (i + rng.uniform()) for i, _ in drawn]
    return [Task(s, s + BIN[kind] * (j - i)) for s, (i, j) in zip(starts, drawn, strict=True)]


def model_of(name: str, seed: int, folder: Path) -> Path | None:
    """The folder of the object's model, explored if that was not done; None where it failed.

    Its row is kept as `experiments.exploration` has it, beside the folder.
    """
    kept = folder / name.replace("/", "-") / str(seed)
    done = kept / "done.json"
    if not done.exists():
        kept.mkdir(parents=True, exist_ok=True)
        arguments = ExploreArguments(object=name, seed=seed, rig_errors=True, out=kept)
        began = time.process_time()
        try:
            request = explore_request(arguments)
            explored = explore_in_simulator(request)
            handles = getattr(request.object.spec(seed), "handles", 1)
            row = row_of(explored, name, "full", seed, handles, began)
            rows = folder.parents[1] / EXPLORED / folder.parent.name / "rows.jsonl"
            append_line(rows, json.dumps(asdict(row)))
            told = {"model": None if explored.model is None else explored.model.parent.name}
            told["failure"] = explored.exploration.failure
        except ERRORS as error:
            told = {"model": None, "failure": f"{type(error).__name__}: {error}"}
        done.write_text(json.dumps(told) + "\n", encoding="utf-8")
    told = json.loads(done.read_text(encoding="utf-8"))
    return None if told["model"] is None else kept / told["model"]


def kept_models(folder: Path) -> list[tuple[str, int, Path]]:
    """Object, seed and model's folder of all that `experiments.closed_loop` kept there."""
    found = []
    for kept in sorted(folder.glob("*/*/done.json")):
        told = json.loads(kept.read_text(encoding="utf-8"))
        suite, sort, number = kept.parent.parent.name.rsplit("-", 2)
        if told["model"] is not None:
            name = f"{suite}/{sort}-{number}"
            found.append((name, int(kept.parent.name), kept.parent / told["model"]))
    return found


def arguments_of(
    name: str, kind: str, task: Task, seed: int, model: Path, out: Path
) -> RunArguments:
    """A task as `akm-fg run` takes it, camera and robot erring."""
    unit = "m" if kind == "prismatic" else "rad"
    target, start, tolerance = (
        f"{state!r}{unit}" for state in (task.target, task.start, TOLERANCE[kind])
    )
    return RunArguments(
        object=name, target=target, start=start, tolerance=tolerance, model=model, seed=seed,
        rig_errors=True, out=out,
    )  # fmt: skip


def run_task(
    name: str, method: str, seed: int, number: int, task: Task, model: Path | None, kind: str
) -> ClosedLoopRow:
    """One task with one method."""
    if model is None or not (model / FILE).exists():
        return _failed(name, method, seed, number, task, kind, "exploration made no model")
    with tempfile.TemporaryDirectory(prefix="akm-fg-closed-loop-") as scratch:
        arguments = arguments_of(name, kind, task, seed, model, Path(scratch))
        arguments = replace(arguments, **METHODS[method])  # type: ignore[arg-type]
        began = time.process_time()
        try:
            ran = run_in_simulator(run_request(arguments))
        except ERRORS as error:
            said = f"{type(error).__name__}: {error}"
            return _failed(name, method, seed, number, task, kind, said, explored=True)
        return _row(ran, name, method, seed, number, task, kind, time.process_time() - began)


def _row(
    ran: Ran, name: str, method: str, seed: int, number: int, task: Task, kind: str, cpu_s: float
) -> ClosedLoopRow:
    run, truth = ran.manipulation, ran.truth
    states = np.array([]) if truth is None else truth.states
    known = [
        (belief.mean - q, belief.sd)
        for belief, q in zip(run.beliefs, states, strict=False)
        if belief.mode == "tracking" and belief.mean is not None and belief.sd
    ]
    moves = [k for k, decision in enumerate(run.decisions) if decision.action in ("move", "pull")]
    after = [run.decisions[k + 1].looks for k in moves if k + 1 < len(run.decisions)]
    after_round = [float(states[n - 1]) for n in after if 0 < n <= states.size]
    if len(after_round) < run.rounds and ran.final_state is not None:
        after_round.append(ran.final_state)
    part = ran.part
    return ClosedLoopRow(
        name=name,
        method=method,
        seed=seed,
        task=number,
        kind_true=kind,
        start=task.start,
        target=task.target,
        explored=True,
        kind=None if part is None else str(part.posterior.kind),
        claimed=ran.reached,
        probability=run.probability,
        final=ran.final_state,
        tolerance=TOLERANCE[kind],
        rounds=run.rounds,
        looks=run.clear_looks,
        regrasps=run.regrasps,
        after_round=after_round,
        found=known[0][0] if known else None,
        found_sd=known[0][1] if known else None,
        nees=float(np.mean([(e / sd) ** 2 for e, sd in known])) if known else None,
        learned=ran.learned,
        pressed_n=ran.pressed_n,
        limit_shares=ran.limit_shares,
        cpu_s=cpu_s,
        failure=ran.failure,
    )


def _failed(
    name: str,
    method: str,
    seed: int,
    number: int,
    task: Task,
    kind: str,
    why: str,
    explored: bool = False,
) -> ClosedLoopRow:
    """A task that ended before anything moved."""
    return ClosedLoopRow(
        name, method, seed, number, kind, task.start, task.target, explored, None, False, 0.0, None,
        TOLERANCE[kind], 0, 0, 0, [], None, None, None, None, 0.0, {}, 0.0, why,
    )  # fmt: skip


def read_rows(folder: Path) -> list[ClosedLoopRow]:
    """The rows of all files of a folder; a line that an interruption cut is left out."""
    return rows_of(ClosedLoopRow, *sorted(folder.glob("*.jsonl")))


def table(rows: Sequence[ClosedLoopRow]) -> str:
    """One line a method and kind."""
    lines = []
    for method in METHODS:
        for kind in ("prismatic", "revolute", "all"):
            of = [r for r in rows if r.method == method and kind in (r.kind_true, "all")]
            if not of:
                continue
            done = [r for r in of if r.final is not None]
            sure = [r for r in of if r.claimed]
            off = [abs(r.final - r.target) for r in done if r.final is not None]
            unit = 1e3 if kind == "prismatic" else 180 / np.pi
            median = "" if kind == "all" or not off else f"{unit * np.median(off):.2f}"
            nees = [r.nees for r in done if r.nees is not None]
            lines.append(
                [
                    method,
                    kind,
                    str(len(of)),
                    percent(share([r.explored for r in of])),
                    *(percent(share([r.off <= y for r in of])) for y in (0.1, 0.2, 0.5)),
                    median,
                    percent(share([r.within for r in sure])) if sure else "",
                    percent(share([r.claimed for r in of])),
                    f"{np.mean([r.rounds for r in done]):.1f}" if done else "",
                    f"{np.mean([r.looks for r in done]):.1f}" if done else "",
                    f"{np.mean([r.regrasps for r in done]):.1f}" if done else "",
                    f"{np.median(nees):.1f}" if nees else "",
                    f"{np.median([r.cpu_s for r in done]):.0f}" if done else "",
                ]
            )
    header = ["method", "kind", "tasks", "modelled %", "MSR_10 %", "MSR_20 %", "MSR_50 %"]
    header += ["median error mm or deg", "of claimed within %", "claimed %", "moves", "looks"]
    header += ["regrasps", "NEES", "CPU s"]
    return markdown(header, lines)


def by_rounds(rows: Sequence[ClosedLoopRow]) -> str:
    """MSR_10 after so many moves, the paper's Table IV."""
    lines = []
    for method in [m for m in METHODS if any(r.method == m for r in rows)]:
        of = [r for r in rows if r.method == method]
        cells = []
        for n in range(1, 6):
            states = [r.after_round[:n][-1] if r.after_round[:n] else r.start for r in of]
            near = [
                abs(q - r.target) <= 0.1 * abs(r.target - r.start)
                for q, r in zip(states, of, strict=True)
            ]
            cells.append(f"{100 * np.mean(near):.0f}")
        lines.append([method, *cells])
    return markdown(["MSR_10 % after at most", *(f"{n} moves" for n in range(1, 6))], lines)


def reliability(rows: Sequence[ClosedLoopRow]) -> str:
    """How often a task ended within tolerance, by the probability that was given."""
    edges, lines = (0.0, 0.05, 0.5, 0.95, 0.99, 1.0 + 1e-9), []
    done = [r for r in rows if r.final is not None]
    for low, high in itertools.pairwise(edges):
        of = [r for r in done if low <= r.probability < high]
        if of:
            told = f"{np.mean([r.probability for r in of]):.3f}"
            lines.append([f"{low:g} to {min(high, 1):g}", str(len(of)), told,
                          percent(share([r.within for r in of]))])  # fmt: skip
    return markdown(["P given", "tasks", "mean P", "within tolerance %"], lines)


def failures(rows: Sequence[ClosedLoopRow]) -> str:
    """Every task that is not within a tenth, or was claimed and is not within tolerance."""
    lines = []
    for row in rows:
        if row.off <= 0.1 and (row.within or not row.claimed):
            continue
        unit = 100.0 if row.kind_true == "prismatic" else 180 / np.pi
        final = "-" if row.final is None else f"{unit * row.final:.1f}"
        lines.append(
            [
                row.name,
                row.method,
                f"{unit * row.start:.1f} to {unit * row.target:.1f}",
                final,
                f"{row.probability:.2f}",
                str(row.failure or "claimed"),
            ]
        )
    return markdown(["object", "method", "task, cm or deg", "ended", "P", "reason"], lines)


def main() -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--suite", default="furniture-dev", choices=sorted(ALL_SUITES))
    parser.add_argument("--methods", nargs="+", default=["covariance"], choices=sorted(METHODS))
    parser.add_argument("--tasks", type=int, default=2, help="of an object, of the twelve")
    parser.add_argument("--every", type=int, default=1, help="every how manieth object")
    parser.add_argument("--objects", nargs="+", help="names in the suite; all if absent")
    parser.add_argument("--of", type=int, nargs=2, default=(0, 1), metavar=("K", "N"))
    parser.add_argument("--seed", type=int, default=10_001)
    parser.add_argument("--limit", type=int, help="stop after so many new objects")
    parser.add_argument("--table", action="store_true", help="print the tables alone")
    parser.add_argument("--out", type=Path, default=Path("runs/closed-loop"))
    arguments = parser.parse_args()
    folder = arguments.out / arguments.suite
    if not arguments.table:
        note_run(folder)
        _run_missing(arguments, folder)
    rows = read_rows(folder)
    if rows:
        print(table(rows), by_rounds(rows), reliability(rows), failures(rows), sep="\n\n")


def _run_missing(arguments: argparse.Namespace, folder: Path) -> None:
    part, parts = arguments.of
    file = folder / f"rows-{part}-of-{parts}.jsonl"
    done = {(row.name, row.method, row.seed, row.task) for row in read_rows(folder)}
    names = arguments.objects or find_suite(arguments.suite).names()
    # Drawers and doors by turns, so that what is done so far is of both.
    order = sorted(names[:: arguments.every], key=lambda name: (name[-3:], name))[part::parts]
    objects = 0
    for short in order:
        name = f"{arguments.suite}/{short}"
        kind = str(parse_object(name).spec(arguments.seed).kind)
        tasks = tasks_of(name, kind, arguments.seed, arguments.tasks)
        missing = [
            (method, k)
            for method in arguments.methods
            for k in range(len(tasks))
            if (name, method, arguments.seed, k) not in done
        ]
        if not missing:
            continue
        if arguments.limit is not None and objects >= arguments.limit:
            break
        objects += 1
        model = model_of(name, arguments.seed, folder / "models")
        for method, k in missing:
            row = run_task(name, method, arguments.seed, k, tasks[k], model, kind)
            append_line(file, json.dumps(asdict(row)))
            said = f"off by {100 * row.off:.0f} %, P {row.probability:.2f}, {row.rounds} moves"
            print(f"{name} {method} {k}: {said} {row.failure or ''}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
