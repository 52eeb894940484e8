"""Where one surface ends in a depth image and another begins.

Inverse depth is linear on a plane, so its second difference vanishes there however slanted the
plane is, and jumps at a step. Differences of depth itself would call a slanted front an edge.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import BoolArray


def near_depth_edge(
    depth_m: NDArray[np.floating], step_m: float, margin_px: int, reach_px: int = 2
) -> BoolArray:
    """(H, W), True within a margin of a depth step; unknown depth (NaN) is no step.

    Args:
        depth_m: (H, W) along camera z.
        step_m: smallest step that counts.
        margin_px: of the square neighbourhood.
        reach_px: largest distance over which depths are compared; 2 looks past a pixel that is
            lost at the edge itself, 1 finds the edge to the pixel.
    """
    inverse = 1 / depth_m
    edge = np.zeros(depth_m.shape, dtype=bool)
    limit = step_m * inverse * inverse
    for axis in (0, 1):
        w, most = (np.moveaxis(image, axis, 0) for image in (inverse, limit))
        out = np.moveaxis(edge, axis, 0)
        for n in range(1, reach_px + 1):
            bend = np.abs(w[2 * n :] + w[: -2 * n] - 2 * w[n:-n])
            out[n:-n] |= bend > most[n:-n]  # NaN compares False
    if margin_px > 0:
        wide = np.ones((2 * margin_px + 1,) * 2, np.uint8)
        edge = np.asarray(cv2.dilate(edge.astype(np.uint8), wide) > 0)
    return edge
