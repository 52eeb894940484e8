"""How near to the Cramer-Rao bound is the graph, with axis, pivot and last state?

    python -m experiments.claims.cramer_rao --rows runs/accuracy

Runs no estimator: it reads the graph's rows of `experiments.accuracy_grid`, makes each opening
again from its seed, works out the bound of that very opening (true noise, true parameters, latent
points marginalised; `experiments.trials.bound`) and prints ratios: RMSE over the root mean square
that the
bound allows, and, because a few far-off trials rule an RMSE, the median of each error over the
median that its own bound allows. Both are 1 for an efficient estimator. Some seconds.
`experiments.report` puts the table and a figure into docs/experiments.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.pages.figures import COLOURS, dots_with_bars, new_figure, rows_named, save
from experiments.pages.one_line import ends_in_one_line
from experiments.pages.tables import NoRows, grouped, markdown, number, of_method
from experiments.rows.rows import TrialRow, read_rows
from experiments.scores.statistics import Estimate, median, rms_ratio
from experiments.trials.bound import Bound
from experiments.trials.bound_of_rows import bound_of
from experiments.trials.cells import CONDITIONS, TRAVELS, Cell

ASKED = 1.15  # largest ratio of RMSE in the clean cells (issue 3)
NOTHING = "–"


@dataclass(frozen=True, slots=True)
class Quantity:
    """An error and what the bound says of it; None where there is no such thing."""

    name: str
    error: Callable[[TrialRow], float | None]  # rad or m
    variance: Callable[[Bound], float | None]
    median: Callable[[Bound], float | None]
    colour: str


QUANTITIES = (
    Quantity(
        "axis",
        lambda row: None if (e := row.errors.axis_error_deg) is None else float(np.deg2rad(e)),
        lambda bound: bound.axis_variance_rad2,
        lambda bound: bound.median_axis_error_rad,
        "graph",
    ),
    Quantity(
        "pivot",
        lambda row: row.errors.pivot_error_m,
        lambda bound: bound.pivot_variance_m2,
        lambda bound: bound.median_pivot_error_m,
        "paper",
    ),
    Quantity(
        "last state",
        lambda row: row.errors.last_state_error,
        lambda bound: float(bound.var_states[-1]),
        lambda bound: bound.median_last_state_error,
        "second",
    ),
)


@dataclass(frozen=True, slots=True)
class Ratios:
    """Of one quantity in one cell, over the trials that have it."""

    trials: int
    rmse: Estimate
    median: Estimate


def ratios(rows: Sequence[TrialRow], quantity: Quantity) -> Ratios | None:
    """Errors over the bound; None where no trial has both."""
    squares, variances, relative = [], [], []
    for row in rows:
        bound = bound_of(row.cell, row.seed)
        error, variance, middle = (
            quantity.error(row),
            quantity.variance(bound),
            quantity.median(bound),
        )
        if error is not None and variance is not None and middle is not None:
            squares.append(error**2)
            variances.append(variance)
            relative.append(abs(error) / middle)
    if not squares:
        return None
    rng = np.random.default_rng(0)
    return Ratios(len(squares), rms_ratio(squares, variances, rng), median(relative))


def ratio_table(rows: Sequence[TrialRow]) -> str:
    """RMSE and median over the bound's, cell by cell."""
    header = ["over the bound", "trials"]
    header += [f"{q.name}, {what}" for q in QUANTITIES for what in ("RMSE", "median")]
    lines = []
    for name, some in _cells(rows):
        line = []
        for quantity in QUANTITIES:
            found = ratios(some, quantity)
            line += [NOTHING] * 2 if found is None else [number(found.rmse), number(found.median)]
        lines.append([name, str(len(some)), *line])
    return markdown(header, lines)


def ratio_figure(rows: Sequence[TrialRow], file: Path) -> None:
    """RMSE over the bound's (left) and median over the median (right)."""
    cells = _cells(rows)
    figure, axes = new_figure(2, 1.2 + 0.28 * len(cells))
    for ax, what in zip(axes, ("rmse", "median"), strict=True):
        ax.axvline(1, color=COLOURS["bound"], lw=1)
        if what == "rmse":
            ax.axvline(ASKED, color=COLOURS["bound"], lw=1, ls=":")
        for k, quantity in enumerate(QUANTITIES):
            found = [(i, ratios(some, quantity)) for i, (_, some) in enumerate(cells)]
            known = [(i, r) for i, r in found if r is not None]
            y = [i + 0.2 * (k - 1) for i, _ in known]
            estimates = [getattr(r, what) for _, r in known]
            dots_with_bars(ax, y, estimates, COLOURS[quantity.colour], quantity.name)
        rows_named(ax, [name for name, _ in cells])
        ax.set_xlim(0.5, max(2.0, min(ax.get_xlim()[1], 4.0)))
    axes[1].set_yticklabels([])
    axes[0].set_xlabel("RMSE over the bound's (dotted: asked for)")
    axes[1].set_xlabel("median error over the bound's")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3)
    save(figure, file)


def _cells(rows: Sequence[TrialRow]) -> list[tuple[str, list[TrialRow]]]:
    """The cells of 40 points, 20 frames, 3 mm that there are."""
    by_cell = grouped(of_method(rows, "graph"), lambda row: row.cell)
    cells = [Cell(*travel, condition=condition) for condition in CONDITIONS for travel in TRAVELS]
    found = []
    for cell in cells:
        if cell.name in by_cell:
            label = cell.travel_name + ("" if cell.condition == "clean" else f", {cell.condition}")
            found.append((label, by_cell[cell.name]))
    if not found:
        raise NoRows("no trials of the graph: run experiments.accuracy_grid")
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=Path, default=Path("runs/accuracy"))
    with ends_in_one_line("cramer_rao"):
        print(ratio_table(read_rows(parser.parse_args().rows)))


if __name__ == "__main__":
    main()
