"""Do covariances and probabilities tell the truth: tracks only, surface only, both?

    python -m experiments.claims.coverage --tracks runs/accuracy --recordings runs/surface-gain

Runs nothing: it reads the graph's rows of `experiments.accuracy_grid` (tracks) and of
`experiments.surface_gain` (rendered recordings; tracks, surface and both), and prints tables:
mean NEES, 95 % coverage of axis, pivot, whole joint and last state, Brier score of the kind. Some
seconds. `experiments.report` puts the same tables and a figure into docs/experiments.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.pages.covered import (
    NOTHING,
    QUANTITIES,
    flags_of,
    inside_columns,
    nees_of_joint,
)
from experiments.pages.figures import COLOURS, dots_with_bars, new_figure, rows_named, save
from experiments.pages.tables import NoRows, grouped, markdown, of_method
from experiments.rows.rows import TrialRow, read_rows
from experiments.scores.statistics import Estimate, mean_nees, share
from experiments.trials.cells import CONDITIONS, NOISES_MM, POINTS, TRAVELS, Cell

ASKED_PERCENT = (92.0, 98.0)  # coverage of tracks in clean and drifting cells (issue 3)


def tracks_table(rows: Sequence[TrialRow]) -> str:
    """The cells of 40 points, 20 frames, 3 mm, one by one."""
    by_cell = grouped(of_method(rows, "graph"), lambda row: row.cell)
    found = [(c, by_cell[c.name]) for c in _main_cells() if c.name in by_cell]
    return _table("tracks, 3 mm, 40 points", [(_label(cell), some) for cell, some in found])


def grid_table(rows: Sequence[TrialRow]) -> str:
    """The whole grid, pooled over the travels: condition, noise and number of tracks."""
    graph = of_method(rows, "graph")
    lines = []
    for condition in CONDITIONS:
        for noise_mm in NOISES_MM:
            for points in POINTS:
                names = {
                    Cell(part, travel, noise_mm, points, condition=condition).name
                    for part, travel in TRAVELS
                }
                some = [row for row in graph if row.cell in names]
                if some:
                    lines.append((f"{condition}, {noise_mm:g} mm, {points} tracks", some))
    return _table("tracks, all travels", lines)


def recordings_table(rows: Sequence[TrialRow]) -> str:
    """Rendered recordings by what the fit was given."""
    lines = []
    for method, some in grouped(rows, lambda row: row.method).items():
        if method.startswith("graph-"):
            lines.append((method.removeprefix("graph-"), some))
            for kind, few in grouped(some, lambda row: row.kind_true).items():
                lines.append((f"{method.removeprefix('graph-')}, {kind}", few))
    return _table("recordings, given", lines)


def tracks_figure(rows: Sequence[TrialRow], file: Path) -> None:
    """Coverage in the cells of 40 points, 20 frames, 3 mm."""
    by_cell = grouped(of_method(rows, "graph"), lambda row: row.cell)
    found = [(_label(c), by_cell[c.name]) for c in _main_cells() if c.name in by_cell]
    _figure(found, file, ASKED_PERCENT)


def recordings_figure(rows: Sequence[TrialRow], file: Path) -> None:
    """Coverage on recordings, by what the fit was given."""
    methods = grouped(rows, lambda row: row.method)
    found = [(m.removeprefix("graph-"), some) for m, some in methods.items() if "graph-" in m]
    _figure(found, file, (88.0, 100.0))


def _figure(
    groups: Sequence[tuple[str, list[TrialRow]]], file: Path, asked: tuple[float, float]
) -> None:
    if not groups:
        raise NoRows("no trials of the graph to look at")
    figure, (ax,) = new_figure(1, 1.2 + 0.3 * len(groups))
    ax.axvspan(*asked, color="#eeeeee", lw=0, label="asked for")
    ax.axvline(95, color=COLOURS["bound"], lw=1)
    for k, quantity in enumerate(QUANTITIES):
        known = [(i, flags_of(some, quantity)) for i, (_, some) in enumerate(groups)]
        known = [(i, flags) for i, flags in known if flags]
        y = [i + 0.18 * (k - 1.5) for i, _ in known]
        estimates = [share(flags) for _, flags in known]
        dots_with_bars(ax, y, estimates, COLOURS[quantity.colour], quantity.name, 100)
    rows_named(ax, [name for name, _ in groups])
    ax.set(xlabel="truth inside the 95 % region, % of trials", xlim=(None, 100.5))
    figure.legend(loc="outside right center")
    save(figure, file)


def _table(what: str, groups: Sequence[tuple[str, list[TrialRow]]]) -> str:
    if not groups:
        raise NoRows(f"no trials: {what}")
    header = [what, "trials", "NEES/dof, joint (band)", "NEES, last state (band)"]
    header += [f"{quantity.name} inside 95 %" for quantity in QUANTITIES]
    header += ["Brier, kind"]
    return markdown(header, [[name, *_line(rows)] for name, rows in groups])


def _line(rows: Sequence[TrialRow]) -> list[str]:
    brier = [row.brier for row in rows if row.brier is not None]
    return [
        str(len(rows)),
        _nees_of_joint(rows),
        _nees_of_state(rows),
        *inside_columns(rows),
        f"{np.mean(brier):.3f}" if brier else NOTHING,
    ]


def _nees_of_joint(rows: Sequence[TrialRow]) -> str:
    """Mean over its degrees of freedom; doors and drawers may be pooled."""
    mean = nees_of_joint(rows)
    return NOTHING if mean is None else _band(mean)


def _nees_of_state(rows: Sequence[TrialRow]) -> str:
    known = [n for row in rows if (n := row.consistency.nees_last_state) is not None]
    return _with_band(sum(known), len(known)) if known else NOTHING


def _with_band(total_nees: float, dof: int) -> str:
    return _band(mean_nees(total_nees, dof))


def _band(mean: Estimate) -> str:
    return f"{mean.value:.2f} ({mean.low:.2f} to {mean.high:.2f})"


def _main_cells() -> list[Cell]:
    return [Cell(*travel, condition=condition) for condition in CONDITIONS for travel in TRAVELS]


def _label(cell: Cell) -> str:
    return cell.travel_name + ("" if cell.condition == "clean" else f", {cell.condition}")


def main() -> None:
    """Print what there is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tracks", type=Path, default=Path("runs/accuracy"))
    parser.add_argument("--recordings", type=Path, default=Path("runs/surface-gain"))
    arguments = parser.parse_args()
    tracks = read_rows(arguments.tracks)
    for table, rows in (
        (tracks_table, tracks),
        (grid_table, tracks),
        (recordings_table, read_rows(arguments.recordings)),
    ):
        try:
            print(table(rows), end="\n\n")
        except NoRows as nothing:
            print(nothing, end="\n\n")


if __name__ == "__main__":
    main()
