"""A frame as another camera pose would see it: for recordings of a camera whose poses are known.

Every pixel with depth is carried over, the nearest to a pixel of the other view wins, and gaps of a
pixel between the carried ones take the nearest of their neighbours. What was hidden stays unknown.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import BoolArray, RgbdFrame

_NONE = -1
_NEIGHBOURS = tuple((v, u) for v in (-1, 0, 1) for u in (-1, 0, 1) if (v, u) != (0, 0))
_LEAST_NEIGHBOURS = 4  # of a gap's eight: fewer is the border of what was seen


@dataclass(frozen=True, slots=True)
class OtherView:
    """A frame carried over, and where its pixels come from."""

    frame: RgbdFrame  # seen from elsewhere; NaN depth where nothing was carried
    source: NDArray[np.int64]  # (H, W) flat index of the pixel in the first view; -1 for none

    def carried(self, mask: BoolArray) -> BoolArray:
        """A mask (H, W) of the first view in the other."""
        return np.asarray((self.source != _NONE) & mask.ravel()[np.maximum(self.source, 0)])


def same_view(a: RgbdFrame, b: RgbdFrame) -> bool:
    """Whether two frames are of a camera in one place."""
    return bool(a.T_world_cam.equals(b.T_world_cam, 0.0))


def stands_still(frames: Iterable[RgbdFrame]) -> bool:
    """Whether all frames are of a camera in one place, as far as their poses say."""
    first, *others = frames
    return all(same_view(first, frame) for frame in others)


def seen_from(frame: RgbdFrame, T_world_cam: gtsam.Pose3) -> OtherView:
    """The frame as a camera of the same intrinsics there would see it."""
    camera, shape = frame.camera, frame.depth_m.shape
    v, u = np.nonzero(np.isfinite(frame.depth_m))
    T = T_world_cam.inverse() * frame.T_world_cam
    p_cam = camera.back_project(
        np.stack([u, v], axis=-1).astype(np.float64), frame.depth_m[v, u].astype(np.float64)
    )
    p_cam = p_cam @ T.rotation().matrix().T + T.translation()
    uv = np.rint(np.nan_to_num(camera.project(p_cam), nan=_NONE)).astype(np.int64)
    inside = (uv >= 0).all(axis=1) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
    far_first = np.flatnonzero(inside)[np.argsort(-p_cam[inside, 2], kind="stable")]
    depth = np.full(shape, np.inf)
    source = np.full(shape, _NONE, dtype=np.int64)
    there = uv[far_first, 1], uv[far_first, 0]
    depth[there], source[there] = p_cam[far_first, 2], (v * shape[1] + u)[far_first]
    depth, source = _without_gaps(depth, source)
    rgb = frame.rgb.reshape(-1, 3)[np.maximum(source, 0)]
    rgb[source == _NONE] = 0
    depth_m = np.where(source == _NONE, np.nan, depth).astype(np.float32)
    seen = replace(frame, rgb=rgb, depth_m=depth_m, T_world_cam=T_world_cam)
    return OtherView(seen, source)


def _without_gaps(
    depth: NDArray[np.float64], source: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Empty pixels among full ones take the nearest neighbour's depth."""
    h, w = depth.shape
    z = np.pad(depth, 1, constant_values=np.inf)
    from_ = np.pad(source, 1, constant_values=_NONE)
    best, chosen = depth.copy(), source.copy()
    count = np.zeros(depth.shape, dtype=int)
    for dv, du in _NEIGHBOURS:
        there = np.s_[1 + dv : 1 + dv + h, 1 + du : 1 + du + w]
        count += from_[there] != _NONE
        nearer = (source == _NONE) & (z[there] < best)
        best[nearer], chosen[nearer] = z[there][nearer], from_[there][nearer]
    gap = (source == _NONE) & (count >= _LEAST_NEIGHBOURS)
    return np.where(gap, best, depth), np.where(gap, chosen, source)
