"""What comes between two fingers that close at a pose, as far as a camera sees it.

The pads' faces are planes across the gripper's y. What they close on is the run of points about
y = 0 within the pads' width; its two ends, as functions of x, are the lines along which the pads
touch. Two contacts are antipodal where the line between them lies in both friction cones: where the
ends run along x within the friction angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.records import FloatArray


@dataclass(frozen=True, slots=True)
class FingerShape:
    """The Franka hand's, in its gripper's frame."""

    pad_half_m: float = 0.0087  # half width of a pad, along x
    tip_m: float = 0.0072  # from the grasp point to the fingertips, along z
    open_half_m: float = 0.040  # from the middle to a pad of the open hand
    palm_m: float = 0.039  # from the grasp point back to the palm


@dataclass(frozen=True, slots=True)
class ClosingConfig:
    """How a cloud is read."""

    above_m: float = 0.015  # of the contact, along the approach, still belongs to what is held
    below_m: float = 0.010  # of its outer side: so deep it is looked at
    run_m: float = 0.005  # between neighbouring points of a run, or so many pixels:
    run_px: float = 2.5
    off_m: float = 0.012  # of y = 0: the run passes no farther from the contact
    bins: int = 5  # along x
    least_points: int = 6
    widest_m: float = 0.068  # of what the open hand goes around, with room for noise
    thinnest_m: float = 0.003


@dataclass(frozen=True, slots=True)
class Closing:
    """What the fingers close on."""

    y_m: float  # middle of it, in the gripper's frame
    z_m: float  # its outer side
    width_m: float
    covered: float  # share of the pads' width along which there is something
    slope_rad: float  # the larger angle between x and a line along which a pad touches
    taper_rad: float  # angle between both lines
    points: int
    beside: int  # points of other things between the open fingers, as deep as the fingertips


def closing(
    p_gripper: FloatArray, pixel_m: float, fingers: FingerShape, config: ClosingConfig
) -> Closing | None:
    """What is between the fingers; None: nothing, or more than they can go around.

    Args:
        p_gripper: (N, 3) points, with the contact at the origin.
        pixel_m: between neighbouring points.
        fingers: of the hand.
        config: tuning.
    """
    beyond = fingers.open_half_m + config.off_m  # a run that goes on so far is no thin thing
    between = (np.abs(p_gripper[:, 0]) < fingers.pad_half_m) & (np.abs(p_gripper[:, 1]) < beyond)
    p = p_gripper[between & (p_gripper[:, 2] > -config.above_m - config.off_m)]
    middle = p[(np.abs(p[:, 1]) < config.off_m) & (np.abs(p[:, 2]) < config.above_m)]
    if len(middle) < config.least_points:
        return None
    top = float(np.quantile(middle[:, 2], 0.3))
    p = p[p[:, 2] < top + config.below_m]
    run, rest = _run(p, max(config.run_m, config.run_px * pixel_m), config.off_m)
    if len(run) < config.least_points:
        return None
    if np.abs(run[:, 1]).max() > fingers.open_half_m:
        return None
    low, high = np.quantile(run[:, 1], [0.02, 0.98])
    width = float(high - low) + pixel_m
    if not config.thinnest_m < width < config.widest_m:
        return None
    lines = _lines(run, fingers.pad_half_m, config.bins)
    if lines is None:
        return None
    covered, slopes = lines
    return Closing(
        y_m=float(low + high) / 2.0,
        z_m=top,
        width_m=width,
        covered=covered,
        slope_rad=float(np.abs(slopes).max()),
        taper_rad=float(abs(slopes[0] - slopes[1])),
        points=len(run),
        beside=int((np.abs(rest[:, 1]) < fingers.open_half_m).sum()),
    )


def _run(p: FloatArray, gap_m: float, off_m: float) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) of the run along y that passes nearest to y = 0, and the others."""
    order = np.argsort(p[:, 1])
    y = p[order, 1]
    label = np.concatenate([[0], np.cumsum(np.diff(y) > gap_m)]) if len(y) else np.zeros(0)
    nearest = int(np.abs(y).argmin()) if len(y) else 0
    if not len(y) or abs(y[nearest]) > off_m:
        return p[:0], p
    mine = label == label[nearest]
    return p[order[mine]], p[order[~mine]]


def _lines(run: FloatArray, half_m: float, bins: int) -> tuple[float, FloatArray] | None:
    """Share of the bins along x with points; slopes (2,) of the run's ends as functions of x."""
    edges = np.linspace(-half_m, half_m, bins + 1)
    at = np.clip(np.digitize(run[:, 0], edges) - 1, 0, bins - 1)
    filled = [i for i in range(bins) if (at == i).any()]
    if len(filled) < 2:
        return None
    x = (edges[:-1] + edges[1:])[filled] / 2.0
    ends = np.array([[run[at == i, 1].min(), run[at == i, 1].max()] for i in filled])
    slopes = np.polyfit(x, ends, 1)[0]
    return len(filled) / bins, np.arctan(slopes)
