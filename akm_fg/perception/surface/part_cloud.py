"""A keyframe's surface as points with normals, for dense registration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import DepthPlanes, depth_planes
from akm_fg.records import BoolArray, FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class PartCloud:
    """N surface points of one keyframe, each the smoothed depth of its pixel."""

    frame: int  # number in the recording
    uv: FloatArray  # (N, 2) pixels
    p_world: FloatArray  # (N, 3) metres
    normal_world: FloatArray  # (N, 3) unit, towards the camera
    sigma_normal_m: FloatArray  # (N,) sd of a single depth reading along the normal


def part_cloud(
    frame: RgbdFrame,
    mask: BoolArray,
    frame_index: int,
    noise: DepthNoiseModel,
    rng: np.random.Generator,
    max_points: int | None = None,
    stride_px: int = 1,
) -> PartCloud:
    """Points of the masked surface, at most `max_points`, from a grid of pixels.

    Points whose neighbourhood is no plane (edges, flying pixels, holes) are left out.

    Args:
        frame: the keyframe.
        mask: (H, W) pixels of the part; neighbourhoods end at its border.
        frame_index: the keyframe's number.
        noise: of the depth.
        rng: shifts the grid, draws the points.
        max_points: None for all.
        stride_px: of the grid.

    Raises:
        ValueError: a mask of another size, or no positive number of points or pixels.
    """
    return sample_cloud(depth_planes(frame, noise, mask), frame_index, rng, max_points, stride_px)


def sample_cloud(
    planes: DepthPlanes,
    frame_index: int,
    rng: np.random.Generator,
    max_points: int | None = None,
    stride_px: int = 1,
) -> PartCloud:
    """As `part_cloud`, of planes that are there already."""
    if stride_px < 1 or (max_points is not None and max_points < 1):
        raise ValueError(f"stride {stride_px} and {max_points} points, expected at least 1")
    first = rng.integers(0, stride_px, 2)
    v, u = np.nonzero(planes.valid[first[0] :: stride_px, first[1] :: stride_px])
    uv = np.stack([first[1] + stride_px * u, first[0] + stride_px * v], axis=-1).astype(float)
    if max_points is not None and len(uv) > max_points:
        uv = uv[np.sort(rng.choice(len(uv), max_points, replace=False))]
    at = planes.at(uv)
    return PartCloud(frame_index, uv, at.p_world, at.normal_world, at.sigma_normal_m)
