"""What is what in a tracker's archive: names, which axis is time, which points are lost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError
from akm_fg.records import BoolArray, FloatArray

POINTS = ("points", "tracks", "trajectories", "tracks_xyz", "coords")
VISIBLE = ("visible", "visibility", "visibilities", "visibs", "vis")
HIDDEN = ("occluded", "occlusion")
NOISE = ("cov", "sigma_m")
NAMES = (*POINTS, *VISIBLE, *HIDDEN, *NOISE)

LOST_AS = ((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (-1.0, -1.0, -1.0))
"""Coordinates that stand for no coordinates; to the last bit no point is measured there."""
SEEN_FROM = 0.5  # of a visibility that is a probability
ROUGHER = 5.0
"""Steps along the axis of points, over steps along time, that are beyond doubt."""
STIFFER = 3.0  # distances that change so much less settle what steps say otherwise
PAIRS = 64  # of points, whose distances are compared


@dataclass(frozen=True, slots=True)
class Layout:
    """Points with time first, and how others of the file's arrays get there."""

    points: FloatArray  # (T, N, 3), NaN where lost
    swapped: bool  # the file has points first
    notes: tuple[str, ...]


def layout_of(path: Path, name: str, raw: FloatArray, arrays: dict[str, NDArray[Any]]) -> Layout:
    """Points with time first and NaN where they are lost, and what was guessed.

    Args:
        path: of the file, for messages.
        name: of the array of points.
        raw: (T, N, 3) or (N, T, 3), maybe with NaN.
        arrays: of the file.

    Raises:
        InputError: a visibility that does not fit.
    """
    points = raw.copy()
    notes = []
    named = np.zeros(points.shape[:2], dtype=bool)
    for lost in LOST_AS:
        named |= (points == lost).all(axis=-1)
    points[named | np.isnan(points).any(axis=-1)] = np.nan
    swapped = _points_first(points)
    if swapped:
        n, t = points.shape[:2]
        notes.append(f"`{name}` of shape {raw.shape} was read as {n} points through {t} frames")
        points = points.swapaxes(0, 1)
    mask, mask_notes = _visible(path, arrays, points.shape[:2], swapped)
    notes += mask_notes
    seen = np.isfinite(points).all(axis=-1)
    if named.any():
        notes.append(f"{int(named.sum())} points at exactly 0 or -1 were taken as lost")
    if mask is not None:
        hidden = int((seen & ~mask).sum())
        if hidden:
            notes.append(f"{hidden} points that are not visible were left out")
        points[~mask] = np.nan
    return Layout(points, swapped, tuple(notes))


def _steps(points: FloatArray, axis: int) -> tuple[float, float]:
    """Median and rms of the steps along an axis; NaN where there are none."""
    d = np.linalg.norm(np.diff(points, axis=axis), axis=-1)
    d = d[np.isfinite(d)]
    return (np.nan, np.nan) if not d.size else (float(np.median(d)), float(np.sqrt((d**2).mean())))


def _points_first(points: FloatArray) -> bool:
    """Whether axis 0 counts points: time is the axis along which things move smoothly.

    A tracker that follows a dense grid has near neighbours too; but a rigid part keeps its
    points' distances through time, and not the distances that times have from point to point.
    """
    first, second = _steps(points, 0), _steps(points, 1)
    if not all(a > ROUGHER * b for a, b in zip(first, second, strict=True)):
        return False
    return not _looseness(points) * STIFFER < _looseness(points.swapaxes(0, 1))


def _looseness(points: FloatArray) -> float:
    """Median relative change through axis 0 of the distances between neighbours in axis 1."""
    pick = np.unique(np.linspace(0, points.shape[1] - 1, PAIRS).astype(int))
    some = points[:, pick]
    distances = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1)
    upper = distances[:, *np.triu_indices(len(pick), 1)]
    upper = upper[:, np.isfinite(upper).sum(axis=0) >= 2]
    mean = np.nanmean(upper, axis=0) if upper.size else np.empty(0)
    if not (mean > 0).any():
        return 0.0
    return float(np.median(np.nanstd(upper, axis=0)[mean > 0] / mean[mean > 0]))


def _visible(
    path: Path, arrays: dict[str, NDArray[Any]], shape: tuple[int, ...], swapped: bool
) -> tuple[BoolArray | None, list[str]]:
    """(T, N), True where a point is seen; None where the file does not say."""
    names = [name for name in (*VISIBLE, *HIDDEN) if name in arrays]
    if not names:
        return None, []
    if len(names) > 1:
        raise InputError(path, f"has both `{names[0]}` and `{names[1]}`", "one of them")
    (name,) = names
    values = arrays[name]
    if values.dtype.kind not in "bfiu":
        raise InputError(path, f"`{name}` is of type {values.dtype}", "truth values, or 0 and 1")
    values = np.squeeze(values.astype(np.float64), tuple(_ones(values.shape, len(shape))))
    notes = []
    fits, other = values.shape == shape, values.shape == shape[::-1]
    if not fits and not other:
        problem = f"`{name}` has shape {arrays[name].shape}"
        raise InputError(path, problem, f"one value a frame and point, {tuple(shape)}")
    if not fits or (other and swapped):
        values = values.T
    if not ((values >= 0) & (values <= 1)).all():
        problem = f"`{name}` holds {float(np.abs(values).max()):.3g}"
        raise InputError(path, problem, "truth values, 0 and 1, or probabilities")
    if ((values > 0) & (values < 1)).any():
        notes.append(f"`{name}` holds probabilities; above {SEEN_FROM} was taken as true")
    true = values > SEEN_FROM
    return (true if name in VISIBLE else ~true), notes


def _ones(shape: tuple[int, ...], wanted: int) -> list[int]:
    """Axes of length 1, from the outside, that a tracker's batch or channel has too many."""
    ones = [i for i, n in enumerate(shape) if n == 1]
    return ones[: max(len(shape) - wanted, 0)]
