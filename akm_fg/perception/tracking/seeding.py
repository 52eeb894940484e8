"""Chooses which pixels of the object to follow, and when to look for more."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.depth.depth_edges import near_depth_edge
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

SOBEL_GAIN = 8.0  # of the 3 x 3 operator: gray levels a pixel


@dataclass(frozen=True, slots=True)
class SeedingConfig:
    """How many seeds, and where not."""

    number: int = 300  # on the object in the first frame; the paper follows 1000
    min_spacing_px: float = 5.0  # closer points share most of their patch
    edge_margin_px: int = 4  # from a depth edge, where depth is wrong; texture is often near it
    edge_m: float = 0.02  # depth step that counts as an edge
    max_slope: float = 3.0  # tangent between ray and normal, 72 deg: steeper ones cannot be lifted
    min_corner: float = 0.1  # smaller eigenvalue of the mean gradient tensor, (gray levels / px)^2
    corner_window_px: int = 7  # over which the gradient tensor is averaged
    peak_px: int = 2  # around a corner: its own slope
    cell_shrink: float = 0.75  # of the grid's cells, until there are points enough
    # Cells from a followed point: seeds of neighbouring cells are up to two apart, no hole between.
    reseed_cells: float = 1.5
    reseed_gap: int = 5  # frames at least between seeds: each costs as much as following them
    reseed_growth: float = 0.5  # of the frames so far, after which new ones are set in any case
    reseed_lost: float = 0.2  # of the points, that calls for new ones


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
    Pixels within `reseed_cells` cells of one of `taken_uv` are left out.

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
        free &= _distance_to(taken_uv, free.shape) > config.reseed_cells * cell
    gray = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)
    slope = np.asarray(gray, dtype=np.float32) / SOBEL_GAIN
    corner = np.where(free, cv2.cornerMinEigenVal(slope, config.corner_window_px), 0)
    v, u = np.nonzero(corner > config.min_corner)
    if not u.size:
        return np.empty((0, 2))
    uv, strength = np.stack([u, v], axis=-1), corner[v, u]
    peaks = _peaks(corner, config.peak_px)[v, u]
    uv, strength = uv[peaks], strength[peaks]
    wanted = config.number * (free.sum() / max(int(mask.sum()), 1))
    shift = rng.uniform(0, 1, 2)
    while True:
        best = _best_of_cells(uv, strength, shift * cell, cell)
        if len(best) >= wanted or cell <= config.min_spacing_px:
            return uv[best].astype(np.float64)
        cell = max(config.min_spacing_px, config.cell_shrink * cell)


def _peaks(corner: NDArray[np.floating], reach_px: int) -> BoolArray:
    """(H, W) no stronger corner next to it: cells that meet at one would all choose it."""
    side = 2 * reach_px + 1
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


class SeedingSchedule:
    """In which frames new points are set: in the first, then as time goes on or points are lost.

    It looks back only, so that a stream and a recording seed the same frames.
    """

    def __init__(self, config: SeedingConfig) -> None:
        """No frame yet."""
        self._config = config
        self._frames = 0
        self._last, self._seen_then = 0, 0  # frame of the last seeds, and points seen after it

    def due(self, seen: int) -> bool:
        """Whether to set points in the next frame, in which so many are seen already."""
        c, t = self._config, self._frames
        self._frames += 1
        if t == 0:
            return True
        grown = t - self._last >= max(c.reseed_gap, c.reseed_growth * self._last)
        few = t - self._last >= c.reseed_gap and seen < (1 - c.reseed_lost) * self._seen_then
        return grown or few

    def seeded(self, seen: int) -> None:
        """Points were set in this frame; so many are seen in it now."""
        self._last, self._seen_then = self._frames - 1, seen
