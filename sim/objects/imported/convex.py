"""Collision shapes: a mesh as convex pieces, decomposed once and kept.

PyBullet takes the convex hull of a mesh that moves, which fills the gap behind a handle. Pieces
that are convex as they are stay so; the rest is decomposed with CoACD, whose result is kept in
the user's cache folder under the content of the mesh.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from akm_fg.errors import MissingDependency
from akm_fg.records import FloatArray
from sim.bullet import quiet
from sim.cache import digest, kept
from sim.objects.obj_files import IntArray

PIECE_VERTICES = 64  # at most, of one convex piece
SEED = 0  # of its tree search
FLAT_M = 0.002  # thickness given to what has none
ON_HULL = 0.02  # of the size: faces so near the hull are on it
CONVEX_SHARE = 0.97  # of the area on the hull, from which a piece is called convex
PIECES_MAX = 48  # loose pieces of one mesh; more are decomposed together


@dataclass(frozen=True, slots=True)
class Decomposition:
    """How finely CoACD works; the names are its own."""

    threshold: float  # concavity, of the piece's size
    mcts_iterations: int = 20  # its default of 150 takes five times as long for as good pieces
    mcts_nodes: int = 20
    mcts_max_depth: int = 3
    resolution: int = 500  # samples of a surface
    preprocess_resolution: int = 30  # of the closed surface that is made of an open one


FINE = Decomposition(0.05)  # what is gripped
COARSE = Decomposition(0.4, mcts_nodes=10, mcts_max_depth=2, preprocess_resolution=20)


def convex_pieces(
    points: FloatArray, faces: IntArray, how: Decomposition = FINE
) -> list[FloatArray]:
    """Corners (N, 3) of convex pieces that together fill the mesh, in its frame, m."""
    mesh = trimesh.Trimesh(points, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    parts = mesh.split(only_watertight=False, repair=False)
    if len(parts) > PIECES_MAX:
        parts = [mesh]
    pieces: list[FloatArray] = []
    for part in parts:
        corners = np.asarray(part.vertices, dtype=float)
        if is_convex(corners, np.asarray(part.faces)):
            pieces.append(hull_corners(corners))
        else:
            pieces += _decomposed(corners, np.asarray(part.faces, dtype=np.int64), how)
    return pieces


def is_convex(points: FloatArray, faces: IntArray) -> bool:
    """Whether (nearly) all faces lie on the hull; holes in the surface do not matter."""
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat
        return True
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


def _decomposed(points: FloatArray, faces: IntArray, how: Decomposition) -> list[FloatArray]:
    """CoACD's pieces, from the cache or made now."""
    size = float(np.ptp(points, axis=0).max())
    shift = points.min(axis=0)
    unit = np.round((points - shift) / size, 6)  # the same at every scale and place
    key = digest(_version(), f"{how} {PIECE_VERTICES} {SEED}", unit.tobytes(), faces.tobytes())

    def make(folder: Path) -> None:
        np.savez(folder / "pieces.npz", *_run_coacd(unit, faces, how))

    stored = np.load(kept(f"convex-{key}", make) / "pieces.npz", allow_pickle=False)
    return [stored[f"arr_{i}"] * size + shift for i in range(len(stored.files))]


def _version() -> str:
    try:
        import importlib.metadata

        return importlib.metadata.version("coacd")
    except ModuleNotFoundError as error:
        raise MissingDependency(
            "this object's meshes are not convex and need coacd; install akm-fg[sim]"
        ) from error


def _run_coacd(points: FloatArray, faces: IntArray, how: Decomposition) -> list[FloatArray]:
    import coacd

    with quiet():
        coacd.set_log_level("error")
        pieces = coacd.run_coacd(
            coacd.Mesh(points, faces.astype(np.int32)),
            **asdict(how),
            max_ch_vertex=PIECE_VERTICES,
            decimate=True,
            seed=SEED,
        )
    return [hull_corners(np.asarray(vertices, dtype=float)) for vertices, _ in pieces]
