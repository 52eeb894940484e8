"""Convex pieces of a whole link: as fine as what may touch them needs.

Fine decomposition of a cabinet's hundreds of meshes takes minutes. What lies outside the room of
hand and forearm, wherever the part stands, is its hull; what is nearer is decomposed coarsely, and
finely where it is gripped, or where coarse pieces would fill the room in which the hand stands.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.spatial import ConvexHull

from akm_fg.records import FloatArray
from sim.objects.imported.convex import LoosePart, loose_parts, pieces_of
from sim.objects.imported.decomposition import COARSE, FINE, Decomposition, decomposed
from sim.objects.imported.surfaces import Surface

PROGRESS = logging.getLogger("akm_fg.progress")
EVERY_S = 2.0  # a line of progress
GRIPPED_M = 0.06  # from the grip, where fingers end: what is so near is decomposed finely
FINGERS_OPEN_M = 0.04  # from the grip, to either side
HAND_LONG_M = 0.15  # before the grip
ARM_WIDE_M = 0.1  # from the line of approach: half a hand, and half the forearm
ARM_LONG_M = 0.5  # before the grip: beyond, the arm goes where it likes
NEAR_M = 0.08  # from what the arm needs: hulls so near to it are not enough


@dataclass(slots=True)
class _Mesh:
    """A surface on its way to pieces."""

    surface: Surface
    parts: list[LoosePart]
    pieces: list[FloatArray]
    how: Decomposition | None = None  # which pieces are wanted; None: the hulls will do


def link_pieces(
    name: str, surfaces: Sequence[Surface], T_object_handles: Sequence[gtsam.Pose3]
) -> list[FloatArray]:
    """Corners (N, 3) of convex pieces of a link's surfaces, object frame, m.

    Args:
        name: of the link, for progress.
        surfaces: in the object frame.
        T_object_handles: the grip, at one or several states: z the way the fingers approach, y
            the way they close. The first is that of the closed part.

    Raises:
        MissingDependency: something is not convex, and coacd is not installed.
        DecompositionFailed: CoACD gave up.
    """
    progress = _Progress(name, len(surfaces))
    hand, arm = (
        np.concatenate([T.transformFrom(room.T).T for T in T_object_handles])
        for room in (_hand(), _arm())
    )
    p_grip = T_object_handles[0].translation()
    meshes: list[_Mesh] = []
    for surface in surfaces:
        progress.tell(len([mesh for mesh in meshes if mesh.how is None]))
        meshes.append(_begun(surface, p_grip, arm))
    coarse = [mesh for mesh in meshes if mesh.how is COARSE]
    _decompose(coarse, COARSE, progress)
    for mesh in coarse:
        mesh.how = FINE if any(_within_m(piece, hand) < 0.0 for piece in mesh.pieces) else None
    _decompose([mesh for mesh in meshes if mesh.how is FINE], FINE, progress)
    return [piece for mesh in meshes for piece in mesh.pieces]


def _begun(surface: Surface, p_grip: FloatArray, arm: FloatArray) -> _Mesh:
    """Its hulls, and whether they will do."""
    parts = loose_parts(surface.points, surface.faces)
    mesh = _Mesh(surface, parts, [part.hull() for part in parts])
    if all(part.convex for part in parts):
        return mesh
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    away_m = np.linalg.norm(p_grip - np.clip(p_grip, low, high))
    small = np.ptp(surface.points, axis=0).max() < 2.0 * GRIPPED_M + HAND_LONG_M
    if away_m < GRIPPED_M and small:
        mesh.how = FINE
    elif any(_within_m(piece, arm) < NEAR_M for piece in mesh.pieces):
        mesh.how = COARSE
    return mesh


def _decompose(meshes: Sequence[_Mesh], how: Decomposition, progress: _Progress) -> None:
    """All meshes' hollow parts at once; then each mesh has its pieces."""
    hollow = [(i, part) for i, mesh in enumerate(meshes) for part in mesh.parts if not part.convex]
    left = Counter(i for i, _ in hollow)

    def ready(number: int) -> None:
        left[hollow[number][0]] -= 1
        progress.tell(progress.total - sum(n > 0 for n in left.values()))

    decomposed([(part.points, part.faces) for _, part in hollow], how, ready)
    for mesh in meshes:
        mesh.pieces = pieces_of(mesh.parts, how)


class _Progress:
    """How many meshes of a link are done, every few seconds."""

    def __init__(self, name: str, total: int) -> None:
        self._name, self.total = name, total
        self._told, self._done = time.monotonic(), 0

    def tell(self, done: int) -> None:
        """So many have their pieces; what is begun anew, more finely, is not counted back."""
        self._done = done = max(done, self._done)
        if time.monotonic() - self._told > EVERY_S:
            PROGRESS.info(
                "collision shapes of the %s: %d of %d meshes", self._name, done, self.total
            )
            self._told = time.monotonic()


def _hand() -> FloatArray:
    """(N, 3) points of the room that the hand and its open fingers need, in the grip's frame."""
    sides = np.linspace(-1.0, 1.0, 5) * FINGERS_OPEN_M
    return _grid(sides / 2.0, sides, -np.linspace(0.0, HAND_LONG_M, 16))  # no board is missed


def _arm() -> FloatArray:
    """(N, 3) points of the room of hand and forearm, in the grip's frame."""
    sides = np.array([-1.0, 0.0, 1.0]) * ARM_WIDE_M
    return _grid(sides, sides, -np.linspace(0.0, ARM_LONG_M, 6))


def _grid(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    return np.stack([axis.ravel() for axis in np.meshgrid(x, y, z, indexing="ij")], axis=-1)


def _within_m(piece: FloatArray, points: FloatArray) -> float:
    """At most the way from the piece's hull (M, 3) to the nearest point (N, 3); < 0: within."""
    planes = ConvexHull(piece, qhull_options="QJ").equations
    return float((points @ planes[:, :3].T + planes[:, 3]).max(axis=1).min())
