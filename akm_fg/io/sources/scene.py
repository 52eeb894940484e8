"""What a few pictures tell of poses and depth: floors, and whether two views show one scene.

Nothing here is believed against what a person says, and little of it against a format.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import FloatArray, PinholeCamera

POINTS = 3000  # of a picture that are looked at
TRIPLES = 400  # of points that planes are laid through
PLANES = 3  # that are looked for, one after the other
ON_PLANE = 0.012  # of the distance: depth noise, and a floor that is not quite flat
LEAST_SHARE = 0.06  # of the points, on a plane that bounds the scene
BEYOND_SHARE = 0.02  # of the points, behind it: flying pixels, mirrors
AGREES = 0.03  # of the depth: one surface in two views
HAND_BEFORE_M = 0.25  # the hand itself, between camera and fingertips
HAND_BEHIND_M = 0.06  # what the fingertips hold
OVERLAP = 0.3  # of the points at least, for two views to be compared


@dataclass(frozen=True, slots=True)
class View:
    """One picture's depth, and the camera's pose as its source writes it."""

    camera: PinholeCamera
    depth_m: NDArray[np.float32]  # (H, W), NaN where unknown
    pose: gtsam.Pose3  # in whatever convention
    p_world_gripper: FloatArray | None = None  # (3,) metres

    def points(self, seed: int = 0) -> FloatArray:
        """(N, 3) in the camera's frame, some of those that are known."""
        v, u = np.nonzero(np.isfinite(self.depth_m))
        if len(v) > POINTS:
            chosen = np.random.default_rng(seed).choice(len(v), POINTS, replace=False)
            v, u = v[chosen], u[chosen]
        uv = np.stack([u, v], -1).astype(np.float64)
        return self.camera.back_project(uv, self.depth_m[v, u].astype(np.float64))


def bounding_planes(view: View) -> list[tuple[FloatArray, float]]:
    """Planes with next to nothing behind them: floor, walls, a table top that fills the view.

    Returns:
        Normals (3,) in the camera's frame that point into the scene, and the camera's distance
        from each plane in metres, largest plane first.
    """
    points, rng = view.points(), np.random.default_rng(0)
    found: list[tuple[FloatArray, float]] = []
    total = len(points)
    rest = points
    for _ in range(PLANES):
        if len(rest) < max(3, LEAST_SHARE * total):
            break
        normal, distance = _largest_plane(rest, points, rng)
        if normal is None:
            break
        found.append((normal, distance))
        away = np.abs(rest @ normal + distance) > 2 * ON_PLANE * np.linalg.norm(rest, axis=1)
        rest = rest[away]
    return found


def _largest_plane(
    rest: FloatArray, points: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray | None, float]:
    """Of those through three points of `rest` that bound all `points`; normal . p + d = 0."""
    triples = rest[rng.integers(0, len(rest), (TRIPLES, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    good = lengths > 1e-12
    normals, triples = normals[good] / lengths[good, None], triples[good]
    distances = -np.einsum("ij,ij->i", normals, triples[:, 0])
    turn = np.where(distances < 0, -1.0, 1.0)  # the camera, at the origin, is before it
    normals, distances = normals * turn[:, None], distances * turn
    reach = ON_PLANE * np.linalg.norm(points, axis=1)
    away = points @ normals.T + distances
    bounds = (away < -2 * reach[:, None]).mean(0) < BEYOND_SHARE
    on = np.abs(rest @ normals.T + distances) < ON_PLANE * np.linalg.norm(rest, axis=1)[:, None]
    share = on.sum(0) / len(points) * bounds
    if not len(share) or share.max() < LEAST_SHARE:
        return None, 0.0
    best = int(share.argmax())
    near = rest[on[:, best]]
    middle = near.mean(0)
    normal = np.linalg.svd(near - middle, full_matrices=False)[2][2]
    normal = normal if normal @ normals[best] > 0 else -normal
    return normal, float(-normal @ middle)


def agreement(
    one: View, T_world_one: gtsam.Pose3, other: View, T_world_other: gtsam.Pose3
) -> float:
    """Share of one view's points that the other view shows where they should be.

    Points that the other view does not see count against it only where hardly any is seen.
    """
    points = one.points()
    T = T_world_other.between(T_world_one)
    moved = points @ T.rotation().matrix().T + T.translation()
    moved = moved[moved[:, 2] > 0]
    camera = other.camera
    uv = np.rint(camera.project(moved)).astype(np.int64)
    inside = (uv >= 0).all(1) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
    seen = other.depth_m[uv[inside, 1], uv[inside, 0]]
    z = moved[inside, 2]
    known = np.isfinite(seen) & (z < seen * (1 + 5 * AGREES))  # what is hidden tells nothing
    agree = np.abs(seen - z) < AGREES * z
    return float((agree & known).sum() / max(known.sum(), OVERLAP * len(points), 1))


def hand_is_seen(view: View, T_world_cam: gtsam.Pose3) -> bool:
    """Whether the gripper is where depth shows something, or a little before it."""
    assert view.p_world_gripper is not None
    p = T_world_cam.transformTo(view.p_world_gripper)
    u, v = np.rint(view.camera.project(p[None])[0]) if p[2] > 0 else (-1, -1)
    if not (0 <= u < view.camera.width and 0 <= v < view.camera.height):
        return False
    rows, columns = (slice(max(int(x) - 4, 0), int(x) + 5) for x in (v, u))
    near = view.depth_m[rows, columns]
    seen = float(np.nanmedian(near)) if np.isfinite(near).any() else float("nan")
    return bool(p[2] - HAND_BEFORE_M < seen < p[2] + HAND_BEHIND_M)


def spread(poses: Sequence[gtsam.Pose3]) -> tuple[float, float]:
    """How far poses are from the first: metres, radians."""
    away = [poses[0].between(pose) for pose in poses]
    metres = max(float(np.linalg.norm(T.translation())) for T in away)
    return metres, max(float(np.linalg.norm(gtsam.Rot3.Logmap(T.rotation()))) for T in away)
