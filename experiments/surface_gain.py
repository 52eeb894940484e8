"""What does the surface add to tracks (the paper's Table II, coarse against fine)?

    python -m experiments.rendered_recordings --suite furniture-116 --out runs/recordings
    python -m experiments.surface_gain --recordings runs/recordings

The graph with tracks only, surface only and both; the paper's coarse and fine stages on the same
tracks and masks; from the images alone. One row a recording and method in
OUT/rows.jsonl, as a recording ends; what is there is not done again. `experiments.report` puts
tables and figures into docs/experiments.md, those of the covariances too (`calibration`).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from akm_fg.pipeline import fit_recording
from experiments.pages.figures import COLOURS, new_figure, save
from experiments.pages.one_line import ends_in_one_line
from experiments.pages.tables import (
    NoRows,
    grouped,
    known_or_infinite,
    markdown,
    number,
    of_method,
    percent,
)
from experiments.rows.provenance import note_run
from experiments.rows.rows import Key, TrialRow, fill
from experiments.scores.statistics import Estimate, median, share
from experiments.trials.recording_methods import GRAPH, PAPER, Fit, run_recording
from experiments.trials.track_methods import PAPER_STARTS

METHODS = (*GRAPH, *PAPER)
ASR = (1.0, 5.0, 10.0, 20.0)  # degrees and centimetres
COLOUR = {
    "graph-tracks": "second",
    "graph-surface": "third",
    "graph-both": "graph",
    "paper-coarse": "bound",
    "paper-fine": "paper",
}
NAMES = {
    "graph-tracks": "graph, tracks only",
    "graph-surface": "graph, surface only",
    "graph-both": "graph, both",
    "paper-coarse": "paper's method, coarse",
    "paper-fine": "paper's method, coarse and fine",
}


@dataclass(frozen=True, slots=True)
class SurfaceGainConfig:
    """Which trials are run."""

    recordings: Path
    methods: tuple[str, ...] = METHODS
    seed: int = 0
    starts: int = PAPER_STARTS
    limit: int | None = None  # only so many recordings, evenly over the folder
    out: Path = Path("runs/surface-gain")

    def folders(self) -> list[Path]:
        """The recordings, by name.

        Raises:
            NoRows: there are none.
        """
        found = sorted(file.parent for file in self.recordings.glob("*/recording.json"))
        found = [folder for folder in found if folder.suffix != ".part"]  # still being made
        if not found:
            raise NoRows(
                f"{self.recordings} has no recordings: run experiments.rendered_recordings"
            )
        if self.limit is not None and self.limit < len(found):
            take = np.linspace(0, len(found) - 1, self.limit).round().astype(int)
            found = [found[i] for i in take]
        return found


def run(config: SurfaceGainConfig, fit: Fit = fit_recording) -> int:
    """Run what is missing with our `fit`; returns how many trials that were."""
    note_run(config.out, config)
    folders = {folder.name: folder for folder in config.folders()}
    wanted = [Key(name, method, config.seed) for name in folders for method in config.methods]

    def run_batch(some: Sequence[Key]) -> list[TrialRow]:
        rows: list[TrialRow] = []
        for name in dict.fromkeys(key.cell for key in some):
            methods = [key.method for key in some if key.cell == name]
            rows += run_recording(folders[name], methods, config.seed, config.starts, fit)
        return rows

    return fill(config.out / "rows.jsonl", wanted, run_batch, batch=len(config.methods))


def gain_table(rows: Sequence[TrialRow]) -> str:
    """ASR at all limits, kinds, errors and time, a line a method."""
    lines = []
    for method, some in _methods(rows):
        fit_s = [row.time_s["fit"] for row in some if "fit" in row.time_s]
        lines.append(
            [
                NAMES[method],
                str(len(some)),
                percent(share([row.kind_right for row in some])),
                str(sum(row.confidently_wrong for row in some)),
                *(percent(share([row.within(limit) for row in some])) for limit in ASR),
                number(_median_axis_deg(some)),
                number(_median_distance_mm(some)),
                f"{np.median(fit_s):.2f}" if fit_s else "–",
                str(sum(row.failure is not None for row in some)),
            ]
        )
    header = ["method", "recordings", "kind right, %", "named wrongly"]
    header += [f"ASR_{limit:g}, %" for limit in ASR]
    header += ["median axis error, deg", "median line distance, mm", "median fit, s", "failures"]
    return markdown(header, lines)


def kinds_table(rows: Sequence[TrialRow]) -> str:
    """ASR_1 by true kind."""
    lines = []
    for method, some in _methods(rows):
        for kind, few in grouped(some, lambda row: row.kind_true).items():
            inside = percent(share([row.within(1.0) for row in few]))
            right = percent(share([row.kind_right for row in few]))
            lines.append([NAMES[method], kind, str(len(few)), right, inside])
    return markdown(["method", "true kind", "recordings", "kind right, %", "ASR_1, %"], lines)


def gain_figure(rows: Sequence[TrialRow], file: Path) -> None:
    """ASR_x against x."""
    figure, (ax,) = new_figure(1, 3.8)
    x = np.geomspace(0.05, 20, 200)
    for method, some in _methods(rows):
        least = np.array(known_or_infinite(_least_limit(row) for row in some))
        shares = [100 * float((least <= limit).mean()) for limit in x]
        style = "--" if method in PAPER else "-"
        ax.plot(x, shares, style, color=COLOURS[COLOUR[method]], lw=2, label=NAMES[method])
    ax.axvline(1, color=COLOURS["bound"], lw=1)
    ax.set(xscale="log", xlim=(0.05, 20), ylim=(0, 101))
    ax.set_xticks([0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20])
    ax.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
    ax.set_xlabel("x: kind right, axis within x deg and x cm")
    ax.set_ylabel("recordings (ASR_x), %")
    figure.legend(loc="outside right center")
    save(figure, file)


def failures_table(rows: Sequence[TrialRow]) -> str:
    """Recordings that the graph with both does not get within 1 deg and 1 cm, and why."""
    lines = []
    for row in of_method(rows, "graph-both"):
        if not row.within(1.0):
            axis, distance = row.errors.axis_error_deg, row.errors.line_distance_m
            lines.append(
                [
                    row.cell,
                    row.kind_true,
                    row.kind or row.failure or "–",
                    "–" if axis is None else f"{axis:.2f}",
                    "–" if distance is None else f"{1e3 * distance:.1f}",
                ]
            )
    if not lines:
        return "The graph with both gets every recording within 1 deg and 1 cm."
    header = ["outside", "true kind", "named", "axis error, deg", "line distance, mm"]
    return markdown(header, lines)


def _least_limit(row: TrialRow) -> float | None:
    """The smallest x for which the trial counts in ASR_x."""
    axis, distance = row.errors.axis_error_deg, row.errors.line_distance_m
    if not row.kind_right or axis is None:
        return None
    return axis if distance is None else max(axis, 100 * distance)


def _methods(rows: Sequence[TrialRow]) -> list[tuple[str, list[TrialRow]]]:
    found = [(method, of_method(rows, method)) for method in METHODS]
    found = [(method, some) for method, some in found if some]
    if not found:
        raise NoRows("no trials: run experiments.surface_gain")
    return found


def _median_axis_deg(rows: Sequence[TrialRow]) -> Estimate:
    return median(known_or_infinite(row.errors.axis_error_deg for row in rows))


def _median_distance_mm(rows: Sequence[TrialRow]) -> Estimate:
    """Of the hinges: a drawer has no axis line."""
    hinges = [row for row in rows if row.kind_true == "revolute"]
    if not hinges:
        return Estimate(float("nan"), float("nan"), float("nan"))
    found = median(known_or_infinite(row.errors.line_distance_m for row in hinges))
    return Estimate(1e3 * found.value, 1e3 * found.low, 1e3 * found.high)


def main() -> None:
    """Run what is missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = SurfaceGainConfig(Path())
    parser.add_argument("--recordings", type=Path, required=True)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=default.methods)
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--starts", type=int, default=default.starts, help="of the coarse stage")
    parser.add_argument("--limit", type=int, default=default.limit, help="so many recordings")
    parser.add_argument("--out", type=Path, default=default.out)
    arguments = vars(parser.parse_args())
    with ends_in_one_line("surface_gain"):
        run(SurfaceGainConfig(**{**arguments, "methods": tuple(arguments["methods"])}))


if __name__ == "__main__":
    main()
