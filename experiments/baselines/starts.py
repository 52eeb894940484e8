"""Where the paper's optimisation starts from: geometric heuristics and random draws about them.

From the paper's section IV-B: a prismatic axis joins the centroids of the first and last frame; a
hinge's axis is the normal of the plane in which the points move, its pivot the point that moves
least. The states of a start follow from the centroid's displacement. Averages run over the
observations present in both frames concerned; without losses these are the plain centroids.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.baselines.config import CoarseConfig

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Starts:
    """B starting points of one kind."""

    axis: Array  # (B, 3) unit
    pivot: Array  # (B, 3) metres
    states: Array  # (B, T) metres or radians, zero in the first frame


def observed(points: Array) -> NDArray[np.bool_]:
    """Where points (..., 3) are known, (...)."""
    return np.asarray(np.isfinite(points).all(axis=-1))


def centroid_displacements(points: Array) -> Array:
    """(T, 3) mean displacement since frame 0 of points (T, N, 3); 0 where none was seen."""
    moved = points - points[0]
    seen = observed(moved)
    total = np.where(seen[..., None], moved, 0.0).sum(axis=1)
    return total / np.maximum(seen.sum(axis=1), 1)[:, None]


def prismatic_start(points: Array) -> Starts:
    """The one start of a prismatic joint from points (T, N, 3), all seen in frame 0.

    Raises:
        ValueError: the centroid is where it was, so there is no direction.
    """
    moved = centroid_displacements(points)
    direction = moved[_last_seen_frame(points)]
    length = float(np.linalg.norm(direction))
    if not length > 0:
        raise ValueError("the points end where they began: no direction to start from")
    axis = direction / length
    return Starts(axis[None], points[0].mean(axis=0)[None], (moved @ axis)[None])


def heuristic_hinge(points: Array) -> tuple[Array, Array]:
    """Axis (3,) and pivot (3,) of a hinge from points (T, N, 3), all seen in frame 0."""
    steps = np.diff(points, axis=0)
    seen = observed(steps)
    flow = steps[seen] - steps[seen].mean(axis=0)
    _, principal = np.linalg.eigh(flow.T @ flow)
    length = np.where(seen, np.linalg.norm(np.where(seen[..., None], steps, 0.0), axis=-1), 0.0)
    mean_length = length.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    # A point that was never seen in two frames running has no length to compare.
    still = int(np.argmin(np.where(seen.any(axis=0), mean_length, np.inf)))
    return np.asarray(principal[:, 0]), points[0, still]


def revolute_starts(points: Array, config: CoarseConfig, rng: np.random.Generator) -> Starts:
    """The heuristic hinge and `config.starts - 1` random ones about it.

    Args:
        points: (T, N, 3) metres, all seen in frame 0; NaN where lost later.
        config: number and ranges.
        rng: draws them.
    """
    axis, pivot = heuristic_hinge(points)
    extra = config.starts - 1
    pivots = pivot + rng.uniform(-config.pivot_range_m, config.pivot_range_m, (extra, 3))
    about = rng.normal(size=(extra, 3))
    about /= np.linalg.norm(about, axis=1, keepdims=True)
    angles = np.deg2rad(rng.uniform(0.0, config.axis_range_deg, extra))
    turned = Rotation.from_rotvec(angles[:, None] * about).apply(axis)
    axes = np.concatenate([axis[None], turned])
    pivots = np.concatenate([pivot[None], pivots])
    moved = centroid_displacements(points)
    arm = points[0].mean(axis=0) - pivots
    axes = _signed_by_opening(axes, arm, moved[_last_seen_frame(points)])
    return Starts(axes, pivots, _swept_angles(axes, arm, moved))


def _last_seen_frame(points: Array) -> int:
    """The last frame in which any point was seen."""
    return int(np.flatnonzero(observed(points).any(axis=1))[-1])


def _signed_by_opening(axes: Array, arm: Array, moved: Array) -> Array:
    """Axes (B, 3), reversed where the centroid, arm (B, 3) off the pivot, would turn backwards."""
    turning = np.cross(arm, arm + moved)
    return np.where((turning * axes).sum(axis=1, keepdims=True) < 0, -axes, axes)


def _swept_angles(axes: Array, arm: Array, moved: Array) -> Array:
    """Angles (B, T), 0 to pi, between the centroid's arms (B, 3) and (T, 3) later, about axes."""
    before = _across(axes, arm)[:, None]
    after = _across(axes[:, None], arm[:, None] + moved[None])
    lengths = np.linalg.norm(before, axis=-1) * np.linalg.norm(after, axis=-1)
    cosine = (before * after).sum(axis=-1) / np.maximum(lengths, 1e-12)
    angles = np.arccos(np.clip(cosine, -1.0, 1.0))
    angles[:, 0] = 0.0
    return angles


def _across(axes: Array, v: Array) -> Array:
    """The part of v across the unit axes, broadcast over leading dimensions."""
    across: Array = v - (v * axes).sum(axis=-1, keepdims=True) * axes
    return across
