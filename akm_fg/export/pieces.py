"""Convex pieces for collisions, and nominal masses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from akm_fg.errors import InsufficientData, MissingDependency
from akm_fg.export.config import ExportConfig
from akm_fg.export.description import Mass, Mesh
from akm_fg.export.fusion import with_fewer_triangles
from akm_fg.records import FloatArray

_PREPROCESS = 30  # of CoACD's voxels along the object: it closes what was seen from one side
_SEARCH = {"mcts_nodes": 10, "mcts_iterations": 40, "mcts_max_depth": 2, "resolution": 1000}
_GRAY = 160


def convex_pieces(mesh: Mesh, config: ExportConfig, one_hull: bool = False) -> tuple[Mesh, ...]:
    """A mesh cut coarsely into convex pieces (Wei et al., "CoACD", 2022), closed each.

    Args:
        mesh: open or closed.
        config: tuning.
        one_hull: the convex hull of all of it instead.

    Raises:
        MissingDependency: CoACD is not installed.
        InsufficientData: the mesh is flat.
    """
    if one_hull:
        return (hull(mesh.points),)
    try:
        import coacd
    except ImportError as error:
        missing = "convex pieces need coacd; install akm-fg[export], or take --collision hull"
        raise MissingDependency(missing) from error
    coacd.set_log_level("error")
    small = with_fewer_triangles(mesh, config.collision_triangles)
    found = coacd.run_coacd(
        coacd.Mesh(small.points, small.triangles.astype(np.int32)),
        threshold=config.collision_threshold,
        max_convex_hull=config.most_pieces,
        preprocess_resolution=_PREPROCESS,
        **_SEARCH,
    )
    return tuple(hull(np.asarray(points)) for points, _ in found)


def hull(points: FloatArray) -> Mesh:
    """The convex hull of points (N, 3), its triangles turned outward.

    Raises:
        InsufficientData: they lie in a plane.
    """
    try:
        made = ConvexHull(points)
    except QhullError as error:
        raise InsufficientData("a surface without volume has no convex hull") from error
    corners, triangles = made.points[made.vertices], _renumbered(made.simplices, made.vertices)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    inward = (np.cross(b - a, c - a) * made.equations[:, :3]).sum(axis=1) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return Mesh(corners, triangles, np.full((len(corners), 3), _GRAY, np.uint8))


def _renumbered(simplices: NDArray[np.int32], vertices: NDArray[np.int32]) -> NDArray[np.int64]:
    place = np.full(int(vertices.max()) + 1, -1, dtype=np.int64)
    place[vertices] = np.arange(vertices.size)
    return place[simplices]


def nominal_mass(pieces: tuple[Mesh, ...], config: ExportConfig) -> Mass:
    """Of boxes around the pieces, of one density."""
    masses, centres, inertias = [], [], []
    for piece in pieces:
        low, high = piece.points.min(axis=0), piece.points.max(axis=0)
        side = high - low
        mass = config.density_kg_m3 * float(ConvexHull(piece.points).volume)
        masses.append(mass)
        centres.append((low + high) / 2)
        inertias.append(mass / 12 * ((side**2).sum() - side**2))
    m, c, inertia = np.array(masses), np.array(centres), np.array(inertias)
    middle = (m[:, None] * c).sum(axis=0) / m.sum()
    off = c - middle
    shifted = m[:, None] * ((off**2).sum(axis=1, keepdims=True) - off**2)  # parallel axes
    total = float(m.sum())
    scale = max(1.0, config.least_mass_kg / total)
    return Mass(scale * total, middle, scale * np.asarray((inertia + shifted).sum(axis=0)))
