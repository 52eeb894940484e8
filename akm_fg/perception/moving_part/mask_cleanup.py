"""Pixels of one surface share what they know; islands and depth edges are left out."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from akm_fg.perception.depth.depth_edges import near_depth_edge
from akm_fg.perception.depth.depth_planes import Image
from akm_fg.perception.depth.thinning import repeated
from akm_fg.records import BoolArray

_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))  # to half of the eight neighbours; the others mirror


@dataclass(frozen=True, slots=True)
class MaskCleanupConfig:
    """Neighbourhoods."""

    share_rounds: int = 4  # of averaging over neighbours on the same surface
    surface_step_m: float = 0.012  # between neighbours of one surface, as noise and relief make it
    max_slope: float = 2.0  # tangent between ray and normal, 63 deg: on top, for slanted surfaces
    edge_step_m: float = 0.024  # between pixels: another surface begins
    min_area: float = 0.0005  # of the image; smaller islands are dropped
    edge_px: int = 1  # left open at either side of a depth edge, and of the border of two masks


class SurfaceNeighbours:
    """Which of the eight neighbours of each pixel of a depth image lie on the same surface."""

    def __init__(self, z: Image, spacing_px: float, fx: float, config: MaskCleanupConfig) -> None:
        """Compare neighbours.

        Args:
            z: (h, w) depth; pixels without (NaN) have no neighbours.
            spacing_px: between neighbours, in pixels of the camera.
            fx: focal length, pixels.
            config: tuning.
        """
        self._rounds = config.share_rounds
        self._links = []
        self._weight = np.ones_like(z)
        step = np.float32(config.max_slope * spacing_px / fx) * z
        step += np.float32(config.surface_step_m)
        for dv, du in _STEPS:
            (a, b), (limit, _) = _pair(z, dv, du), _pair(step, dv, du)
            link = (np.abs(a - b) < limit).astype(np.float32)  # NaN compares False
            self._links.append(link)
            for side in _pair(self._weight, dv, du):
                side += link

    def average(self, values: Image) -> Image:
        """Values (h, w), averaged with the neighbours', several rounds."""
        for _ in range(self._rounds):
            total = values.copy()
            for (dv, du), link in zip(_STEPS, self._links, strict=True):
                a, b = _pair(values, dv, du)
                first, second = _pair(total, dv, du)
                first += link * b
                second += link * a
            values = total / self._weight
        return values


def _pair(image: Image, dv: int, du: int) -> tuple[Image, Image]:
    """Views of an image's pixels, and of those (dv, du) further on, where both exist."""
    h, w = image.shape
    a = image[: h - dv, max(0, -du) : w - max(0, du)]
    return a, image[dv:, max(0, du) : w - max(0, -du)]


def refine(
    first: BoolArray, second: BoolArray, z: Image, stride: int, fx: float, config: MaskCleanupConfig
) -> tuple[BoolArray, BoolArray]:
    """Two masks (h, w) of all pixels, from two of every `stride`th pixel.

    A pixel between follows the one that stands for it if both lie on the same surface. Depth
    edges, and the border where the two masks touch, stay open.

    Args:
        first: coarse mask.
        second: coarse mask of other pixels.
        z: (h, w) depth; pixels without are left out.
        stride: of the coarse masks.
        fx: focal length, pixels.
        config: tuning.
    """
    label = np.where(first, np.uint8(2), np.where(second, np.uint8(0), np.uint8(1)))
    fine = repeated(label, stride, z.shape)
    z_of = repeated(z[::stride, ::stride], stride, z.shape)
    limit = np.float32(config.max_slope * stride / fx) * z + np.float32(config.surface_step_m)
    sound = np.abs(z - z_of) < limit  # NaN compares False
    sound &= ~near_depth_edge(z, config.edge_step_m, config.edge_px, reach_px=1)
    around = np.ones((2 * config.edge_px + 1,) * 2, np.uint8)
    low, high = cv2.erode(fine, around), cv2.dilate(fine, around)
    return (fine == 2) & (low > 0) & sound, (fine == 0) & (high < 2) & sound


def without_islands(mask: BoolArray, min_pixels: int) -> BoolArray:
    """The mask without connected regions smaller than this."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= min_pixels
    large[0] = False
    return np.asarray(large[labels])
