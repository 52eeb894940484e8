"""What each stretch of a pull told, and what was expected of it: one SVG."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from akm_fg.exploration.records import Bounds, Stretch
from akm_fg.exploration.stopping import Need
from akm_fg.report.plots import ESTIMATE, STYLE, as_svg

Value = Callable[[Bounds], float]
_EXPECTED, _NEEDED = "#5b6470", "#1a7f37"


def stretches_svg(stretches: Sequence[Stretch], need: Need) -> str | None:
    """Bounds of axis and pivot along the pull; None where nothing was solved.

    Filled dots are what a stretch told, open ones what was expected of it a stretch before, the
    dashed line is what the task needs.
    """
    known = [stretch for stretch in stretches if stretch.bounds is not None]
    if not known:
        return None
    pivots = any(s.bounds is not None and s.bounds.pivot_m is not None for s in known)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 4.6 if pivots else 2.9))
        rows = figure.subplots(2 if pivots else 1, 1, sharex=True, squeeze=False)[:, 0]
        _draw(rows[0], known, lambda b: float(np.rad2deg(b.axis_rad)), np.rad2deg(need.axis_rad))
        rows[0].set_ylabel("axis within [deg]")
        if pivots:
            _draw(rows[1], known, lambda b: 100.0 * (b.pivot_m or np.nan), 100.0 * need.pivot_m)
            rows[1].set_ylabel("pivot within [cm]")
        rows[-1].set_xlabel("way of the hand [cm]")
        rows[0].legend(fontsize=8, frameon=False)
        return as_svg(figure, "stretches")


def _draw(axes: Axes, stretches: Sequence[Stretch], value: Value, needed: float) -> None:
    x = [100.0 * stretch.travel_m for stretch in stretches]
    told = [_of(stretch.bounds, value) for stretch in stretches]
    axes.plot(x, told, "o-", color=ESTIMATE, label="told (95 % bound)")
    expected = [_of(stretch.expected_next, value) for stretch in stretches[:-1]]
    if expected:
        axes.plot(x[1:], expected, "o", mfc="none", color=_EXPECTED, label="expected before")
    axes.axhline(needed, color=_NEEDED, ls="--", lw=1.0, label="needed")
    axes.set_yscale("log")


def _of(bounds: Bounds | None, value: Value) -> float:
    return float("nan") if bounds is None else value(bounds)
