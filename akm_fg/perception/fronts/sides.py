"""How a rectangular thing is turned in its plane, from the outline that is seen of it.

Boards that stand over on different sides, as fronts without handles do, make an outline of steps,
and some of it is not seen. The smallest rectangle around what is left leans: by 1.5 to 7 degrees
with four of five such doors of the kind in `furniture-dev`. Its edges still run along two
directions: the turn is taken at which the outline falls onto the fewest lines.
"""

from __future__ import annotations

import numpy as np

from akm_fg.records import FloatArray

LINE_M = 0.004  # width of a line: pixels at 1 m are 2.5 mm
COARSE_RAD, FINE_RAD = float(np.deg2rad(1.0)), float(np.deg2rad(0.1))


def turn_of_sides(outline_m: FloatArray) -> float:
    """By how much the sides are turned from the axes, rad, within an eighth of a turn.

    Args:
        outline_m: (N, 2) points of the outline, in the plane.
    """
    if len(outline_m) < 2:
        return 0.0
    coarse = np.arange(-np.pi / 4.0, np.pi / 4.0, COARSE_RAD)
    best = _sharpest(outline_m, coarse)
    return _sharpest(outline_m, best + np.arange(-COARSE_RAD, COARSE_RAD, FINE_RAD))


def _sharpest(outline_m: FloatArray, angles: FloatArray) -> float:
    score = [_sharpness(outline_m, angle) for angle in angles]
    best = np.flatnonzero(np.asarray(score) >= max(score) * (1.0 - 1e-9))
    return float(angles[best[np.abs(angles[best]).argmin()]])


def _sharpness(outline_m: FloatArray, angle: float) -> float:
    """Sum of the squares of how many points lie on each line along the two directions."""
    c, s = np.cos(angle), np.sin(angle)
    total = 0.0
    for across in (outline_m @ [c, s], outline_m @ [-s, c]):
        line = np.floor((across - across.min()) / LINE_M).astype(int)
        count = np.bincount(line, minlength=2).astype(float)
        # A line that two bins share counts as one.
        total += float(((count[:-1] + count[1:]) ** 2).sum())
    return total
