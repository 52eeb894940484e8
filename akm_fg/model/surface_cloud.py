"""Readings of many frames to one surface: averaged in voxels, and what others contradict left out.

A point that a frame looks through is not there: a flying pixel, a shadow of another time, or the
robot's hand, which moves with the part but was elsewhere before it took hold of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from akm_fg.model.config import ModelConfig
from akm_fg.model.records import Surface
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import depth_planes
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

_NEIGHBOURS = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, slots=True)
class View:
    """A frame, and where the surface's own coordinates are in it."""

    frame: RgbdFrame
    T_world_surface: gtsam.Pose3
    closed: bool = False  # whether it is the frame in which the state is zero by definition


@dataclass(frozen=True, slots=True)
class Readings:
    """N single readings of a surface, in its own coordinates."""

    p: FloatArray  # (N, 3) metres
    normal: FloatArray  # (N, 3)
    rgb: FloatArray  # (N, 3)


def readings(view: View, mask: BoolArray, noise: DepthNoiseModel, config: ModelConfig) -> Readings:
    """What a frame shows of a surface.

    Args:
        view: the frame.
        mask: (H, W) pixels of the surface.
        noise: of the depth.
        config: tuning.
    """
    frame = view.frame
    stride = max(1, round(frame.camera.width / config.fine_width_px))
    sparse = np.zeros_like(mask)
    sparse[::stride, ::stride] = mask[::stride, ::stride]
    found, left = [], sparse
    for planes_config in (config.planes, config.fine_planes):
        planes = depth_planes(frame, noise, mask, planes_config)
        v, u = np.nonzero(left & planes.valid)
        left = left & ~planes.valid
        at = planes.at(np.stack([u, v], axis=-1).astype(float))
        known = np.isfinite(at.p_world).all(axis=1) & np.isfinite(at.normal_world).all(axis=1)
        colours = frame.rgb[v, u].astype(float)
        found.append((at.p_world[known], at.normal_world[known], colours[known]))
    p, normal, rgb = (np.concatenate(each) for each in zip(*found, strict=True))
    R, t = view.T_world_surface.rotation().matrix(), view.T_world_surface.translation()
    return Readings((p - t) @ R, normal @ R, rgb)


def averaged(parts: Sequence[Readings], voxel_m: float) -> Surface:
    """One point a voxel: the mean of the readings in it."""
    p = np.concatenate([each.p for each in parts])
    normal = np.concatenate([each.normal for each in parts])
    rgb = np.concatenate([each.rgb for each in parts])
    if not len(p):
        return Surface(p, normal, rgb.astype(np.uint8))
    cells = np.floor((p - p.min(axis=0)) / voxel_m).astype(np.int64)
    key = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, index, count = np.unique(key, return_inverse=True, return_counts=True)

    def mean(values: FloatArray) -> FloatArray:
        sums = [np.bincount(index, column, count.size) for column in values.T]
        return np.stack(sums, axis=-1) / count[:, None]

    n = mean(normal)
    length = np.linalg.norm(n, axis=1)
    kept = length > 0  # sheets that are seen from either side within a voxel have no normal
    n = n[kept] / length[kept, None]
    colours = np.rint(mean(rgb)[kept]).astype(np.uint8)
    return Surface(mean(p)[kept], n, colours)


def believed(
    surface: Surface, views: Sequence[View], noise: DepthNoiseModel, config: ModelConfig
) -> BoolArray:
    """(N,) points that the frames do not contradict.

    Args:
        surface: N points.
        views: the frames that are asked.
        noise: of the depth.
        config: tuning.
    """
    seen, through = (np.zeros(len(surface), dtype=int) for _ in range(2))
    never = np.zeros(len(surface), dtype=bool)
    for view in views:
        here, beyond = _looked_up(surface.p_world, view, noise, config)
        seen += here
        through += beyond
        if view.closed:
            never |= beyond
    return ~never & (through <= config.most_seen_through * (seen + through))


def in_one_piece(p: FloatArray, config: ModelConfig) -> BoolArray:
    """(N,) points (N, 3) that are not on small islands of their own."""
    if not len(p):
        return np.zeros(0, dtype=bool)
    cells = np.floor((p - p.min(axis=0)) / config.island_gap_m).astype(int)
    full = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    full[tuple(cells.T)] = True
    labels, _ = ndimage.label(full, np.ones((3, 3, 3)))
    own = labels[tuple(cells.T)]
    count = np.bincount(own)
    return np.asarray(count[own] >= config.island_share * count.max())


def _looked_up(
    p: FloatArray, view: View, noise: DepthNoiseModel, config: ModelConfig
) -> tuple[BoolArray, BoolArray]:
    """Whether a frame shows the points (N, 3), and whether it shows all around what is behind."""
    frame = view.frame
    T_cam_surface = frame.T_world_cam.inverse() * view.T_world_surface
    p_cam = p @ T_cam_surface.rotation().matrix().T + T_cam_surface.translation()
    row, column, inside = pixels(frame, p_cam)
    # What is not known may hide the point.
    depth = np.nan_to_num(frame.depth_m, nan=0.0)
    nearest = np.asarray(cv2.erode(depth, _NEIGHBOURS))[row, column]
    z = p_cam[:, 2]
    gate = np.sqrt(2.0) * config.gate_sigmas * noise.sigma_m(z, frame.camera.fx) + config.gate_m
    here = inside & (np.abs(depth[row, column] - z) < gate)
    return here, inside & (nearest - z > gate)


def pixels(
    frame: RgbdFrame, p_cam: FloatArray
) -> tuple[NDArray[np.int_], NDArray[np.int_], BoolArray]:
    """Rows and columns (N,) of the pixels of points (N, 3), and which are inside the image."""
    camera = frame.camera
    uv = np.nan_to_num(np.rint(camera.project(p_cam)), nan=-1.0)
    inside = (uv >= 0).all(axis=1) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
    column, row = np.where(inside[:, None], uv, 0).astype(int).T
    return row, column, np.asarray(inside)
