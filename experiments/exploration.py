"""Does exploration find where an unseen object opens, in few pulls, and know when to stop?

    python -m experiments.exploration --suite furniture-dev --settings full
    python -m experiments.exploration --suite furniture-116 --settings full locked --every 3

Every object once, the robot and its camera erring as a calibrated rig does, with the full system
or with one of the paper's ablations (`without-at`, `without-fs`, `without-ca`, `zero-shot`), with
the paper's belief and stop (`paper`), with the paper's stop alone (`threshold`), or with every
joint locked (`locked`). One row an object and setting is written as it ends, none is run twice. A
failed exploration counts in every share but those "of the explored". Truth comes from the
simulator and is used for scoring alone. About 60 s of processor time an object. Feeds
docs/experiments.md.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from akm_fg.cli.exploring.explore import ExploreArguments, explore_request
from akm_fg.cli.exploring.kept import Explored
from akm_fg.cli.exploring.outcome import solved_frames
from akm_fg.cli.exploring.simulated import explore_in_simulator
from akm_fg.cli.object_argument import parse_object
from akm_fg.errors import AkmError
from akm_fg.exploration.records import Stretch
from experiments.pages.tables import markdown, percent
from experiments.rows.json_lines import append_line, rows_of
from experiments.rows.provenance import note_run
from experiments.scores.answers import answer_of_posterior
from experiments.scores.scoring import axis_off, consistency_of, within
from experiments.scores.statistics import share
from sim.objects.suites.catalogue import ALL_SUITES, find_suite

SETTINGS: dict[str, dict[str, object]] = {
    "full": {},
    "threshold": {"stop": "threshold"},
    "paper": {"stop": "threshold", "belief": "suppression"},
    "without-at": {"without_at": True},
    "without-fs": {"without_fs": True},
    "without-ca": {"without_ca": True},
    "zero-shot": {"zero_shot": True},
    "locked": {"locked": True},
}
MOVED = {"prismatic": 0.05, "revolute": float(np.deg2rad(5.0))}  # the paper's ESR_5


@dataclass(frozen=True, slots=True)
class ExplorationRow:
    """What became of one object under one setting. None: not known, or no such thing."""

    name: str
    setting: str
    seed: int
    kind_true: str
    handles: int  # places that look as if they opened
    claimed: bool  # opened, by the program's own belief
    moved: bool  # the true joint went more than 5 cm or 5 deg
    pulls: int
    refused: int
    kind: str | None
    axis_error_deg: float | None
    line_distance_m: float | None  # between axis lines; None of what slides
    axis_bound_deg: float | None
    joint_inside95: bool | None
    travel_m: float | None  # of the last attempt's hand
    stretches: list[dict[str, object]]  # of the last attempt
    reason: str | None  # of the last attempt, or why nothing was opened
    outcomes: list[str]
    pressed_n: float
    limit_shares: dict[str, float]
    solve_s: float | None  # largest of a stretch, processor time
    cpu_s: float
    failure: str | None  # of the run itself

    def within(self, degrees_and_cm: float) -> bool:
        """The paper's ASR_x; a failed exploration is not within."""
        right = self.moved and self.kind == self.kind_true
        return right and within(self.axis_error_deg, self.line_distance_m, degrees_and_cm)


def run_trial(name: str, setting: str, seed: int, folder: Path) -> ExplorationRow:
    """Explore one object."""
    began = time.process_time()
    arguments = ExploreArguments(
        object=name,
        seed=seed,
        rig_errors=True,
        out=folder,
        **SETTINGS[setting],  # type: ignore[arg-type]
    )
    request = explore_request(arguments)
    explored = explore_in_simulator(request)
    spec = request.object.spec(seed)
    return row_of(explored, name, setting, seed, getattr(spec, "handles", 1), began)


def row_of(
    explored: Explored, name: str, setting: str, seed: int, handles: int, began: float
) -> ExplorationRow:
    """The row of an exploration that began at this processor time."""
    exploration, truth, measured = explored.exploration, explored.truth, explored.measured
    assert measured is not None and truth is not None
    attempts = exploration.attempts
    last = attempts[-1] if attempts else None
    posterior = None if exploration.fit is None else exploration.fit.posterior
    axis, distance, bound, inside = None, None, None, None
    if posterior is not None and posterior.best.joint is not None:
        joint = posterior.best.joint
        axis, distance = axis_off(joint.axis, joint.pivot, truth)
        bound = float(np.rad2deg(joint.axis_bound_rad()))
        solved = solved_frames(exploration.fit)
        truth = truth if solved is None else replace(truth, states=truth.states[:solved])
        fit = answer_of_posterior(posterior).fits.get(truth.kind)
        inside = None if fit is None else consistency_of(fit, truth).joint_inside95
    stretches = [] if last is None else [_stretch(each) for each in last.stretches]
    solves = [s.solve_s for attempt in attempts for s in attempt.stretches]
    return ExplorationRow(
        name=name,
        setting=setting,
        seed=seed,
        kind_true=truth.kind,
        handles=handles,
        claimed=exploration.opened,
        moved=measured.largest_state > MOVED[truth.kind],
        pulls=exploration.pulls,
        refused=sum(attempt.outcome == "refused" for attempt in attempts),
        kind=None if posterior is None else str(posterior.kind),
        axis_error_deg=axis,
        line_distance_m=distance,
        axis_bound_deg=bound,
        joint_inside95=inside,
        travel_m=last.stretches[-1].travel_m if last is not None and last.stretches else None,
        stretches=stretches,
        reason=exploration.failure or (None if last is None else last.reason),
        outcomes=[attempt.outcome for attempt in attempts],
        pressed_n=measured.pressed_n,
        limit_shares=measured.limit_shares,
        solve_s=max(solves, default=None),
        cpu_s=time.process_time() - began,
        failure=None,
    )


def _stretch(stretch: Stretch) -> dict[str, object]:
    """What the curve of error and claim along the pull needs."""
    now, then = stretch.bounds, stretch.expected_next
    return {
        "travel_m": stretch.travel_m,
        "kind_probability": max(stretch.kind_probability.values(), default=None),
        "axis_bound_deg": None if now is None else float(np.rad2deg(now.axis_rad)),
        "pivot_bound_m": None if now is None else now.pivot_m,
        "expected_axis_deg": None if then is None else float(np.rad2deg(then.axis_rad)),
        "expected_pivot_m": None if then is None else then.pivot_m,
    }


def failed_row(name: str, setting: str, seed: int, error: Exception) -> ExplorationRow:
    """A run that ended with an error: it counts as one that opened nothing."""
    spec = parse_object(name).spec(seed)
    return ExplorationRow(
        name, setting, seed, spec.kind, getattr(spec, "handles", 1), False, False, 0, 0, None,
        None, None, None, None, None, [], None, [], 0.0, {}, None, 0.0,
        f"{type(error).__name__}: {error}",
    )  # fmt: skip


def read_rows(folder: Path) -> list[ExplorationRow]:
    """The rows of all files of a folder; a line that an interruption cut is left out."""
    return rows_of(ExplorationRow, *sorted(folder.glob("*.jsonl")))


def table(rows: Sequence[ExplorationRow]) -> str:
    """One line a setting."""
    lines = []
    for setting in [s for s in SETTINGS if any(row.setting == s for row in rows)]:
        of = [row for row in rows if row.setting == setting]
        found = [row for row in of if row.moved]
        inside = [row.joint_inside95 for row in found if row.joint_inside95 is not None]
        known_best = np.mean([(row.handles + 1) / 2 for row in of])
        travel = [row.travel_m for row in found if row.travel_m is not None]
        lines.append(
            [
                setting,
                str(len(of)),
                percent(share([row.moved for row in of])),
                percent(share([row.claimed for row in of])),
                f"{np.mean([row.pulls for row in of]):.1f} / {known_best:.1f}",
                percent(share([row.kind == row.kind_true for row in found])) if found else "",
                percent(share([row.within(1.0) for row in of])),
                percent(share([row.within(10.0) for row in of])),
                percent(share([bool(x) for x in inside])) if inside else "",
                f"{100 * np.median(travel):.1f}" if travel else "",
                f"{max(row.pressed_n for row in of):.0f}",
                f"{max(max(row.limit_shares.values(), default=0.0) for row in of):.2f}",
                f"{np.median([row.solve_s for row in of if row.solve_s is not None] or [0]):.1f}",
                f"{np.median([row.cpu_s for row in of]):.0f}",
            ]
        )
    header = ["setting", "objects", "ESR_5 %", "ESR_5* %", "pulls / knows handles"]
    header += ["kind % of explored", "ASR_1 %", "ASR_10 %", "joint inside 95 %", "hand's way cm"]
    header += ["other links N", "limits used", "solve s", "CPU s"]
    return markdown(header, lines)


def failures(rows: Sequence[ExplorationRow]) -> str:
    """Every object that was not opened or is not within 1 deg and 1 cm, with the cause."""
    lines = []
    for row in rows:
        if row.setting == "locked" and not row.claimed:
            continue
        if row.moved and row.within(1.0):
            continue
        off = "" if row.axis_error_deg is None else f"{row.axis_error_deg:.1f} deg"
        if row.line_distance_m is not None:
            off += f", {100 * row.line_distance_m:.1f} cm"
        lines.append(
            [
                row.name,
                row.setting,
                "yes" if row.moved else "no",
                str(row.kind),
                off,
                ", ".join(row.outcomes[:8]),
                str(row.failure or row.reason),
            ]
        )
    return markdown(["object", "setting", "moved", "kind", "error", "tries", "reason"], lines)


def curve(rows: Sequence[ExplorationRow]) -> str:
    """Success against attempts, the paper's Figure 4."""
    lines = []
    for setting in [s for s in SETTINGS if any(row.setting == s for row in rows)]:
        of = [row for row in rows if row.setting == setting]
        done = [np.mean([row.moved and row.pulls <= n for row in of]) for n in CURVE]
        lines.append([setting, *(f"{100 * share_:.0f}" for share_ in done)])
    return markdown(["opened after at most", *(f"{n} pulls" for n in CURVE)], lines)


SORTS = ("drawer", "slide", "door", "thing")  # how objects are named
CURVE = (1, 2, 3, 4, 5, 8, 12, 25)


def main() -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--suite", default="furniture-dev", choices=sorted(ALL_SUITES))
    parser.add_argument("--settings", nargs="+", default=["full"], choices=sorted(SETTINGS))
    parser.add_argument("--every", type=int, default=1, help="every how manieth of each sort")
    parser.add_argument("--sorts", nargs="+", default=SORTS, choices=SORTS)
    parser.add_argument("--of", type=int, nargs=2, default=(0, 1), metavar=("K", "N"))
    parser.add_argument("--seed", type=int, default=10_001)
    parser.add_argument("--limit", type=int, help="stop after so many new trials")
    parser.add_argument("--table", action="store_true", help="print the tables alone")
    parser.add_argument("--out", type=Path, default=Path("runs/exploration"))
    arguments = parser.parse_args()
    folder = arguments.out / arguments.suite
    if not arguments.table:
        note_run(folder)
        _run_missing(arguments, folder)
    rows = read_rows(folder)
    if rows:
        print(table(rows), curve(rows), failures(rows), sep="\n\n")


def _run_missing(arguments: argparse.Namespace, folder: Path) -> None:
    part, parts = arguments.of
    file = folder / f"rows-{part}-of-{parts}.jsonl"
    done = {(row.name, row.setting, row.seed) for row in read_rows(folder)}
    names = find_suite(arguments.suite).names()
    by_sort = [[n for n in names if n.startswith(sort)] for sort in arguments.sorts]
    of_each = [name for some in by_sort for name in some[:: arguments.every]]
    order = sorted(of_each, key=lambda name: name[-3:])  # drawers and doors by turns
    chosen = [f"{arguments.suite}/{name}" for name in order[part::parts]]
    wanted = [(name, s) for s in arguments.settings for name in chosen]
    missing = [key for key in wanted if (*key, arguments.seed) not in done]
    for k, (name, setting) in enumerate(missing[: arguments.limit], 1):
        with tempfile.TemporaryDirectory(prefix="akm-fg-exploration-") as scratch:
            try:
                row = run_trial(name, setting, arguments.seed, Path(scratch))
            except (AkmError, ArithmeticError, ValueError, RuntimeError) as error:
                row = failed_row(name, setting, arguments.seed, error)
        append_line(file, json.dumps(asdict(row)))
        said = f"moved {row.moved}, claimed {row.claimed}, {row.pulls} pulls, {row.kind}"
        print(f"{k} of {len(missing)}: {name} {setting}: {said}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
