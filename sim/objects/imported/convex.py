"""Collision shapes: a mesh as convex pieces.

PyBullet takes the convex hull of a mesh that moves, which fills the gap behind a handle. Loose
parts that are convex as they are stay so; the rest is decomposed with CoACD.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from akm_fg.records import FloatArray
from sim.objects.imported.decomposition import FINE, Decomposition, decomposed
from sim.objects.obj_files import IntArray

FLAT_M = 0.002  # thickness given to what has none
ON_HULL = 0.02  # of the size: faces so near the hull are on it
CONVEX_SHARE = 0.97  # of the area on the hull, from which a part is called convex
FILLED_SHARE = 0.8  # of the hull's volume, from which a closed part is called convex
PARTS_MAX = 48  # loose parts of one mesh; more are decomposed together


@dataclass(frozen=True, slots=True)
class LoosePart:
    """What hangs together of a mesh."""

    points: FloatArray  # (N, 3), m
    faces: IntArray  # (F, 3)
    convex: bool  # or nearly so

    def hull(self) -> FloatArray:
        """Corners (M, 3) of its hull."""
        return hull_corners(self.points)


def loose_parts(points: FloatArray, faces: IntArray) -> list[LoosePart]:
    """The parts of a mesh, in its frame; the whole where they are too many."""
    mesh = trimesh.Trimesh(points, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    parts = mesh.split(only_watertight=False, repair=False)
    found = []
    for part in [mesh] if len(parts) > PARTS_MAX else parts:
        corners, of_part = np.asarray(part.vertices, dtype=float), np.asarray(part.faces, np.int64)
        found.append(LoosePart(corners, of_part, is_convex(corners, of_part)))
    return found


def pieces_of(parts: Sequence[LoosePart], how: Decomposition) -> list[FloatArray]:
    """Corners (M, 3) of convex pieces that together fill the parts."""
    hollow = [(part.points, part.faces) for part in parts if not part.convex]
    found = iter(decomposed(hollow, how))
    pieces = []
    for part in parts:
        corners = [part.points] if part.convex else next(found)
        pieces += [hull_corners(each) for each in corners]
    return pieces


def convex_pieces(
    points: FloatArray, faces: IntArray, how: Decomposition = FINE
) -> list[FloatArray]:
    """Corners (N, 3) of convex pieces that together fill the mesh, in its frame, m."""
    return pieces_of(loose_parts(points, faces), how)


def is_convex(points: FloatArray, faces: IntArray) -> bool:
    """Whether (nearly) all faces lie on the hull, and what is closed fills it.

    Holes in the surface do not matter; a hole through a board does, whose edges are all near.
    """
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat
        return True
    mesh = trimesh.Trimesh(points, faces, process=False)
    if mesh.is_volume and mesh.volume < FILLED_SHARE * hull.volume:
        return False
    corners = points[faces]
    middles = corners.mean(axis=1)
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    depth = -(middles @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    on = depth < ON_HULL * float(np.linalg.norm(np.ptp(points, axis=0)))
    return bool(areas[on].sum() >= CONVEX_SHARE * areas.sum())


def hull_corners(points: FloatArray) -> FloatArray:
    """Corners (N, 3) of the hull; what is flat gets FLAT_M of thickness."""
    try:
        return np.asarray(points[np.unique(ConvexHull(points).simplices)])
    except QhullError:
        middle = points.mean(axis=0)
        normal = np.linalg.svd(points - middle)[2][-1]
        shift = normal * FLAT_M / 2.0
        both = np.concatenate([points - shift, points + shift])
        try:
            return np.asarray(both[np.unique(ConvexHull(both).simplices)])
        except QhullError:  # a line or a point: the box around it
            half = np.maximum(np.ptp(points, axis=0), FLAT_M) / 2.0
            signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
            return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2.0 + signs * half)
