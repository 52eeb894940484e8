"""Convex pieces of a whole link: fine where the hand takes hold, coarse elsewhere.

Fine decomposition of a cabinet's hundreds of meshes takes minutes. Coarse pieces fill corners and
shelves, where nothing is touched; the room in which the hand stands stays free.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence

import gtsam
import numpy as np
from scipy.spatial import ConvexHull

from akm_fg.records import FloatArray
from sim.objects.imported.convex import COARSE, FINE, convex_pieces
from sim.objects.imported.surfaces import Surface

PROGRESS = logging.getLogger("akm_fg.progress")
EVERY_S = 2.0  # a line of progress
GRIPPED_M = 0.1  # from the grip: what is so near is decomposed finely
FINGERS_OPEN_M = 0.04  # from the grip, to either side
HAND_LONG_M = 0.15  # before the grip


def link_pieces(
    name: str, surfaces: Sequence[Surface], T_object_handle: gtsam.Pose3
) -> list[FloatArray]:
    """Corners (N, 3) of convex pieces of a link's surfaces, object frame, m.

    Args:
        name: of the link, for progress.
        surfaces: in the object frame.
        T_object_handle: the grip: z the way the fingers approach, y the way they close.
    """
    pieces: list[FloatArray] = []
    hand = _hand(T_object_handle)
    told = time.monotonic()
    for i, surface in enumerate(surfaces):
        if time.monotonic() - told > EVERY_S:
            PROGRESS.info("collision shapes of the %s: %d of %d meshes", name, i, len(surfaces))
            told = time.monotonic()
        pieces += _pieces(surface, hand, T_object_handle.translation())
    return pieces


def _pieces(surface: Surface, hand: FloatArray, p_grip: FloatArray) -> list[FloatArray]:
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    away_m = np.linalg.norm(p_grip - np.clip(p_grip, low, high))
    small = np.ptp(surface.points, axis=0).max() < 2.0 * GRIPPED_M + HAND_LONG_M
    if away_m < GRIPPED_M and small:
        return convex_pieces(surface.points, surface.faces, FINE)
    pieces = convex_pieces(surface.points, surface.faces, COARSE)
    if len(pieces) and any(_covers(piece, hand) for piece in pieces):
        return convex_pieces(surface.points, surface.faces, FINE)
    return pieces


def _hand(T_object_handle: gtsam.Pose3) -> FloatArray:
    """(N, 3) points of the room that the hand and its open fingers need, object frame."""
    sides = np.array([-1.0, 0.0, 1.0]) * FINGERS_OPEN_M
    back = -np.linspace(0.0, HAND_LONG_M, 6)
    along, across, before = np.meshgrid(sides / 2.0, sides, back, indexing="ij")
    points = np.stack([along.ravel(), across.ravel(), before.ravel()], axis=-1)
    return np.asarray(
        points @ T_object_handle.rotation().matrix().T + T_object_handle.translation()
    )


def _covers(piece: FloatArray, points: FloatArray) -> bool:
    """Whether any of the points (N, 3) lies in the hull of the piece (M, 3)."""
    planes = ConvexHull(piece, qhull_options="QJ").equations
    return bool(((points @ planes[:, :3].T + planes[:, 3]).max(axis=1) < 0.0).any())
