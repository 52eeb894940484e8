"""Paths of points: their local noise, and which frames tell most about them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from akm_fg.records import FloatArray

_CLOCK_SHARE = 0.2  # of the keyframes that are spread over time, so that rests are not lost


def local_noise(path: FloatArray) -> float:
    """Noise (m, each coordinate) of a path (T, 3) that no smooth motion explains.

    From second differences, whose variance is six times that of the noise; a median, so that
    outliers and rests do not count.
    """
    if path.shape[0] < 4:
        return 0.0
    second = np.abs(path[2:] - 2 * path[1:-1] + path[:-2])
    return float(1.4826 * np.median(second) / np.sqrt(6))


def select_keyframes(path: FloatArray, frames: NDArray[np.int_], count: int) -> NDArray[np.int_]:
    """At most `count` of `frames`, spread along the path (K, 3) walked; first and last in.

    Nearly evenly in space, not in time: systematic errors depend on the place, and frames at
    rest repeat one of them.
    """
    if frames.size <= count:
        return frames
    step = np.linalg.norm(np.diff(path, axis=0), axis=1)
    step = np.minimum(step, np.quantile(step, 0.99))  # one outlier is not a journey
    walked = np.concatenate([[0.0], np.cumsum(step)])
    clock = np.linspace(0, _CLOCK_SHARE, frames.size)
    progress = walked / max(walked[-1], 1e-12) + clock
    wanted = np.linspace(0, progress[-1], count)
    return frames[np.unique(np.searchsorted(progress, wanted - 1e-9).clip(0, frames.size - 1))]
