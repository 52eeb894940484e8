"""Where fingers could take hold of a foreign part: for tests and oracles, not for the program.

In this order: what the file calls a handle or a knob; what stands out of the part's front the
farthest and can be reached from it; else the board's free edge, pinched from the side. `fits`
says whether the Franka's fingers (80 mm apart at most) really close on it; where it is False,
the part can be touched, not gripped.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np
import trimesh
from numpy.typing import NDArray

from akm_fg.records import FloatArray
from sim.objects.imported.surfaces import Surface
from sim.objects.suites.handles import R_EDGE, R_LYING, R_UPRIGHT

SAMPLES = 6000  # points on the part, and on the corpus
BAR_M = 0.015  # depth of what is gripped, from the foremost point
PAD_M = 0.008  # from the foremost point to the middle of the grip
LARGE = 0.4  # of the largest area at one depth: from there on it is a face of the part
STANDS_OUT_M = 0.015  # from the front's face: less is a moulding
FINGERS_M = 0.07  # what goes between the fingers, of their 80 mm
ROOM_M = 0.016  # behind a bar, for the fingertips
APART_M = 0.03  # gap between two handles
EDGE_GRIP_M = 0.015  # from a board's free edge to the middle of the grip
FINGER_DEEP_M, FINGER_LONG_M = 0.03, 0.05  # room for one behind a board, and along it
FINGER_TIP_M = 0.01  # beyond the middle of the grip
FAR_M = 1.0  # in front of the grip: the hand needs less, and a wall beyond hinders nobody
FACE_BINS_MAX = 5000  # of the search for the front's face: 20 m
HANDLE = re.compile(r"handle|knob|(?<![a-z])(pull(?![_ -]?out)|grip)s?(?![a-z])", re.IGNORECASE)
R_BELOW = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])


@dataclass(frozen=True, slots=True)
class Contact:
    """A grip on the closed part."""

    style: Literal["handle", "protrusion", "edge", "given"]
    length_m: float  # along the bar
    thickness_m: float  # between the fingers
    reach_m: float  # from the grip's middle to the face behind it
    fits: bool  # the fingers can close on it
    T_object_handle: FloatArray  # (4, 4); z the way the fingers approach, x along the bar

    def pose(self) -> gtsam.Pose3:
        """T_object_handle."""
        return gtsam.Pose3(gtsam.Rot3(self.T_object_handle[:3, :3]), self.T_object_handle[:3, 3])


def find_contact(
    part: Sequence[Surface],
    corpus: Sequence[Surface],
    hinge: str | None,
    pivot: FloatArray,
    given: FloatArray | None = None,
) -> Contact:
    """The grip by the rule above, or the one nearest to the point `given` (3,), object frame."""
    everywhere, ahead = _samples(_mesh(part))
    if given is not None:
        near = everywhere[np.linalg.norm(everywhere - given, axis=1) < APART_M]
        points = near if len(near) else everywhere[[_nearest(everywhere, given)]]
        return _bar(points, everywhere, "given")
    named = _named(part)
    if named:
        return _bar(_one(_samples(_mesh(named))[0], hinge, pivot), everywhere, "handle")
    still = _mesh(corpus) if corpus else None
    face_m = _face(everywhere[ahead] if ahead.any() else everywhere)
    corners = np.concatenate([surface.points for surface in part])
    points = np.concatenate([everywhere, corners])  # a knob has more corners than samples
    out = points[points[:, 1] < face_m - STANDS_OUT_M]
    out = out[_reachable(out, still)]
    if len(out) > 10:
        contact = _bar(_one(out, hinge, pivot), everywhere, "protrusion")
        if contact.fits:
            return contact
    return _edge(everywhere, face_m, still, hinge)


def _named(part: Sequence[Surface]) -> list[Surface]:
    """What the file calls a handle: shapes, or else links, where other links are the board."""
    shapes = [surface for surface in part if HANDLE.search(surface.name)]
    links = [surface for surface in part if HANDLE.search(surface.link)]
    return shapes or (links if len(links) < len(part) else [])


def _mesh(surfaces: Sequence[Surface]) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.util.concatenate([surface.mesh() for surface in surfaces])  # type: ignore[assignment]
    return mesh


def _samples(mesh: trimesh.Trimesh) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(SAMPLES, 3) points, even over the area, and whether the surface there faces along y.

    The same every time.
    """
    points, face = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
    return np.asarray(points), np.asarray(np.abs(mesh.face_normals[face, 1]) > 0.7)


def _nearest(points: FloatArray, p: FloatArray) -> int:
    return int(np.linalg.norm(points - p, axis=1).argmin())


def _face(points: FloatArray) -> float:
    """Where along y the front's face lies: the foremost large area among `points` (N, 3)."""
    low, high = points[:, 1].min(), points[:, 1].max()
    bins = min(max(4, int((high - low) / 0.004)), FACE_BINS_MAX)
    counts, edges = np.histogram(points[:, 1], bins=bins)
    return float(edges[int((counts >= LARGE * counts.max()).argmax())])


def _reachable(points: FloatArray, corpus: trimesh.Trimesh | None) -> NDArray[np.bool_]:
    """(N,) whether nothing of the corpus lies in front of each point."""
    ahead = np.tile([0.0, -1.0, 0.0], (len(points), 1))
    return ~_blocked(points, ahead, FAR_M, corpus)


def _blocked(
    points: FloatArray, ways: FloatArray, length_m: float, corpus: trimesh.Trimesh | None
) -> NDArray[np.bool_]:
    """(N,) whether the corpus cuts the stretch from each point along its way (N, 3), unit."""
    blocked = np.zeros(len(points), dtype=bool)
    if corpus is None or not len(points):
        return blocked
    hits, rays, _ = corpus.ray.intersects_location(points, ways, multiple_hits=False)
    near = np.linalg.norm(hits - points[rays], axis=1) < length_m
    blocked[rays[near]] = True
    return blocked


def _one(points: FloatArray, hinge: str | None, pivot: FloatArray) -> FloatArray:
    """The points of one handle of several: far from the hinge, or else the largest."""
    from sklearn.cluster import DBSCAN  # a second to load: for what is new alone

    labels = DBSCAN(eps=APART_M, min_samples=1).fit_predict(points)
    groups = [points[labels == k] for k in range(labels.max() + 1)]
    most = max(len(group) for group in groups)
    groups = [group for group in groups if len(group) >= 0.2 * most]  # the others are mouldings

    def rank(group: FloatArray) -> tuple[float, float]:
        middle = group.mean(axis=0)
        across = {"left": 0, "right": 0, "top": 2, "bottom": 2}.get(hinge or "", None)
        far = 0.0 if across is None else abs(float(middle[across] - pivot[across]))
        return (round(far, 2), float(len(group)))

    return max(groups, key=rank)


def _bar(
    points: FloatArray, part: FloatArray, style: Literal["handle", "protrusion", "given"]
) -> Contact:
    """A grip from the front on what `points` (N, 3) show of a handle."""
    foremost = float(points[:, 1].min())
    bar = points[points[:, 1] < foremost + BAR_M]
    low, high = bar.min(axis=0), bar.max(axis=0)
    extent, middle = high - low, (low + high) / 2.0
    lying = bool(extent[0] >= extent[2])
    p_object = np.array([middle[0], foremost + PAD_M, middle[2]])
    thickness = float(extent[2 if lying else 0])
    reach = _room_behind(p_object, bar, part)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = (R_LYING if lying else R_UPRIGHT), p_object
    fits = thickness <= FINGERS_M and reach >= ROOM_M
    return Contact(style, float(extent[0 if lying else 2]), thickness, reach, fits, T)


def _room_behind(p_object: FloatArray, bar: FloatArray, part: FloatArray) -> float:
    """From the grip to the face beside the bar, where the fingertips end, m."""
    beside = np.linalg.norm((part - p_object)[:, [0, 2]], axis=1) < 0.06
    behind = part[beside & (part[:, 1] > bar[:, 1].max() + 1e-3)]
    if not len(behind):
        return 0.05
    return float(np.median(behind[:, 1]) - p_object[1])


def _edge(
    part: FloatArray, face_m: float, corpus: trimesh.Trimesh | None, hinge: str | None
) -> Contact:
    """A pinch of the board at its free edge: beside a hinge that stands, else on top."""
    axis, sign, R = {
        "left": (0, 1.0, R_EDGE["left"]),
        "right": (0, -1.0, R_EDGE["right"]),
        "top": (2, -1.0, R_BELOW),
    }.get(hinge or "", (2, 1.0, R_EDGE["above"]))
    board = part[part[:, 1] < face_m + FINGERS_M]  # what is behind it may stand higher
    ends = board[:, axis] * sign
    rim = board[ends > ends.max() - 2.0 * EDGE_GRIP_M]
    low, high = rim.min(axis=0), rim.max(axis=0)
    along = 2 if axis == 0 else 0
    p_object = (low + high) / 2.0
    p_object[axis] = sign * (ends.max() - EDGE_GRIP_M)
    thickness = float(high[1] - low[1])
    # Rays where the finger behind the board goes in, from outside to its tip.
    starts = np.tile(p_object, (9, 1))
    starts[:, axis] += sign * FINGER_LONG_M
    beside, behind = np.meshgrid([-0.01, 0.0, 0.01], np.array([0.1, 0.5, 1.0]) * FINGER_DEEP_M)
    starts[:, along] += beside.ravel()
    starts[:, 1] = high[1] + behind.ravel()
    way = np.zeros((9, 3))
    way[:, axis] = -sign
    blocks = _blocked(starts, way, FINGER_LONG_M + FINGER_TIP_M, corpus).any()
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p_object
    fits = thickness <= FINGERS_M and not blocks
    return Contact("edge", float(high[along] - low[along]), thickness, 2.0 * EDGE_GRIP_M, fits, T)
