"""Where fingers could take hold of a foreign part: for tests and oracles, not for the program.

In this order: what the file calls a handle or a knob; what stands out of the part's front the
farthest and can be reached from it; else the board's free edge, pinched from the side. `fits`
says whether the Franka's fingers (80 mm apart at most) really close on it; where it is False,
the part can be touched, not gripped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np
import trimesh
from scipy.spatial import cKDTree
from sklearn.cluster import DBSCAN

from akm_fg.records import FloatArray
from sim.imported.surfaces import Surface
from sim.suites.handles import R_EDGE, R_LYING, R_UPRIGHT

SAMPLES = 6000  # points on the part, and on the corpus
BAR_M = 0.015  # depth of what is gripped, from the foremost point
PAD_M = 0.008  # from the foremost point to the middle of the grip
STANDS_OUT_M = 0.015  # from the front's face: less is a moulding
FINGERS_M = 0.07  # what goes between the fingers, of their 80 mm
ROOM_M = 0.016  # behind a bar, for the fingertips
APART_M = 0.03  # gap between two handles
EDGE_GRIP_M = 0.015  # from a board's free edge to the middle of the grip
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
    everywhere = _samples(part)
    if given is not None:
        near = everywhere[np.linalg.norm(everywhere - given, axis=1) < APART_M]
        points = near if len(near) else everywhere[[_nearest(everywhere, given)]]
        return _bar(points, everywhere, "given")
    named = [s for s in part if any(word in s.name.lower() for word in ("handle", "knob"))]
    if named:
        return _bar(_one(_samples(named), hinge, pivot), everywhere, "handle")
    blocked = _samples(corpus) if corpus else np.zeros((0, 3))
    out = everywhere[everywhere[:, 1] < _face(everywhere) - STANDS_OUT_M]
    out = out[_reachable(out, blocked)]
    if len(out) > 10:
        contact = _bar(_one(out, hinge, pivot), everywhere, "protrusion")
        if contact.fits:
            return contact
    return _edge(everywhere, blocked, hinge)


def _samples(surfaces: Sequence[Surface]) -> FloatArray:
    """(SAMPLES, 3) points, even over the area; the same every time."""
    meshes = [trimesh.Trimesh(s.points, s.faces, process=False) for s in surfaces]
    mesh = trimesh.util.concatenate(meshes)
    return np.asarray(trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)[0])


def _nearest(points: FloatArray, p: FloatArray) -> int:
    return int(np.linalg.norm(points - p, axis=1).argmin())


def _face(points: FloatArray) -> float:
    """Y of the front's face: where most of the foremost half of the part lies."""
    low, high = points[:, 1].min(), points[:, 1].max()
    counts, edges = np.histogram(points[:, 1], bins=max(4, int((high - low) / 0.004)))
    half = max(1, len(counts) // 2)
    return float(edges[int(counts[:half].argmax())])


def _reachable(points: FloatArray, blocked: FloatArray) -> np.ndarray:
    """(N,) whether no corpus lies in front of each point, within a fingertip's width."""
    if not len(points) or not len(blocked):
        return np.ones(len(points), dtype=bool)
    tree = cKDTree(blocked[:, [0, 2]])
    beside = tree.query_ball_point(points[:, [0, 2]], 0.012)
    return np.array(
        [not (blocked[i, 1] < p[1] - 0.005).any() for p, i in zip(points, beside, strict=True)]
    )


def _one(points: FloatArray, hinge: str | None, pivot: FloatArray) -> FloatArray:
    """The points of one handle of several: far from the hinge, or else the largest."""
    labels = DBSCAN(eps=APART_M, min_samples=1).fit_predict(points)
    groups = [points[labels == k] for k in range(labels.max() + 1)]
    groups = [g for g in groups if len(g) >= 0.05 * len(points)]

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


def _edge(part: FloatArray, blocked: FloatArray, hinge: str | None) -> Contact:
    """A pinch of the board at its free edge: beside a hinge that stands, else on top."""
    axis, sign, R = {
        "left": (0, 1.0, R_EDGE["left"]),
        "right": (0, -1.0, R_EDGE["right"]),
        "top": (2, -1.0, R_BELOW),
    }.get(hinge or "", (2, 1.0, R_EDGE["above"]))
    ends = part[:, axis] * sign
    rim = part[(ends > ends.max() - 2.0 * EDGE_GRIP_M) & (part[:, 1] < _face(part) + FINGERS_M)]
    low, high = rim.min(axis=0), rim.max(axis=0)
    along = 2 if axis == 0 else 0
    p_object = (low + high) / 2.0
    p_object[axis] = sign * (ends.max() - EDGE_GRIP_M)
    thickness = float(high[1] - low[1])
    # The finger behind the board: from its back 3 cm on, past the edge and as far as the tip.
    box_low, box_high = p_object.copy(), p_object.copy()
    box_low[axis], box_high[axis] = p_object[axis] - 0.012, p_object[axis] + 0.012
    box_low[along], box_high[along] = p_object[along] - 0.012, p_object[along] + 0.012
    box_low[1], box_high[1] = high[1] + 1e-3, high[1] + 0.03
    inside = ((blocked > box_low) & (blocked < box_high)).all(axis=1).any()
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p_object
    fits = thickness <= FINGERS_M and not inside
    return Contact("edge", float(high[along] - low[along]), thickness, 2.0 * EDGE_GRIP_M, fits, T)
