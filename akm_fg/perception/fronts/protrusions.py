"""What sticks out of fronts: connected pixels over a front that are no part of a plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.fronts.front_planes import ObjectCloud
from akm_fg.perception.fronts.front_records import Front, Protrusion
from akm_fg.records import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class ProtrusionConfig:
    """What counts as a handle."""

    least_m: float = 0.012  # over the front: the fingers want more
    least_sigmas: float = 4.0  # of a depth reading, at least
    most_m: float = 0.10  # over the front: what reaches so high is another body
    short_m: float = 0.01  # of that, a protrusion ends
    beside_m: float = 0.012  # of a front's rectangle: that far its flank is taken for it
    beyond_m: float = 0.05  # of a front's rectangle: ledges and boards that stand over
    below_m: float = 0.06  # a front's flank goes down to what it stands on
    least_px: int = 14
    least_area_m2: float = 1.5e-4  # a knob of 20 mm shows 3e-4
    most_m2: float = 0.03  # a ledge along a whole front is 0.02
    bridge_m: float = 0.03  # holes that a camera makes in a bar; no plane is seen in them
    outer: float = 0.6  # of its height: what is higher is its outer side


def protrusions(
    cloud: ObjectCloud,
    fronts: Sequence[Front],
    mask: BoolArray,
    taken: BoolArray,
    config: ProtrusionConfig,
) -> tuple[Protrusion, ...]:
    """What sticks out of fronts.

    Args:
        cloud: the points in the outline of the object: segmenters lose what is thin.
        fronts: all of them.
        mask: (H, W) the object; outside of it counts what is straight over a front.
        taken: (H, W) pixels that show any plane.
        config: sizes.
    """
    rest = cloud.known & ~taken
    if not fronts or not rest.any():
        return ()
    owner, height, beside = _below(cloud.p_world[rest], fronts, config)
    least = np.maximum(config.least_m, config.least_sigmas * cloud.sigma_m[rest])
    out = np.zeros(taken.shape, dtype=bool)
    out[rest] = (height > least) & (height < config.most_m) & (mask[rest] | (beside <= 0.0))
    owners = np.full(taken.shape, -1)
    owners[rest] = owner
    pixel_m = float(np.sqrt(np.median(cloud.area_m2[rest])))
    bridge = np.ones((2 * round(config.bridge_m / pixel_m / 2.0) + 1,) * 2, np.uint8)
    joined = cv2.morphologyEx(out.astype(np.uint8), cv2.MORPH_CLOSE, bridge)
    joined[taken] = 0
    count, labels, stats, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    found = []
    for label in range(1, count):
        if stats[label, cv2.CC_STAT_AREA] < config.least_px:
            continue
        mask = (labels == label) & out
        area = float(cloud.area_m2[mask].sum())
        if mask.sum() >= config.least_px and config.least_area_m2 < area < config.most_m2:
            front = int(np.bincount(owners[mask]).argmax())
            one = _protrusion(cloud, front, fronts[front], mask, config)
            if one.height_m < config.most_m - config.short_m:
                found.append(one)
    return tuple(found)


def _below(
    p_world: FloatArray, fronts: Sequence[Front], config: ProtrusionConfig
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Of points (N, 3): the front below, the height over it and the distance beside it, m.

    The height is NaN where there is no front below.

    The front straight below counts, of several the outermost, else the nearest beside. Beside and
    below a front is its own flank, which is no protrusion of what is behind it.
    """
    owner = np.zeros(len(p_world), dtype=np.int64)
    height, aside = np.full(len(p_world), np.nan), np.full(len(p_world), np.inf)
    least = np.full(len(p_world), np.inf)
    for i, front in enumerate(fronts):
        local = front.frame.local(p_world)
        xy, h = local[:, :2], local[:, 2]
        outside = np.maximum(np.maximum(front.lower_m - xy, xy - front.upper_m), 0.0)
        beside = np.linalg.norm(outside, axis=1)
        cost = np.where(beside < config.beside_m, 0.0, beside) + 1e-3 * np.maximum(h, 0.0)
        near = (h > -config.below_m) & (h < config.most_m) & (beside < config.beyond_m)
        better = near & (cost < least)
        owner[better], height[better], least[better] = i, h[better], cost[better]
        aside[better] = beside[better]
    return owner, height, aside


def _protrusion(
    cloud: ObjectCloud, index: int, front: Front, mask: BoolArray, config: ProtrusionConfig
) -> Protrusion:
    local = front.frame.local(cloud.p_world[mask])
    v, u = np.nonzero(mask)
    height = float(np.quantile(local[:, 2], 0.85))
    outer = local[:, 2] > config.outer * height
    v, u, xy = v[outer], u[outer], local[outer, :2]
    middle = np.median(xy, axis=0)
    axis = np.linalg.eigh(np.cov(xy.T) + 1e-12 * np.eye(2))[1][:, 1]
    along, across = (xy - middle) @ axis, (xy - middle) @ np.array([-axis[1], axis[0]])
    pixel_m = float(np.sqrt(np.median(cloud.area_m2[v, u])))
    (a, b), (c, d) = np.quantile(along, [0.02, 0.98]), np.quantile(across, [0.05, 0.95])
    middle = middle + (a + b) / 2 * axis
    nearest = int(np.linalg.norm(xy - middle, axis=1).argmin())
    return Protrusion(
        p_world=front.frame.world(np.append(middle, height)),
        uv=np.array([u[nearest], v[nearest]], dtype=float),
        front=index,
        axis_world=front.frame.axes_world[:, :2] @ axis,
        length_m=float(b - a) + pixel_m,
        width_m=float(d - c) + pixel_m,
        height_m=height,
        mask=mask,
    )
