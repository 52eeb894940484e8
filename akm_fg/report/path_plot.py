"""Paths of points in the frame of their joint: along its axis, and from the side."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from akm_fg.posterior import JointPosterior
from akm_fg.records import FloatArray
from akm_fg.report.plots import ESTIMATE, STYLE, as_svg
from akm_fg.report.summary import RunSummary

MAX_PATHS = 60  # more are a smear, and a page of megabytes
MAX_FRAMES = 400
_POINTS = "#3367a8"


def paths_svg(summary: RunSummary) -> str | None:
    """Two views of where points went, the axis at the origin.

    Returns:
        An <svg> element, or None where the run has images or no joint.
    """
    joint = summary.posterior.best.joint if summary.posterior is not None else None
    if summary.paths is None or joint is None:
        return None
    p_joint = _in_joint(_some(summary.paths.p_world), joint)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 6.4))
        along, side = figure.subplots(2, 1)
        for axes, (i, j), words in (
            (along, (0, 1), "along the axis"),
            (side, (2, 0), "from the side"),
        ):
            for n in range(p_joint.shape[1]):
                axes.plot(p_joint[:, n, i], p_joint[:, n, j], "-", color=_POINTS, lw=0.8, alpha=0.7)
                axes.plot(p_joint[:, n, i], p_joint[:, n, j], ".", color=_POINTS, ms=2)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_title(words, fontsize=10)
            axes.set_xlabel("along the axis [m]" if i == 2 else "across [m]")
            axes.set_ylabel("across [m]")
        if joint.turns:
            along.plot(0, 0, "o", color=ESTIMATE)
        side.axhline(0, color=ESTIMATE, lw=1.5, ls="-" if joint.turns else ":")
        return as_svg(figure, "paths")


def _some(p_world: FloatArray) -> FloatArray:
    """(T, N, 3) thinned evenly to what a plot can show."""
    frames, points = (
        np.unique(np.linspace(0, size - 1, most).astype(int))
        for size, most in zip(p_world.shape[:2], (MAX_FRAMES, MAX_PATHS), strict=True)
    )
    return p_world[np.ix_(frames, points)]


def _in_joint(p_world: FloatArray, joint: JointPosterior) -> FloatArray:
    """(T, N, 3) with z along the axis, from the pivot or from where a sliding part began."""
    T = joint.T_world_joint
    seen = p_world[np.isfinite(p_world).all(axis=-1)]
    origin = T[:3, 3] if joint.turns or not len(seen) else seen[0]
    return np.asarray((p_world - origin) @ T[:3, :3])
