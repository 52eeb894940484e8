"""How near a pixel's surface point is to labelled tracks: what they say of it before depth does."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import Box, Image
from akm_fg.perception.moving_part.mask_likelihood import camera_rays
from akm_fg.perception.tracking.lifting import local_depth
from akm_fg.records import FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class TrackPriorConfig:
    """How far a track's label reaches."""

    at_track: float = 4.0  # log odds at a labelled track, from that track
    reach_m: float = 0.06  # distance along the surface at which that has fallen to 1/e
    off_plane_m: float = 0.008  # sd across the track's plane: boards are 1 to 2 cm thick


def nearness(
    frame: RgbdFrame, box: Box, uv: FloatArray, noise: DepthNoiseModel, config: TrackPriorConfig
) -> Image:
    """exp(-distance / reach) (h, w) of a crop's surface to the track that is nearest in the image.

    Args:
        frame: its depth.
        box: rows and columns of the crop, with their stride.
        uv: (N, 2) pixels of the tracks in this frame.
        noise: of the depth.
        config: reach.

    Returns:
        1 at a track, 0 far from all of them, off their planes, or without depth.
    """
    z, stride = frame.depth_m[box], box[0].step or 1
    local = local_depth(frame, uv, noise)
    column, row = np.rint((uv - [box[1].start, box[0].start]) / stride).astype(int).T
    inside = np.isfinite(local.depth_m) & (row >= 0) & (column >= 0)
    inside &= (row < z.shape[0]) & (column < z.shape[1])
    if not inside.any():
        return np.zeros_like(z)
    row, column = row[inside], column[inside]
    free = np.ones(z.shape, np.uint8)
    free[row, column] = 0
    label = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)[1]
    planes = np.zeros((label.max() + 1, 6), np.float32)
    planes[label[row, column]] = _planes(
        frame, uv[inside], local.depth_m[inside], local.slope_m_per_px[inside]
    )
    return _kernel(frame, box, z, planes, label, config)


def _planes(frame: RgbdFrame, uv: FloatArray, depth: FloatArray, slope: FloatArray) -> FloatArray:
    """Points and unit normals (N, 6) in the camera frame."""
    camera = frame.camera
    inverse_slope = -slope / depth[:, None] ** 2
    rays = camera.back_project(uv, np.ones(len(uv)))
    n = np.stack(
        [camera.fx * inverse_slope[:, 0], camera.fy * inverse_slope[:, 1], 0 * depth], axis=-1
    )
    n[:, 2] = 1 / depth - (n * rays).sum(axis=1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return np.concatenate([rays * depth[:, None], n], axis=1)


def _kernel(
    frame: RgbdFrame,
    box: Box,
    z: Image,
    planes: Image,
    label: NDArray,
    config: TrackPriorConfig,
) -> Image:
    x, y = camera_rays(frame.camera, box)
    at = [planes[:, i].take(label) for i in range(6)]
    difference = (z * x - at[0], z * y - at[1], z - at[2])
    square = sum(d * d for d in difference)
    off = sum(d * n for d, n in zip(difference, at[3:], strict=True))
    exponent = np.sqrt(square) / config.reach_m + 0.5 * (off / config.off_plane_m) ** 2
    return np.nan_to_num(np.exp(-exponent))
