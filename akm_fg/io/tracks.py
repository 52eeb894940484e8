"""Point tracks as ``.npz``: `points` (T, N, 3), and `cov` (T, N, 3, 3) or `sigma_m`."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError, OutputError
from akm_fg.records import FloatArray, PointTracks

NOMINAL_SIGMA_M = 1e-3  # unit of the covariance where the file gives no noise level
WHAT = "tracks as .npz: `points` (T, N, 3) in metres, NaN where lost, and `cov` or `sigma_m`"
SYMMETRY_TOLERANCE = 1e-6  # relative to the largest entry; float32 files stay below it

BROKEN = (
    OSError, ValueError, EOFError, KeyError, MemoryError, RuntimeError, NotImplementedError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What numpy and zipfile raise on files that are damaged, encrypted or hold pickles."""


@dataclass(frozen=True, slots=True)
class TracksInput:
    """Tracks, and whether their covariance is a measured one.

    Where `noise_known` is False, the covariance is NOMINAL_SIGMA_M^2 times identity, and only
    its scale relative to the true one is unknown.
    """

    tracks: PointTracks
    noise_known: bool
    notes: tuple[str, ...] = ()  # what reading them had to guess or leave out


def _load(path: Path) -> dict[str, NDArray[Any]]:
    if not path.exists():
        raise InputError(path, "does not exist", WHAT)
    if path.is_dir():
        raise InputError(path, "is a folder", WHAT)
    if not zipfile.is_zipfile(path):
        raise InputError(path, "is not an .npz archive, or is truncated", WHAT)
    arrays: dict[str, NDArray[Any]] = {}
    name = ""
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in {"points", "cov", "sigma_m"} & set(archive.files):
                arrays[name] = np.asarray(archive[name])
    except BROKEN as e:
        if "pickle" in str(e):
            raise InputError(path, f"`{name}` holds Python objects", f"numbers; {WHAT}") from e
        raise InputError(path, f"is damaged (`{name or 'archive'}` cannot be read)", WHAT) from e
    return arrays


def _numbers(path: Path, name: str, array: NDArray[Any]) -> FloatArray:
    if array.dtype.kind not in "fiu":
        raise InputError(path, f"`{name}` is of type {array.dtype}", "real numbers")
    return array.astype(np.float64)


def _points(path: Path, arrays: dict[str, NDArray[Any]]) -> FloatArray:
    if "points" not in arrays:
        raise InputError(path, "has no `points`", WHAT)
    points = _numbers(path, "points", arrays["points"])
    if points.ndim != 3 or points.shape[2] != 3 or points.shape[1] == 0:
        raise InputError(path, f"`points` has shape {points.shape}", "(T frames, N points, 3)")
    if points.shape[0] < 2:
        raise InputError(path, f"`points` has {points.shape[0]} frame(s)", "at least 2 frames")
    if np.isinf(points).any():
        t, n = (int(i) for i in np.argwhere(np.isinf(points))[0][:2])
        raise InputError(path, f"`points` is infinite in frame {t}, point {n}", "metres, or NaN")
    points[np.isnan(points).any(axis=-1)] = np.nan
    return points


def _from_sigma(path: Path, array: NDArray[Any], seen: NDArray[np.bool_]) -> FloatArray:
    sigma_m = _numbers(path, "sigma_m", array)
    if sigma_m.shape not in ((), (1,), seen.shape):
        expected = f"a number or shape {seen.shape}"
        raise InputError(path, f"`sigma_m` has shape {sigma_m.shape}", expected)
    sigma_m = np.broadcast_to(sigma_m, seen.shape)
    bad = np.asarray(seen & ~(np.isfinite(sigma_m) & (sigma_m > 0)))
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


def read_tracks(path: Path) -> TracksInput:
    """Read tracks; without `cov` and `sigma_m` their noise level is unknown.

    Raises:
        InputError: not an archive, damaged, pickles, or arrays that do not fit.
    """
    path = Path(path)
    arrays = _load(path)
    points = _points(path, arrays)
    seen = np.asarray(np.isfinite(points).all(axis=-1))
    if "cov" in arrays and "sigma_m" in arrays:
        raise InputError(path, "has both `cov` and `sigma_m`", "one of them")
    if "cov" in arrays:
        cov = _from_cov(path, arrays["cov"], seen)
    else:
        sigma_m = arrays.get("sigma_m", np.array(NOMINAL_SIGMA_M))
        cov = _from_sigma(path, sigma_m, seen)
    cov = np.where(seen[..., None, None], cov, np.nan)
    return TracksInput(PointTracks(points, cov), noise_known=bool({"cov", "sigma_m"} & set(arrays)))


def write_tracks(path: Path, tracks: PointTracks, noise_known: bool = True) -> None:
    """Write tracks with their covariances, or without them where the noise is not known.

    Raises:
        ValueError: the name does not end in .npz.
        OutputError: the place cannot be written.
    """
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"tracks go to a file that ends in .npz, not {path.name!r}")
    try:
        with path.open("wb") as file:
            if noise_known:
                np.savez_compressed(file, points=tracks.p_world, cov=tracks.cov_world)
            else:
                np.savez_compressed(file, points=tracks.p_world)
    except OSError as e:
        raise OutputError(f"{path}: cannot be written ({e.strerror})") from e
