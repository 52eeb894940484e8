"""How every figure of the experiments looks: sizes, colours, labelled lines, no junk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from experiments.scores.statistics import Estimate

WIDTH_IN = 8.0  # as wide as a page of the docs; text stays readable
DPI = 120
COLOURS = {  # Okabe and Ito (2008): told apart by everybody
    "graph": "#0072B2",
    "paper": "#D55E00",
    "peer": "#009E73",
    "bound": "#777777",
    "second": "#CC79A7",
    "third": "#E69F00",
}
NAMES = {"graph": "graph (ours)", "paper": "paper's method", "peer": "ripl-articulation"}


def new_figure(
    columns: int = 1, height_in: float = 3.4, rows: int = 1
) -> tuple[Figure, list[Axes]]:
    """Axes in reading order."""
    plt.rcParams.update(
        {
            "font.size": 10,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.color": "#e6e6e6",
            "axes.axisbelow": True,
            "legend.frameon": False,
        }
    )
    figure, axes = plt.subplots(
        rows, columns, figsize=(WIDTH_IN, height_in), layout="constrained", squeeze=False
    )
    return figure, list(axes.ravel())


def save(figure: Figure, file: Path) -> None:
    """Write the PNG and forget the figure."""
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=DPI)
    plt.close(figure)


def log_ticks(axis: object, values: Sequence[float]) -> None:
    """Plain numbers at these values of a logarithmic axis."""
    axis.set_major_locator(FixedLocator(list(values)))  # type: ignore[attr-defined]
    axis.set_minor_locator(NullLocator())  # type: ignore[attr-defined]
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))  # type: ignore[attr-defined]


def line_with_band(
    axes: Axes,
    x: Sequence[float],
    estimates: Sequence[Estimate],
    colour: str,
    style: str = "-",
    factor: float = 1.0,
) -> None:
    """Values as a line, their intervals as a band."""
    axes.plot(x, [factor * e.value for e in estimates], style, color=colour, marker="o", ms=4)
    low, high = ([factor * getattr(e, side) for e in estimates] for side in ("low", "high"))
    axes.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)


def dots_with_bars(
    axes: Axes,
    y: Sequence[float],
    estimates: Sequence[Estimate],
    colour: str,
    label: str,
    factor: float = 1.0,
) -> None:
    """Values as dots in a row each, their intervals as bars."""
    values = [factor * e.value for e in estimates]
    bars = [
        [max(v - factor * e.low, 0.0) for v, e in zip(values, estimates, strict=True)],
        [max(factor * e.high - v, 0.0) for v, e in zip(values, estimates, strict=True)],
    ]
    axes.errorbar(values, y, xerr=bars, fmt="o", ms=4.5, lw=1.4, color=colour, label=label)


def rows_named(axes: Axes, names: Sequence[str]) -> None:
    """Rows from top to bottom, named at the left."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(axis="y", visible=False)
