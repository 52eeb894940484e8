"""Is the depth in metres, and of the same time as the colours?

Where an edge of the part passes over a pixel, depth steps and colour changes in the same frame.
Pixels that an edge uncovers show what stands still from then on; pixels that it covers did so until
then: either way the change of colour has a frame of its own, however the part is painted. A seam
between depth and colour at an edge makes one kind late and the other early: both must agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import Doubt, RgbdFrame


@dataclass(frozen=True, slots=True)
class DepthAgainstColourConfig:
    """What is plausible."""

    nearest_m: float = 0.05  # median depth: no RGB-D camera sees what is nearer
    farthest_m: float = 30.0  # nor a room that is larger
    stride_px: int = 2  # of the pixels asked, of a picture of 640
    step_m: float = 0.05  # of depth at an edge that passes
    still_m: float = 0.02  # by which depth may waver where nothing passes
    gray: float = 15.0  # levels; a change of colour
    least_pixels: int = 30  # of either kind
    largest_lag: int = 3  # frames
    agreeing: float = 0.5  # share of the pixels of either kind with the same lag
    in_step: float = 0.2  # of the pixels, whose depth and colour change together nevertheless


def depth_unit_doubts(
    frame: RgbdFrame, config: DepthAgainstColourConfig | None = None
) -> list[Doubt]:
    """About the unit of a frame's depth."""
    config = config or DepthAgainstColourConfig()
    known = frame.depth_m[np.isfinite(frame.depth_m)]
    if not known.size:
        return []
    middle_m = float(np.median(known))
    if config.nearest_m <= middle_m <= config.farthest_m:
        return []
    expected = f"{config.nearest_m:g} to {config.farthest_m:g} m"
    return [
        Doubt(
            f"half of the first picture is nearer than {middle_m:.3g} m: the unit of depth "
            f"(depth_unit_m) is likely wrong; expected {expected}"
        )
    ]


def lag_doubts(
    frames: Sequence[RgbdFrame], config: DepthAgainstColourConfig | None = None
) -> list[Doubt]:
    """About the times of depth and colour, of frames that follow on each other in one place."""
    config = config or DepthAgainstColourConfig()
    lag = depth_lag(frames, config)
    if not lag:
        return []
    count, late = abs(lag), "late" if lag > 0 else "early"
    plural = "frame" if count == 1 else "frames"
    return [
        Doubt(
            f"depth is {count} {plural} {late}: it steps so long "
            f"{'after' if lag > 0 else 'before'} the colours of the same pixels change; "
            "expected depth and colour of the same time"
        )
    ]


def depth_lag(frames: Sequence[RgbdFrame], config: DepthAgainstColourConfig) -> int | None:
    """By how many frames depth follows the colours; None where no edge tells."""
    if len(frames) < 2 * config.largest_lag:
        return None
    step = max(1, round(config.stride_px * frames[0].depth_m.shape[1] / 640))
    z = np.stack([f.depth_m[::step, ::step] for f in frames])
    rgb = (np.ascontiguousarray(f.rgb[::step, ::step]) for f in frames)
    gray = np.array([cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in rgb], dtype=np.uint8)
    covered = _lags(z, gray, config)
    uncovered = -_lags(z[::-1], gray[::-1], config)  # backwards in time an edge covers them
    if min(covered.size, uncovered.size) < config.least_pixels:
        return None
    values, counts = np.unique(np.concatenate([covered, uncovered]), return_counts=True)
    best = int(values[counts.argmax()])
    for lags in (covered, uncovered):
        together = float((lags == 0).mean())
        if (lags == best).mean() < config.agreeing or (best and together > config.in_step):
            return None
    return best


def _lags(
    z: NDArray[np.float32], gray: NDArray[np.uint8], config: DepthAgainstColourConfig
) -> NDArray[np.int_]:
    """Lags (n,) of pixels that stood still until an edge covered them, of (T, h, w) images.

    A frame between whose predecessor and itself something steps is called by its own number.
    """
    T = len(z)
    with np.errstate(invalid="ignore"):
        off = np.abs(z - z[0])
        some = (off > config.step_m).any(axis=0)  # few pixels step at all
        off = off[:, some]
        rested = np.logical_and.accumulate(off < config.still_m, axis=0)  # NaN: False
        stepped = rested[:-1] & (off[1:] > config.step_m)
    shades = gray[:, some].astype(np.float32)
    other = np.abs(shades - shades[0]) > config.gray
    first_other = np.where(other.any(axis=0), other.argmax(axis=0), T)
    found = [np.zeros(0, dtype=int)]
    for t in range(1, T):
        lag = t - first_other[stepped[t - 1]]
        found.append(lag[np.abs(lag) <= config.largest_lag])
    return np.concatenate(found)
