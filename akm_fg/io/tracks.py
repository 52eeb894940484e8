"""Point tracks as ``.npz``: `points` (T, N, 3), and `cov` (T, N, 3, 3) or `sigma_m`.

Files of trackers are read too: other names, points first, masks of what is visible, lost points
as 0 or -1, millimetres. What was guessed is said (docs/conventions.md).
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError
from akm_fg.io.arrays.layout import NAMES, POINTS, Layout, layout_of
from akm_fg.io.arrays.npz import MAX_NUMBERS, load_arrays, names_in
from akm_fg.io.png import replace_file
from akm_fg.io.read_options import (
    LARGEST_EXTENT_M,
    LARGEST_NUMBER,
    METRES_A_UNIT,
    MIDDLE_PER_CENT,
    ReadOptions,
    extent_of,
    guessed_unit,
)
from akm_fg.records import FloatArray, PointTracks

NOMINAL_SIGMA_M = 1e-3  # unit of the covariance where the file gives no noise level
WHAT = "tracks as .npz: `points` (T, N, 3) in metres, NaN where lost, and `cov` or `sigma_m`"
SIGMA_RANGE_M = (1e-9, 1e6)  # of noise that can be squared and inverted
SYMMETRY_TOLERANCE = 1e-6  # relative to the largest entry; float32 files stay below it


@dataclass(frozen=True, slots=True)
class TracksInput:
    """Tracks, and whether their covariance is a measured one.

    Where `noise_known` is False, the covariance is NOMINAL_SIGMA_M^2 times identity, and only
    its scale relative to the true one is unknown.
    """

    tracks: PointTracks
    noise_known: bool
    notes: tuple[str, ...] = ()  # what reading them had to guess or leave out


def _numbers(path: Path, name: str, array: NDArray[Any]) -> FloatArray:
    if array.dtype.kind not in "fiu":
        raise InputError(path, f"`{name}` is of type {array.dtype}", "real numbers")
    return array.astype(np.float64)


def _points(path: Path, arrays: dict[str, NDArray[Any]]) -> tuple[str, FloatArray]:
    """Name and numbers of the points, (T, N, 3) or (N, T, 3), finite or NaN."""
    names = [name for name in POINTS if name in arrays]
    if not names:
        held = ", ".join(f"`{name[:30]}`" for name in names_in(path)[:5]) or "nothing"
        raise InputError(path, f"has no `points`, it holds {held}", WHAT)
    if len(names) > 1:
        raise InputError(path, f"has both `{names[0]}` and `{names[1]}`", "one of them")
    (name,) = names
    points = _numbers(path, name, arrays[name])
    if arrays[name].dtype.itemsize == 1:  # hold no millimetres: a picture, or numbers cut off
        problem = f"`{name}` is of type {arrays[name].dtype}"
        raise InputError(path, problem, "metres, or millimetres in 16 bits or more")
    if points.ndim == 4 and points.shape[0] == 1:
        points = points[0]  # trackers write a batch of one
    if points.ndim != 3 or points.shape[2] != 3 or points.shape[1] == 0:
        flat = points.ndim == 3 and points.shape[2] == 2
        hint = ", looks like pixels without depth" if flat else ""
        problem = f"`{name}` has shape {arrays[name].shape}{hint}"
        raise InputError(path, problem, "(T frames, N points, 3)")
    if points.shape[0] < 2:
        raise InputError(path, f"`{name}` has {points.shape[0]} frame(s)", "at least 2 frames")
    if points.size > MAX_NUMBERS:
        raise InputError(
            path, f"`{name}` has shape {points.shape}", f"at most {MAX_NUMBERS} numbers"
        )
    if (np.abs(points) > LARGEST_NUMBER).any():
        t, n, c = (int(i) for i in np.argwhere(np.abs(points) > LARGEST_NUMBER)[0])
        is_what = "infinite" if np.isinf(points[t, n, c]) else f"{points[t, n, c]:.3g}"
        problem = f"`{name}` is {is_what} in frame {t}, point {n}"
        raise InputError(path, problem, "metres, or NaN")
    return name, points


def _in_metres(
    path: Path, name: str, layout: Layout, options: ReadOptions
) -> tuple[FloatArray, float, tuple[str, ...]]:
    """Points in metres, metres a unit, and what was guessed."""
    seen = layout.points[np.isfinite(layout.points).all(axis=-1)]
    if not len(seen):
        return layout.points, 1.0, ()
    flat = extent_of(seen[:, :2])
    low, high = (float(z) for z in np.percentile(seen[:, 2], MIDDLE_PER_CENT))
    if options.unit is None and flat > LARGEST_EXTENT_M and 0 < low and high <= LARGEST_EXTENT_M:
        problem = (
            f"`{name}` spans {flat:.3g} in x and y, with z from {low:.3g} to {high:.3g}: "
            "likely pixels and depth"
        )
        raise InputError(path, problem, "x, y and z in metres (or --unit m or mm)")
    unit, notes = guessed_unit(extent_of(seen), options)
    return layout.points * METRES_A_UNIT[unit], METRES_A_UNIT[unit], notes


def _from_sigma(path: Path, array: NDArray[Any], seen: NDArray[np.bool_]) -> FloatArray:
    sigma_m = _numbers(path, "sigma_m", array)
    if sigma_m.shape not in ((), (1,), seen.shape):
        expected = f"a number or shape {seen.shape}"
        raise InputError(path, f"`sigma_m` has shape {sigma_m.shape}", expected)
    sigma_m = np.broadcast_to(sigma_m, seen.shape)
    least, largest = SIGMA_RANGE_M
    bad = np.asarray(seen & ~((sigma_m >= least) & (sigma_m <= largest)))
    if bad.any():
        t, n = (int(i) for i in np.argwhere(bad)[0])
        problem = f"`sigma_m` is {sigma_m[t, n]:g} in frame {t}, point {n}"
        raise InputError(path, problem, "a finite number above 0 wherever a point is seen")
    return sigma_m[..., None, None] ** 2 * np.eye(3)


def _from_cov(path: Path, array: NDArray[Any], seen: NDArray[np.bool_]) -> FloatArray:
    cov = _numbers(path, "cov", array)
    if cov.shape != (*seen.shape, 3, 3):
        raise InputError(path, f"`cov` has shape {cov.shape}", f"{(*seen.shape, 3, 3)}")
    where = np.argwhere(seen)
    c = cov[seen]
    finite = np.asarray(np.isfinite(c).all(axis=(1, 2)))
    c = np.where(finite[:, None, None], c, np.eye(3))
    scale = np.abs(c).max(axis=(1, 2))
    skew = np.abs(c - c.transpose(0, 2, 1)).max(axis=(1, 2))
    lowest = np.linalg.eigvalsh(c)[:, 0]
    checks = (
        (~finite, "is not finite"),
        (skew > SYMMETRY_TOLERANCE * scale, "is not symmetric"),
        (lowest <= 0, "is not positive definite"),
    )
    for bad, problem in checks:
        if bad.any():
            t, n = (int(i) for i in where[np.argmax(bad)])
            expected = "a symmetric positive definite 3x3 wherever a point is seen, m^2"
            raise InputError(path, f"`cov` {problem} in frame {t}, point {n}", expected)
    return (cov + cov.swapaxes(-1, -2)) / 2


def read_tracks(path: Path, options: ReadOptions | None = None) -> TracksInput:
    """Read tracks; without `cov` and `sigma_m` their noise level is unknown.

    `cov` is in the square of the unit of the points, `sigma_m` in metres.

    Raises:
        InputError: not an archive, damaged, pickles, too large, or arrays that do not fit.
    """
    path, options = Path(path), options or ReadOptions()
    arrays = load_arrays(path, NAMES, WHAT)
    name, raw = _points(path, arrays)
    layout = layout_of(path, name, raw, arrays)
    points, metres_a_unit, unit_notes = _in_metres(path, name, layout, options)
    if layout.swapped:
        arrays |= {k: _time_first(arrays[k], raw.shape) for k in ("cov", "sigma_m") if k in arrays}
    seen = np.asarray(np.isfinite(points).all(axis=-1))
    if "cov" in arrays and "sigma_m" in arrays:
        raise InputError(path, "has both `cov` and `sigma_m`", "one of them")
    if "cov" in arrays:
        cov = _from_cov(path, arrays["cov"], seen) * metres_a_unit**2
    else:
        sigma_m = arrays.get("sigma_m", np.array(NOMINAL_SIGMA_M))
        cov = _from_sigma(path, sigma_m, seen)
    cov = np.where(seen[..., None, None], cov, np.nan)
    known = bool({"cov", "sigma_m"} & set(arrays))
    return TracksInput(PointTracks(points, cov), known, (*layout.notes, *unit_notes))


def _time_first(array: NDArray[Any], points: tuple[int, ...]) -> NDArray[Any]:
    """An array of the file whose points come first, where it is laid out as they are."""
    return array.swapaxes(0, 1) if array.ndim >= 2 and array.shape[:2] == points[:2] else array


def write_tracks(path: Path, tracks: PointTracks, noise_known: bool = True) -> None:
    """Write tracks in one step, with their covariances or without where the noise is not known.

    Raises:
        ValueError: the name does not end in .npz.
        OutputError: the place cannot be written.
    """
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"tracks go to a file that ends in .npz, not {path.name!r}")
    cov = {"cov": tracks.cov_world} if noise_known else {}
    packed = io.BytesIO()
    np.savez_compressed(packed, points=tracks.p_world, **cov)  # type: ignore[arg-type]
    replace_file(path, packed.getvalue())
