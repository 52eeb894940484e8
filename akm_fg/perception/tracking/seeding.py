"""Chooses which pixels of the object to follow, and new ones where old ones are gone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.interfaces import PointTracker
from akm_fg.perception.depth.depth_edges import near_depth_edge
from akm_fg.records import BoolArray, FloatArray, PixelTracks, RgbdFrame

SOBEL_GAIN = 8.0  # of the 3 x 3 operator: gray levels a pixel
CORNER_WINDOW_PX = 7
PEAK_PX = 2  # around a corner, its own slope
RESEED_CELLS = 1.5  # seeds of neighbouring cells are up to two cells apart: no hole between them
CELL_SHRINK = 0.75


@dataclass(frozen=True, slots=True)
class SeedingConfig:
    """How many seeds, and where not."""

    number: int = 300  # on the object in the first frame; the paper follows 1000
    min_spacing_px: float = 5.0  # closer points share most of their patch
    edge_margin_px: int = 4  # from a depth edge, where depth is wrong; texture is often near it
    edge_m: float = 0.02  # depth step that counts as an edge
    max_slope: float = 3.0  # tangent between ray and normal, 72 deg: steeper ones cannot be lifted
    min_corner: float = 0.1  # smaller eigenvalue of the mean gradient tensor, (gray levels / px)^2
    min_frames_left: int = 3  # a track that starts later says nothing about motion


def _seedable(frame: RgbdFrame, mask: BoolArray, config: SeedingConfig) -> BoolArray:
    """(H, W) where the object has depth, is not seen edge-on, and no depth edge is near."""
    known = np.isfinite(frame.depth_m)
    wide = np.ones((2 * config.edge_margin_px + 1,) * 2, np.uint8)
    near_edge = near_depth_edge(frame.depth_m, config.edge_m, config.edge_margin_px)
    far = np.float32(1e3)  # beyond every reading: holes neither raise nor lower their neighbours
    square = np.ones((3, 3), np.uint8)
    high = cv2.dilate(np.where(known, frame.depth_m, -far), square)
    low = cv2.erode(np.where(known, frame.depth_m, far), square)
    steep = high - low > config.edge_m + 2 * config.max_slope / frame.camera.fx * frame.depth_m
    near_edge |= cv2.dilate((~mask | steep).astype(np.uint8), wide) > 0
    return np.asarray(mask & known & ~near_edge)


def seed_points(
    frame: RgbdFrame,
    mask: BoolArray,
    rng: np.random.Generator,
    config: SeedingConfig | None = None,
    taken_uv: FloatArray | None = None,
) -> FloatArray:
    """Pixels (N, 2) spread over the object, the best corner of each cell of a grid.

    A cell without texture gives none: nothing there could be found again. On plain objects the
    grid gets finer, so that the wanted number may still come from the few places with texture.
    Pixels within RESEED_CELLS cells of one of `taken_uv` are left out.

    Args:
        frame: where to seed.
        mask: (H, W) True on the object.
        rng: shifts the grid.
        config: number and distances.
        taken_uv: (M, 2) pixels that are followed already.
    """
    config = config or SeedingConfig()
    free = _seedable(frame, mask, config)
    if not free.any():
        return np.empty((0, 2))
    cell = max(config.min_spacing_px, float(np.sqrt(free.sum() / config.number)))
    if taken_uv is not None and len(taken_uv):
        free &= _distance_to(taken_uv, free.shape) > RESEED_CELLS * cell
    gray = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)
    slope = np.asarray(gray, dtype=np.float32) / SOBEL_GAIN
    corner = np.where(free, cv2.cornerMinEigenVal(slope, CORNER_WINDOW_PX), 0)
    v, u = np.nonzero(corner > config.min_corner)
    if not u.size:
        return np.empty((0, 2))
    uv, strength = np.stack([u, v], axis=-1), corner[v, u]
    peaks = _peaks(corner)[v, u]
    uv, strength = uv[peaks], strength[peaks]
    wanted = config.number * (free.sum() / max(int(mask.sum()), 1))
    shift = rng.uniform(0, 1, 2)
    while True:
        best = _best_of_cells(uv, strength, shift * cell, cell)
        if len(best) >= wanted or cell <= config.min_spacing_px:
            return uv[best].astype(np.float64)
        cell = max(config.min_spacing_px, CELL_SHRINK * cell)


def _peaks(corner: NDArray[np.floating]) -> BoolArray:
    """(H, W) no stronger corner next to it: cells that meet at one would all choose it."""
    side = 2 * PEAK_PX + 1
    return np.asarray(corner >= cv2.dilate(corner, np.ones((side, side), np.uint8)))


def _best_of_cells(
    uv: NDArray[np.int_], strength: NDArray[np.floating], shift: FloatArray, cell: float
) -> NDArray[np.int_]:
    """Index of the strongest pixel of each cell of a grid."""
    index = np.floor((uv + shift) / cell).astype(int)
    number = index[:, 1] * (index[:, 0].max() + 1) + index[:, 0]
    order = np.lexsort((-strength, number))
    return np.asarray(order[np.unique(number[order], return_index=True)[1]])


def _distance_to(uv: FloatArray, size: tuple[int, ...]) -> NDArray[np.float32]:
    """(H, W) distance of every pixel to the nearest of the pixels (M, 2)."""
    whole = np.rint(uv[np.isfinite(uv).all(axis=1)]).astype(int)
    elsewhere = np.ones(size, np.uint8)
    inside = (whole >= 0).all(axis=1) & (whole[:, 0] < size[1]) & (whole[:, 1] < size[0])
    elsewhere[whole[inside, 1], whole[inside, 0]] = 0
    return np.asarray(cv2.distanceTransform(elsewhere, cv2.DIST_L2, 5), dtype=np.float32)


def track_object(
    frames: Sequence[RgbdFrame],
    masks: Mapping[int, BoolArray],
    tracker: PointTracker,
    rng: np.random.Generator,
    config: SeedingConfig | None = None,
) -> PixelTracks:
    """Follow the object through a clip, with new seeds where it is not covered.

    Args:
        frames: the clip.
        masks: the object (H, W) by frame number; seeds are set in these frames. The first of
            them seeds the whole object, each later one what no track covers there.
        tracker: the backend.
        rng: shifts the grids.
        config: number and distances.

    Raises:
        ValueError: no mask, or one of a frame that is not there.
    """
    config = config or SeedingConfig()
    if not masks or min(masks) < 0 or max(masks) >= len(frames):
        raise ValueError(f"masks for frames {sorted(masks)}, expected some of 0..{len(frames) - 1}")
    first = min(masks)

    def new_queries(t: int, taken_uv: FloatArray) -> FloatArray:
        if t not in masks or (t > first and len(frames) - t < config.min_frames_left):
            return np.empty((0, 2))
        return seed_points(frames[t], masks[t], rng, config, taken_uv)

    return tracker.track(frames, np.empty((0, 2)), [], new_queries)
