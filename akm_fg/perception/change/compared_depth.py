"""Two depth images held against each other, pixel by pixel, where either may have holes.

Means over small windows are compared, over the pixels that both images know: of a slanted surface
other pixels have other depths. Dark and shiny surfaces lose depth in patches, in each frame others:
a hole counts as changed where the readings around it are. What the first frame does not know, later
ones may show: the farthest that several of them agree on lies behind whatever moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.change.change_config import DepthChangeConfig
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import BoolArray, FloatArray

Depth = NDArray[np.float32]
_KERNEL = np.ones((3, 3), np.uint8)
_QUARTILE = 0.3186  # the lower one of |x| / sd of a Gaussian


@dataclass(frozen=True, slots=True)
class Comparison:
    """How much nearer a later image (h, w) is than a first one."""

    nearer_m: Depth  # means over windows; 0 where not judged
    own_nearer_m: Depth  # of the pixel alone: an edge smears the mean
    sd_m: Depth  # of a single reading, over the root of the share of the window that is known
    judged: BoolArray
    known: BoolArray  # in the later image
    depth_m: Depth  # of the later one, means over windows


def compared(
    first_m: Depth,
    now_m: Depth,
    fx: float,
    noise: DepthNoiseModel,
    config: DepthChangeConfig,
    first_variance: FloatArray | None = None,
) -> Comparison:
    """Compare two depth images (h, w), NaN where unknown.

    Args:
        first_m: what was there.
        now_m: what is seen.
        fx: focal length that the noise is meant for, pixels.
        noise: of single readings.
        config: tuning.
        first_variance: of the first's readings, m^2, for who compares many with it: see `variance`.
    """
    size, known = (config.window, config.window), np.isfinite(now_m)
    both = np.isfinite(first_m) & known
    a, b = (np.where(both, z, np.float32(0)) for z in (first_m, now_m))
    share = cv2.boxFilter(both.astype(np.float32), cv2.CV_32F, size)
    some = np.maximum(share, np.float32(1e-3))
    if first_variance is None:
        first_variance = variance(first_m, fx, noise)
    both_variance = np.where(both, first_variance + variance(b, fx, noise), 1.0)
    seen, of = (
        cv2.boxFilter(np.where(known, z, np.float32(0)), cv2.CV_32F, size)
        for z in (now_m, np.float32(1))
    )
    return Comparison(
        np.asarray(cv2.boxFilter(a - b, cv2.CV_32F, size) / some, np.float32),
        a - b,
        np.sqrt(both_variance.astype(np.float32) / some),
        both & (share >= config.least_known),
        known,
        np.asarray(seen / np.maximum(of, 1e-3), np.float32),
    )


def variance(depth_m: Depth, fx: float, noise: DepthNoiseModel) -> FloatArray:
    """Of single readings (h, w), m^2; NaN where unknown."""
    return np.asarray(noise.sigma_m(depth_m.astype(np.float64), fx) ** 2)


def gate_factor(
    last: Comparison, stride: int, noise: DepthNoiseModel, config: DepthChangeConfig
) -> float:
    """What counts as a change of a window's mean, over `Comparison.sd_m`.

    Where the means are worse than the model says, their own spread counts: that of the lower
    quartile of first against last frame, which stands still.
    """
    expected = 1 / np.sqrt(noise.independent_samples(stride * config.window))
    if last.judged.any():
        quartile = np.quantile(np.abs(last.nearer_m / last.sd_m)[last.judged], 0.25)
        expected = max(expected, float(quartile) / _QUARTILE)
    return float(config.sigmas * expected)


def changed(
    comparison: Comparison,
    sign: int,
    factor: float,
    touched: BoolArray,
    metres_a_px: float,
    config: DepthChangeConfig,
) -> tuple[BoolArray, float]:
    """Large connected changes (h, w) that touch something, with their holes, and their area, m^2.

    Args:
        comparison: of two images.
        sign: 1 for what came nearer, -1 for what went.
        factor: see `gate_factor`.
        touched: (h, w) what a change has to touch.
        metres_a_px: width of a pixel at one metre.
        config: tuning.
    """
    gate = np.float32(factor) * comparison.sd_m + np.float32(config.least_m)
    off, own = sign * comparison.nearer_m, sign * comparison.own_nearer_m
    those = comparison.judged & (off > gate) & (own > gate / 2)
    if not those.any():
        return those, 0.0
    whole = those | _holes_of(those, comparison.judged, config)
    opened = cv2.morphologyEx(whole.astype(np.uint8), cv2.MORPH_OPEN, _KERNEL)
    count, labels = cv2.connectedComponents(opened, connectivity=4)
    place = np.flatnonzero(opened)  # of some thousand pixels, of a hundred thousand
    flat, known = labels.ravel()[place], comparison.known.ravel()[place]
    metric = np.where(known, comparison.depth_m.ravel()[place] * metres_a_px, 0.0) ** 2
    seen = np.maximum(np.bincount(flat, known, count), 1.0)
    area = np.bincount(flat, metric, count) / seen * np.bincount(flat, minlength=count)  # holes too
    kept = (area > config.least_area_m2) & (np.bincount(flat, touched.ravel()[place], count) > 0)
    kept[0] = False
    those = np.zeros_like(those)
    those.ravel()[place] = kept[flat]
    return those, float(area[kept].sum())


def _holes_of(those: BoolArray, judged: BoolArray, config: DepthChangeConfig) -> BoolArray:
    """(h, w) not judged, while next to all that is judged around it has changed."""
    size = (config.around, config.around)
    votes, of = (
        cv2.boxFilter(mask.astype(np.float32), cv2.CV_32F, size) for mask in (those, judged)
    )
    return np.asarray(~judged & (votes > 0) & (votes >= config.agreeing * of))


def behind_what_moves(
    frames_m: Sequence[Depth], fx: float, noise: DepthNoiseModel, config: DepthChangeConfig
) -> Depth:
    """The first depth image (h, w); where that knows nothing, what later ones show farthest away.

    Args:
        frames_m: T images.
        fx: focal length that the noise is meant for, pixels.
        noise: of single readings.
        config: tuning.
    """
    first = frames_m[0].copy()
    v, u = np.nonzero(~np.isfinite(first))
    z = np.stack([image[v, u] for image in frames_m])
    known = np.isfinite(z)
    far = np.where(known, z, -np.inf).max(axis=0)
    with np.errstate(invalid="ignore"):
        gate = np.sqrt(2.0) * config.sigmas * noise.sigma_m(far, fx) + config.least_m
        agree = known & (far - z < gate)
    count = agree.sum(axis=0)
    enough = (count >= config.least_seen) & (count >= config.least_share * known.sum(axis=0))
    mean = np.where(agree, z, 0.0).sum(axis=0) / np.maximum(count, 1)
    first[v[enough], u[enough]] = mean[enough]
    return first
