"""Handles: bars, round bars, arches, knobs, lips and edges, as boxes and rods on a front.

In the handle's own frame x runs along the bar, z into the front, and the origin is the middle of
what the fingers close on, as in `sim.objects.part_spec.BuiltObject`.
"""

from __future__ import annotations

import gtsam
import numpy as np

from akm_fg.records import FloatArray
from sim.objects.meshes import Box
from sim.objects.part_spec import Hinge
from sim.objects.suites.furniture_spec import FurnitureSpec, HandleSpec, handle_spot

POST_M = 0.012  # thickness of what joins a bar to the front
# Columns: the handle's x, y and z in the object frame; y of the object points into the front.
R_LYING = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
R_UPRIGHT = np.array([[0, 1.0, 0], [0, 0, 1.0], [1.0, 0, 0]])
# Of an edge: z into the board, from the right, from the left and from above; y across the board.
R_EDGE = {
    "left": np.array([[0, 0, -1.0], [0, 1.0, 0], [1.0, 0, 0]]),
    "right": np.array([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]]),
    "above": np.array([[-1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]]),
}
BAR_END_M = 0.02  # from the end of a bar to the edge of its front
EDGE_GRIP_M = 0.018  # from the edge to the middle of what the fingers pinch


def handle_pose(spec: FurnitureSpec, lower: FloatArray, upper: FloatArray) -> gtsam.Pose3:
    """T_part_handle on the free front with the corners `lower` and `upper` (3,), part's frame."""
    return pose_on_front(spec, spec.hinge, spec.handle, lower, upper)


def pose_on_front(
    spec: FurnitureSpec,
    hinge: Hinge | None,
    handle: HandleSpec,
    lower: FloatArray,
    upper: FloatArray,
) -> gtsam.Pose3:
    """T_front_handle in the manner of the object.

    Args:
        spec: the object.
        hinge: of the front, or what it looks like it had.
        handle: the one that goes there.
        lower: (3,) corner of the front, in the frame that is asked for.
        upper: (3,) the opposite corner.
    """
    if handle.style == "edge":
        return _edge_pose(spec, hinge, lower, upper)
    half, p_front = (upper - lower) / 2.0, (lower + upper) / 2.0
    p_front[1] = lower[1] - handle.reach_m
    if handle.style == "lip":  # all along one edge, the free one's
        inset = handle.thickness_m / 2.0
        p_front[0] += handle.along * _room(half[0], handle.length_m / 2.0 + BAR_END_M)
        p_front[2] = lower[2] + inset if spec.hinge == "top" else upper[2] - inset
        return gtsam.Pose3(gtsam.Rot3(R_LYING), p_front)
    spot = handle_spot(handle, spec.looks, hinge, spec.family)
    bar, across = handle.length_m / 2.0 + BAR_END_M, handle.edge_m
    p_front[0] += spot.right * _room(half[0], across if spot.upright else bar)
    p_front[2] += spot.up * _room(half[2], bar if spot.upright else across)
    return gtsam.Pose3(gtsam.Rot3(R_UPRIGHT if spot.upright else R_LYING), p_front)


def _room(half_m: float, needed_m: float) -> float:
    return max(float(half_m) - needed_m, 0.0)


def _edge_pose(
    spec: FurnitureSpec, hinge: Hinge | None, lower: FloatArray, upper: FloatArray
) -> gtsam.Pose3:
    """T_part_handle where the fingers pinch a board that stands over at its free edge."""
    handle, p_part = spec.handle, (lower + upper) / 2.0
    p_part[1] = lower[1] + handle.thickness_m / 2.0
    out = _overhang_m(spec) - EDGE_GRIP_M
    upright = hinge in ("left", "right")
    room = (upper - lower)[2 if upright else 0] / 2.0 - handle.length_m / 2.0
    p_part[2 if upright else 0] += handle.along * max(float(room), 0.0)
    if hinge == "left":
        p_part[0] = upper[0] + out
    elif hinge == "right":
        p_part[0] = lower[0] - out
    else:
        p_part[2] = upper[2] + out
    return gtsam.Pose3(gtsam.Rot3(R_EDGE[str(hinge) if upright else "above"]), p_part)


def _overhang_m(spec: FurnitureSpec) -> float:
    """From the front's usual edge, which leaves the carcass's wall bare, to the strip's."""
    return spec.handle.reach_m + spec.wall_m


def edge_strip(
    spec: FurnitureSpec, hinge: Hinge | None, lower: FloatArray, upper: FloatArray
) -> Box:
    """What a front without a handle has more than other fronts: its board, standing over."""
    reach, thickness = _overhang_m(spec), spec.handle.thickness_m
    low, high = lower.copy(), upper.copy()
    high[1] = lower[1] + thickness
    match hinge:
        case "left":
            low[0], high[0] = upper[0], upper[0] + reach
        case "right":
            low[0], high[0] = lower[0] - reach, lower[0]
        case _:
            low[2], high[2] = upper[2], upper[2] + reach
    pose = gtsam.Pose3(gtsam.Rot3(), (low + high) / 2.0)
    return Box("edge", high - low, pose, "front")


def handle_boxes(handle: HandleSpec, T_part_handle: gtsam.Pose3) -> list[Box]:
    """The solids of a handle in the part's frame; an edge has none (see `edge_strip`)."""
    match handle.style:
        case "bar":
            pieces = _bar(handle, rounded=False)
        case "rod":
            pieces = _bar(handle, rounded=True)
        case "arch":
            pieces = _arch(handle)
        case "knob":
            pieces = _knob(handle)
        case "lip":
            pieces = _lip(handle)
        case "edge":
            pieces = []
    return [
        Box(f"handle_{i}", size, T_part_handle * T, "handle", rounded)
        for i, (size, T, rounded) in enumerate(pieces)
    ]


_Piece = tuple[FloatArray, gtsam.Pose3, bool]


def _at(x: float, y: float, z: float, R: gtsam.Rot3 | None = None) -> gtsam.Pose3:
    return gtsam.Pose3(R or gtsam.Rot3(), np.array([x, y, z]))


def _bar(handle: HandleSpec, rounded: bool) -> list[_Piece]:
    """A straight bar on two posts."""
    t, reach = handle.thickness_m, handle.reach_m
    along_x = gtsam.Rot3.Ry(np.pi / 2)  # a rod lies along its own z
    size = np.array([t, t, handle.length_m])
    pieces = [(size, _at(0.0, 0.0, 0.0, along_x), rounded)]
    for side in (-1.0, 1.0):
        x = side * (handle.length_m / 2.0 - 0.6 * POST_M)
        post = np.array([POST_M, min(t, POST_M), reach])
        pieces.append((post, _at(x, 0.0, reach / 2.0), rounded))
    return pieces


def _arch(handle: HandleSpec, segments: int = 7) -> list[_Piece]:
    """A bow from the front and back to it, flat in the middle."""
    edges = np.linspace(-1.0, 1.0, segments + 1)
    x = edges * handle.length_m / 2.0
    z = handle.reach_m * np.abs(edges) ** 3.0
    pieces = []
    for i in range(segments):
        dx, dz = x[i + 1] - x[i], z[i + 1] - z[i]
        size = np.array([float(np.hypot(dx, dz)) + 0.3 * handle.thickness_m] * 3)
        size[1], size[2] = handle.thickness_m, 0.8 * handle.thickness_m
        R = gtsam.Rot3.Ry(-float(np.arctan2(dz, dx)))
        pieces.append((size, _at((x[i] + x[i + 1]) / 2, 0.0, (z[i] + z[i + 1]) / 2, R), False))
    return pieces


def _knob(handle: HandleSpec) -> list[_Piece]:
    """A disc on a stem."""
    head, reach = 0.020, handle.reach_m
    disc = np.array([handle.length_m, handle.length_m, head])
    stem = np.array([0.4 * handle.length_m, 0.4 * handle.length_m, reach])
    return [(disc, _at(0.0, 0.0, 0.0), True), (stem, _at(0.0, 0.0, reach / 2.0), True)]


def _lip(handle: HandleSpec) -> list[_Piece]:
    """A ledge that stands out of the front all along the fingers' grip."""
    depth = handle.reach_m + 0.012
    size = np.array([max(handle.length_m, 0.12), handle.thickness_m, depth])
    return [(size, _at(0.0, 0.0, handle.reach_m - depth / 2.0), False)]
