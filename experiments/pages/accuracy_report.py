"""Tables and figures of experiment (a), accuracy: what `experiments.accuracy_grid` has run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm

from experiments.pages.figures import (
    COLOURS,
    NAMES,
    dots_with_bars,
    line_with_band,
    log_ticks,
    new_figure,
    rows_named,
    save,
)
from experiments.pages.tables import (
    NoRows,
    grouped,
    known_or_infinite,
    markdown,
    number,
    of_method,
    percent,
)
from experiments.rows.rows import TrialRow
from experiments.scores.statistics import Estimate, median, share
from experiments.trials.bound_of_rows import median_axis_error_deg, share_inside
from experiments.trials.cells import (
    CONDITIONS,
    NOISES_MM,
    POINTS,
    TRAVELS,
    Cell,
    cell_named,
    table_cells,
)

METHODS = ("graph", "paper", "peer")
INSIDE_DEG_CM = 1.0
# What issue 3 asks of the median axis error, degrees: clean, 20 % drifting.
MUST_REACH_DEG = {
    ("door", 5.0): (2.1, 2.5),
    ("door", 15.0): (0.66, 0.8),
    ("door", 40.0): (0.24, 0.3),
    ("drawer", 5.0): (0.52, 0.65),
    ("drawer", 15.0): (0.17, 0.2),
    ("drawer", 40.0): (0.065, 0.08),
}
NOTHING = "–"


def axis_table(rows: Sequence[TrialRow]) -> str:
    """Median axis error in the twelve cells, beside the bound and what was asked for."""
    lines = []
    for cell, found in _table_rows(rows):
        asked = MUST_REACH_DEG[cell.part, cell.travel][cell.condition == "drifting"]
        medians = [_or_nothing(_axis_median, found.get(method, [])) for method in METHODS]
        bound = f"{median_axis_error_deg(_any(found)):.2g}"
        lines.append([_label(cell), bound, f"{asked:g}", *medians])
    header = ["median axis error, deg", "bound", "asked for", *(NAMES[m] for m in METHODS)]
    return markdown(header, lines)


def inside_table(rows: Sequence[TrialRow]) -> str:
    """Share of the trials inside (kind right, 1 deg, 1 cm), cell by cell and over all twelve."""
    lines, bounds = [], []
    everything: dict[str, list[TrialRow]] = {method: [] for method in METHODS}
    cells_of: dict[str, int] = dict.fromkeys(METHODS, 0)
    for cell, found in _table_rows(rows):
        bounds.append(100 * share_inside(_any(found), INSIDE_DEG_CM))
        shares = []
        for method in METHODS:
            some = found.get(method, [])
            shares.append(_or_nothing(_inside, some))
            everything[method] += some
            cells_of[method] += bool(some)
        lines.append([_label(cell), f"{bounds[-1]:.0f}", *shares])
    total = [
        _or_nothing(_inside, everything[m]) if cells_of[m] == len(table_cells()) else NOTHING
        for m in METHODS
    ]
    lines.append(["all twelve", f"{np.mean(bounds):.0f}", *total])
    return markdown(["inside, %", "bound", *(NAMES[m] for m in METHODS)], lines)


def kind_table(rows: Sequence[TrialRow]) -> str:
    """Kinds: right, undecided, confidently wrong; baselines always name one."""
    lines = []
    for cell, found in _table_rows(rows):
        graph = found.get("graph", [])
        named = [row for row in graph if row.kind not in (None, "undecided")]
        lines.append(
            [
                _label(cell),
                _or_nothing(_right, graph),
                _or_nothing(_right, named),
                str(sum(row.confidently_wrong for row in graph)),
                str(sum(row.kind in (None, "undecided") for row in graph)),
                *(_or_nothing(_right, found.get(method, [])) for method in METHODS[1:]),
            ]
        )
    header = ["kind right, %", "graph", "graph, of those named", "named wrongly", "undecided"]
    return markdown([*header, *(NAMES[m] for m in METHODS[1:])], lines)


def pivot_table(rows: Sequence[TrialRow]) -> str:
    """Doors: median distance between the axis lines, and of the true line from the pivot, mm."""
    lines = []
    for cell, found in _table_rows(rows):
        if cell.part == "door":
            values = []
            for method in METHODS:
                some = found.get(method, [])
                values += [_or_nothing(_line_median, some), _or_nothing(_pivot_median, some)]
            lines.append([_label(cell), *values])
    names = [f"{NAMES[m]}, {what}" for m in METHODS for what in ("lines", "pivot")]
    return markdown(["median, mm", *names], lines)


def time_table(rows: Sequence[TrialRow]) -> str:
    """Seconds and failures of each method over the twelve cells."""
    lines = []
    names = {cell.name for cell in table_cells()}
    for method in METHODS:
        some = [row for row in of_method(rows, method) if row.cell in names]
        seconds = [row.time_s["total"] for row in some if "total" in row.time_s]
        if seconds:
            failures = sum(row.failure is not None for row in some)
            lines.append([NAMES[method], str(len(some)), number(median(seconds)), str(failures)])
    return markdown(["twelve cells", "trials", "median time, s", "failures"], lines)


def grid_table(rows: Sequence[TrialRow]) -> str:
    """Median axis error of the graph in every cell of the grid, and its ratio to the bound's."""
    by_cell = grouped(of_method(rows, "graph"), lambda row: row.cell)
    lines = []
    for condition in CONDITIONS:
        for part, travel in TRAVELS:
            cells = [Cell(part, travel, n, p, condition=condition) for n, p in _columns()]
            values = [_with_ratio(by_cell.get(cell.name, [])) for cell in cells]
            lines.append([f"{cells[0].travel_name}, {condition}", *values])
    return markdown(["deg (over bound)", *(f"{n:g} mm, {p}" for n, p in _columns())], lines)


def travel_figure(rows: Sequence[TrialRow], file: Path) -> None:
    """Median axis error against travel, by method; clean and drifting."""
    figure, axes = new_figure(2, 3.6)
    for ax, (part, unit) in zip(axes, (("door", "deg"), ("drawer", "cm")), strict=True):
        cells = [(c, f) for c, f in _table_rows(rows) if c.part == part]
        for condition, style in (("clean", "-"), ("drifting", "--")):
            here = [(c, f) for c, f in cells if c.condition == condition]
            for method in METHODS:
                points = [
                    (c.travel, median(_axis_errors(f[method]))) for c, f in here if method in f
                ]
                if points:
                    x, estimates = zip(*points, strict=True)
                    line_with_band(ax, x, estimates, COLOURS[method], style)
            if condition == "clean" and here:
                limit = [median_axis_error_deg(_any(f)) for _, f in here]
                ax.plot([c.travel for c, _ in here], limit, ":", color=COLOURS["bound"], lw=2)
        ax.set(xscale="log", yscale="log", xlabel=f"travel of the {part}, {unit}")
        log_ticks(ax.xaxis, [5, 15, 40])
        log_ticks(ax.yaxis, [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20])
    axes[0].set_ylabel("median axis error, deg")
    for method in METHODS:
        axes[1].plot([], [], "-", color=COLOURS[method], label=NAMES[method])
    axes[1].plot([], [], ":", color=COLOURS["bound"], lw=2, label="Cramer-Rao, clean")
    axes[1].plot([], [], "-", color="k", lw=1, label="clean tracks")
    axes[1].plot([], [], "--", color="k", lw=1, label="20 % drifting")
    figure.legend(loc="outside right center")
    save(figure, file)


def inside_figure(rows: Sequence[TrialRow], file: Path) -> None:
    """Share inside, cell by cell."""
    found = _table_rows(rows)
    figure, (ax,) = new_figure(1, 4.6)
    for k, method in enumerate(METHODS):
        at = [
            (i, share([r.within(INSIDE_DEG_CM) for r in f[method]]))
            for i, (_, f) in enumerate(found)
            if method in f
        ]
        if at:
            y = [i + 0.22 * (k - 1) for i, _ in at]
            dots_with_bars(ax, y, [e for _, e in at], COLOURS[method], NAMES[method], 100)
    limits = [100 * share_inside(_any(f), INSIDE_DEG_CM) for _, f in found]
    ax.scatter(limits, range(len(found)), marker="|", s=300, color=COLOURS["bound"], label="bound")
    rows_named(ax, [_label(cell) for cell, _ in found])
    ax.set(xlabel="trials with kind right, axis within 1 deg and 1 cm, %", xlim=(-3, 103))
    figure.legend(loc="outside right center")
    save(figure, file)


def grid_figure(rows: Sequence[TrialRow], file: Path) -> None:
    """Graph: median axis error over the bound's, in every cell of the grid."""
    by_cell = grouped(of_method(rows, "graph"), lambda row: row.cell)
    names, ratios = [], []
    for condition in CONDITIONS:
        for part, travel in TRAVELS:
            cells = [Cell(part, travel, n, p, condition=condition) for n, p in _columns()]
            names.append(f"{cells[0].travel_name}, {condition}")
            ratios.append([_ratio(by_cell.get(cell.name, [])) for cell in cells])
    values = np.array(ratios)
    figure, (ax,) = new_figure(1, 5.6)
    image = ax.imshow(values, aspect="auto", cmap="PuBu", norm=LogNorm(0.7, 10))
    for i, j in np.argwhere(np.isfinite(values)):
        colour = "w" if values[i, j] > 3.5 else "k"
        ax.text(j, i, f"{values[i, j]:.2g}", ha="center", va="center", fontsize=9, color=colour)
    ax.set_xticks(range(len(_columns())), [f"{n:g} mm\n{p}" for n, p in _columns()])
    ax.set_yticks(range(len(names)), names)
    ax.set_xlabel("noise, and number of tracks")
    ax.grid(visible=False)
    bar = figure.colorbar(image, ax=ax, label="median axis error over the bound's")
    log_ticks(bar.ax.yaxis, [0.7, 1, 2, 5, 10])
    save(figure, file)


def _columns() -> list[tuple[float, int]]:
    return [(noise_mm, points) for noise_mm in NOISES_MM for points in POINTS]


def _table_rows(rows: Sequence[TrialRow]) -> list[tuple[Cell, dict[str, list[TrialRow]]]]:
    """The twelve cells, as far as there are rows, each by method."""
    by_cell = grouped(rows, lambda row: row.cell)
    found = [
        (cell, grouped(by_cell[cell.name], lambda row: row.method))
        for cell in table_cells()
        if cell.name in by_cell
    ]
    if not found:
        raise NoRows("no trials of the twelve cells: run experiments.accuracy_grid")
    return found


def _label(cell: Cell) -> str:
    return cell.travel_name + (", drifting" if cell.condition == "drifting" else "")


def _any(found: dict[str, list[TrialRow]]) -> list[TrialRow]:
    """The longest of the methods' rows: whose seeds the bound is taken over."""
    return max(found.values(), key=len)


def _axis_errors(rows: Sequence[TrialRow]) -> list[float]:
    return known_or_infinite(row.errors.axis_error_deg for row in rows)


def _axis_median(rows: Sequence[TrialRow]) -> str:
    return number(median(_axis_errors(rows)))


def _line_median(rows: Sequence[TrialRow]) -> str:
    return number(_millimetres(median(known_or_infinite(r.errors.line_distance_m for r in rows))))


def _pivot_median(rows: Sequence[TrialRow]) -> str:
    return number(_millimetres(median(known_or_infinite(r.errors.pivot_error_m for r in rows))))


def _millimetres(m: Estimate) -> Estimate:
    return Estimate(1e3 * m.value, 1e3 * m.low, 1e3 * m.high)


def _inside(rows: Sequence[TrialRow]) -> str:
    return percent(share([row.within(INSIDE_DEG_CM) for row in rows]))


def _right(rows: Sequence[TrialRow]) -> str:
    return percent(share([row.kind_right for row in rows]))


def _or_nothing(say: object, rows: Sequence[TrialRow]) -> str:
    return say(rows) if rows else NOTHING  # type: ignore[operator]


def _ratio(rows: Sequence[TrialRow]) -> float:
    if not rows:
        return float("nan")
    return median(_axis_errors(rows)).value / median_axis_error_deg(rows)


def _with_ratio(rows: Sequence[TrialRow]) -> str:
    if not rows:
        return NOTHING
    return f"{median(_axis_errors(rows)).value:.2g} ({_ratio(rows):.2f})"


def cells_named_wrongly(rows: Sequence[TrialRow]) -> str:
    """Cells of the grid in which the graph named a wrong kind, and how often."""
    lines = []
    for name, some in grouped(of_method(rows, "graph"), lambda row: row.cell).items():
        wrong = [row for row in some if row.confidently_wrong]
        if wrong:
            kinds = sorted({str(row.kind) for row in wrong})
            cell = cell_named(name)
            lines.append([cell.name, f"{len(wrong)} of {len(some)}", ", ".join(kinds)])
    if not lines:
        return "No cell of the grid has a kind that was named wrongly."
    return markdown(["cell", "named wrongly", "as"], lines)
