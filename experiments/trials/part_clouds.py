"""Clouds of the moving part in keyframes, as the paper's fine stage takes them.

Pixels come from the same masks that the graph uses; the depth is as the camera gave it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.moving_part.part_mask import PartMask, propagate_masks
from akm_fg.perception.observed import ObservedMotion
from akm_fg.records import FloatArray, Recording
from experiments.baselines.clouds import PartCloud, part_cloud

MAX_POINTS = 10_000  # a cloud; the fine stage draws 1000 of them in every iteration
MIN_POINTS = 100  # fewer make no pair of the fine stage


def keyframe_clouds(
    recording: Recording,
    observed: ObservedMotion,
    frames: Sequence[int],
    noise: DepthNoiseModel,
    rng: np.random.Generator,
) -> dict[int, PartCloud]:
    """Clouds by frame; a frame in which too little of the part is seen has none.

    Args:
        recording: the clip.
        observed: its tracks and what of them moves.
        frames: keyframes.
        noise: of the depth, for the masks.
        rng: draws the points of large masks.
    """
    masks = propagate_masks(recording, observed, frames, noise)
    clouds = {}
    for mask in masks:
        points = masked_points(recording, mask, rng)
        if len(points) >= MIN_POINTS:
            clouds[mask.frame] = part_cloud(points)
    return clouds


def masked_points(recording: Recording, mask: PartMask, rng: np.random.Generator) -> FloatArray:
    """(N, 3) world points of the mask's pixels that have a depth, at most `MAX_POINTS`."""
    frame = recording.frames[mask.frame]
    v, u = np.nonzero(mask.moving & np.isfinite(frame.depth_m))
    if u.size > MAX_POINTS:
        pick = np.sort(rng.choice(u.size, MAX_POINTS, replace=False))
        u, v = u[pick], v[pick]
    uv = np.stack([u, v], axis=-1).astype(float)
    p_cam = frame.camera.back_project(uv, frame.depth_m[v, u].astype(float))
    T_world_cam = frame.T_world_cam.matrix()
    return p_cam @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]
