r"""How wrong is a joint along a pull, how wrong does it say it may be, and where do rules stop?

    python -m experiments.along_the_pull --models runs/closed-loop/furniture-116/models \
        --exploration runs/exploration/furniture-116 --figure runs/along-the-pull.png

The recording of every exploration that `experiments.closed_loop` kept and that opened something is
solved again as far as each stretch of its pull went. Error and 95 % bound of axis and axis line,
against the recording's truth, beside the way of the hand: what another stretch would have bettered,
and whether the bound knew. Rows of `experiments.exploration` tell where the paper's stop (a
threshold) ended on the same objects. One row a stretch is written as its recording ends, none is
done twice. About 8 s of processor time a recording. Feeds docs/experiments.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from akm_fg.cli.exploring.explore import simulated_default
from akm_fg.errors import AkmError
from akm_fg.io.recording_reader import read_recording, read_truth
from akm_fg.stream.frame_stream import FrameStream
from akm_fg.stream.seen_so_far import hands_of
from experiments.closed_loop import kept_models
from experiments.exploration import ExplorationRow
from experiments.exploration import read_rows as exploration_rows
from experiments.pages.figures import COLOURS, log_ticks, new_figure, save
from experiments.pages.tables import markdown, percent
from experiments.rows.json_lines import append_line, rows_of
from experiments.rows.provenance import note_run
from experiments.scores.scoring import axis_off, within
from experiments.scores.statistics import share

STRETCH_M = 0.03  # of the hand's way: bins are as wide, and a stretch ends in the middle of one
BINS = 8
FEWEST = 5  # stretches of a bin from which on a median of it is drawn


@dataclass(frozen=True, slots=True)
class PullRow:
    """What one stretch told. None: nothing was named, or no such thing."""

    name: str
    seed: int
    stretch: int
    last: bool  # the exploration stopped here
    travel_m: float  # of the hand
    kind_true: str
    kind: str
    axis_error_deg: float | None
    axis_bound_deg: float | None
    line_distance_m: float | None
    line_bound_m: float | None

    @property
    def within(self) -> bool:
        """The paper's ASR_1."""
        right = self.kind == self.kind_true
        return right and within(self.axis_error_deg, self.line_distance_m, 1.0)


def run_recording(name: str, seed: int, folder: Path) -> list[PullRow]:
    """All stretches of the attempt that opened something; none where no attempt did."""
    told = json.loads((folder / "explore.json").read_text(encoding="utf-8"))
    opened = [a for a in told["attempts"] if a["outcome"] == "opened" and a["recording"]]
    if not opened:
        return []
    kept = folder / Path(opened[-1]["recording"]).name
    recording, truth = read_recording(kept), read_truth(kept)
    if truth is None:
        return []
    rows = []
    stream = FrameStream(
        name, simulated_default().model_settings, calibration=recording.calibration
    )
    seen = list(zip(recording.frames, hands_of(recording), strict=True))
    stretches, done = opened[-1]["stretches"], 0
    for k, stretch in enumerate(stretches):
        for frame, hand in seen[done : stretch["frames"]]:
            stream.add(frame, hand)
        done = stretch["frames"]
        posterior = stream.posterior().posterior
        joint = posterior.best.joint
        error, bound, distance, line_bound = None, None, None, None
        if joint is not None:
            error, distance = axis_off(joint.axis, joint.pivot, truth)
            bound = float(np.rad2deg(joint.axis_bound_rad()))
            if distance is not None:
                line_bound = joint.pivot_bound_m()
        rows.append(
            PullRow(
                name, seed, k, k + 1 == len(stretches), stretch["travel_m"], truth.kind,
                str(posterior.kind), error, bound, distance, line_bound,
            )
        )  # fmt: skip
    return rows


def table(rows: Sequence[PullRow]) -> str:
    """Medians by the way of the hand, of stretches whose kind is right."""
    lines = []
    for low, high in _bins():
        of = [row for row in rows if low <= row.travel_m < high]
        if len(of) < FEWEST:
            continue
        right = [row for row in of if row.kind == row.kind_true]
        lines.append(
            [
                f"{100 * low:.1f} to {100 * high:.1f}",
                str(len(of)),
                percent(share([row.kind == row.kind_true for row in of])),
                _median([row.axis_error_deg for row in right]),
                _median([row.axis_bound_deg for row in right]),
                _median([row.line_distance_m for row in right], 100.0),
                _median([row.line_bound_m for row in right], 100.0),
                percent(share([row.within for row in of])),
            ]
        )
    header = ["hand's way cm", "stretches", "kind right %", "axis off deg", "95 % bound deg"]
    header += ["line off cm", "95 % bound cm", "within 1 deg, 1 cm %"]
    return markdown(header, lines)


def stops(explored: Sequence[ExplorationRow]) -> str:
    """Where each rule stopped, and what it had then, on the objects that both opened."""
    lines = []
    of = {s: {r.name: r for r in explored if r.setting == s and _opened(r)} for s in RULES}
    both = set.intersection(*(set(some) for some in of.values()))
    if not both:
        return "no object was opened by both stops"
    for setting, rule in RULES.items():
        some = [of[setting][name] for name in sorted(both)]
        lines.append(
            [
                rule,
                str(len(some)),
                _median([row.travel_m for row in some], 100.0),
                _median([row.axis_error_deg for row in some]),
                _median([row.line_distance_m for row in some], 100.0),
                percent(share([row.kind == row.kind_true for row in some])),
                percent(share([row.within(1.0) for row in some])),
            ]
        )
    header = ["stop", "objects", "hand's way cm", "axis off deg", "line off cm", "kind right %"]
    return markdown([*header, "ASR_1 %"], lines)


def _opened(row: ExplorationRow) -> bool:
    return row.moved and row.claimed and row.travel_m is not None


RULES = {"full": "posterior", "threshold": "threshold (the paper's)"}


def figure(rows: Sequence[PullRow], file: Path) -> None:
    """Errors and bounds against the way of the hand, and where the explorations stopped."""
    drawn, (left, right) = new_figure(2, 3.6)
    named = [row for row in rows if row.kind == row.kind_true]
    axis = [(r, r.axis_error_deg, r.axis_bound_deg) for r in named]
    line = [
        (r, 100.0 * r.line_distance_m, 100.0 * r.line_bound_m)
        for r in named
        if r.line_distance_m is not None and r.line_bound_m is not None
    ]
    _draw(left, axis, "axis, deg")
    _draw(right, line, "axis line of what turns, cm")
    drawn.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    save(drawn, file)


def _draw(
    axes: Axes, points: Sequence[tuple[PullRow, float | None, float | None]], label: str
) -> None:
    known = [(100.0 * r.travel_m, e, b, r.last) for r, e, b in points if e is not None and b]
    for place, colour, name in ((1, "graph", "error"), (2, "third", "95 % bound")):
        x, y, low, high = [], [], [], []
        for start, end in _bins():
            inside = [k[place] for k in known if 100.0 * start <= k[0] < 100.0 * end]
            if len(inside) >= FEWEST:
                x.append(50.0 * (start + end))
                quarter, half, three = np.quantile(inside, (0.25, 0.5, 0.75))
                y.append(half)
                low.append(quarter)
                high.append(three)
        axes.plot(x, y, "-o", ms=4, color=COLOURS[colour], label=f"{name}, median and quartiles")
        axes.fill_between(x, low, high, color=COLOURS[colour], alpha=0.15, lw=0)
    ends = [k for k in known if k[3]]
    axes.plot(
        [k[0] for k in ends], [k[1] for k in ends], ".", ms=4, color=COLOURS["bound"],
        label="error where it stopped",
    )  # fmt: skip
    axes.set_yscale("log")
    axes.axhline(1.0, color=COLOURS["peer"], ls="--", lw=1.0, label="needed")
    log_ticks(axes.yaxis, (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30))
    axes.set(ylabel=label, xlabel="way of the hand, cm")


def _bins() -> list[tuple[float, float]]:
    return list(pairwise(STRETCH_M * (0.5 + k) for k in range(BINS + 1)))


def _median(values: Sequence[float | None], factor: float = 1.0) -> str:
    known = [value for value in values if value is not None]
    return f"{factor * np.median(known):.2f}" if known else ""


def main() -> None:
    """Run what is missing; print tables, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=Path, required=True, help="folder of closed_loop's models")
    parser.add_argument("--exploration", type=Path, help="folder of rows with both stops")
    parser.add_argument("--every", type=int, default=1, help="every how manieth model")
    parser.add_argument("--limit", type=int, help="stop after so many new recordings")
    parser.add_argument("--table", action="store_true", help="print the tables alone")
    parser.add_argument("--out", type=Path, default=Path("runs/along-the-pull"))
    parser.add_argument("--figure", type=Path, help="PNG to draw")
    arguments = parser.parse_args()
    file = arguments.out / "rows.jsonl"
    if not arguments.table:
        note_run(arguments.out)
        _run_missing(arguments, file)
    rows = rows_of(PullRow, file)
    if rows:
        print(table(rows))
        if arguments.exploration is not None:
            print("", stops(exploration_rows(arguments.exploration)), sep="\n")
        if arguments.figure is not None:
            figure(rows, arguments.figure)


def _run_missing(arguments: argparse.Namespace, file: Path) -> None:
    done = {(row.name, row.seed) for row in rows_of(PullRow, file)}
    kept = kept_models(arguments.models)[:: arguments.every]
    missing = [one for one in kept if one[:2] not in done][: arguments.limit]
    for number, (name, seed, folder) in enumerate(missing, 1):
        try:
            rows = run_recording(name, seed, folder)
        except AkmError as error:
            print(f"{name}: {error}", file=sys.stderr, flush=True)
            continue
        for row in rows:
            append_line(file, json.dumps(asdict(row)))
        print(f"{number} of {len(missing)}: {name}: {len(rows)} stretches", file=sys.stderr)


if __name__ == "__main__":
    main()
