"""Dense clouds of the moving part: their normals, and which frames to take them from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

Array = NDArray[np.float64]

NORMAL_NEIGHBOURS = 30  # about a 2 cm patch in a cloud of 10,000 points on a cabinet's front


@dataclass(frozen=True, slots=True)
class PartCloud:
    """Points seen in one keyframe, with the normals of their surface."""

    points: Array  # (N, 3) metres, world
    normals: Array  # (N, 3) unit, either sign

    def __post_init__(self) -> None:
        n = len(self.points)
        if self.points.shape != (n, 3) or self.normals.shape != (n, 3):
            raise ValueError(f"points {self.points.shape}, normals {self.normals.shape}: (N, 3)")
        if not (np.isfinite(self.points).all() and np.isfinite(self.normals).all()):
            raise ValueError("points and normals must be finite: leave out what was not seen")


def part_cloud(points: Array, neighbours: int = NORMAL_NEIGHBOURS) -> PartCloud:
    """A cloud with normals from the neighbours of each point (least principal component).

    Args:
        points: (N, 3) metres, world, all finite.
        neighbours: how many make a normal, the point itself included; fewer in a small cloud.

    Raises:
        ValueError: fewer than three points, another shape, or points that are not finite.
    """
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 3:
        raise ValueError(f"points {points.shape}, expected (N, 3) with three points at least")
    if not np.isfinite(points).all():
        raise ValueError("points must be finite: leave out what was not seen")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(neighbours))
    return PartCloud(points, np.array(cloud.normals))


def choose_keyframes(states: Array, count: int) -> NDArray[np.int64]:
    """Frames farthest apart in state, the first included, in the order of time.

    Each next one has the largest distance to the nearest already chosen.

    Args:
        states: (T,) metres or radians; NaN is never chosen.
        count: how many; fewer if fewer frames have a state.
    """
    known = np.flatnonzero(np.isfinite(states))
    chosen = [0]
    gap = np.abs(states[known] - states[0])
    while len(chosen) < min(count, known.size):
        gap[np.isin(known, chosen)] = -1.0
        chosen.append(int(known[np.argmax(gap)]))
        gap = np.minimum(gap, np.abs(states[known] - states[chosen[-1]]))
    return np.array(sorted(chosen))
