"""Handles: bars, round bars, arches, knobs, lips and edges, as boxes and rods on a front.

In the handle's own frame x runs along the bar, z into the front, and the origin is the middle of
what the fingers close on, as in `sim.objects.part_spec.BuiltObject`.
"""

from __future__ import annotations

import gtsam
import numpy as np

from akm_fg.records import FloatArray
from sim.objects.meshes import Box
from sim.objects.suites.furniture_spec import FurnitureSpec, HandleSpec

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
EDGE_GRIP_M = 0.018  # from the edge to the middle of what the fingers pinch


def handle_pose(spec: FurnitureSpec, lower: FloatArray, upper: FloatArray) -> gtsam.Pose3:
    """T_part_handle on a front with the corners `lower` and `upper` (3,), in the part's frame."""
    handle, middle = spec.handle, (lower + upper) / 2.0
    half = (upper - lower) / 2.0
    if handle.style == "edge":
        return _edge_pose(spec, lower, upper)
    upright = spec.hinge in ("left", "right") or spec.family == "sliding"
    room = half[2 if upright else 0] - handle.length_m / 2.0 - 0.02
    slide = handle.along * max(float(room), 0.0)
    edge = min(handle.edge_m, float(half[0 if upright else 2]))
    p_part = np.array([middle[0], lower[1] - handle.reach_m, middle[2]])
    if upright:
        p_part[2] += slide
        if spec.family != "sliding":  # there it stands in the middle: the hand fits the recess
            p_part[0] = upper[0] - edge if spec.hinge == "left" else lower[0] + edge
    else:
        p_part[0] += slide
        p_part[2] = _level(spec, lower, upper, edge)
    return gtsam.Pose3(gtsam.Rot3(R_UPRIGHT if upright else R_LYING), p_part)


def _level(spec: FurnitureSpec, lower: FloatArray, upper: FloatArray, edge: float) -> float:
    """Height of a lying handle on its front."""
    if spec.handle.style == "lip":  # grows out of the free edge
        inset = spec.handle.thickness_m / 2.0
        return float(lower[2] + inset if spec.hinge == "top" else upper[2] - inset)
    if spec.hinge == "top":
        return float(lower[2] + edge)
    if spec.hinge == "bottom":
        return float(upper[2] - edge)
    return float(max(upper[2] - 1.3 * edge, (lower[2] + upper[2]) / 2.0))


def _edge_pose(spec: FurnitureSpec, lower: FloatArray, upper: FloatArray) -> gtsam.Pose3:
    """T_part_handle where the fingers pinch a board that stands over at its free edge."""
    handle, p_part = spec.handle, (lower + upper) / 2.0
    p_part[1] = lower[1] + handle.thickness_m / 2.0
    out = _overhang_m(spec) - EDGE_GRIP_M
    upright = spec.hinge in ("left", "right")
    room = (upper - lower)[2 if upright else 0] / 2.0 - handle.length_m / 2.0
    p_part[2 if upright else 0] += handle.along * max(float(room), 0.0)
    if spec.hinge == "left":
        p_part[0] = upper[0] + out
    elif spec.hinge == "right":
        p_part[0] = lower[0] - out
    else:
        p_part[2] = upper[2] + out
    return gtsam.Pose3(gtsam.Rot3(R_EDGE[str(spec.hinge) if upright else "above"]), p_part)


def _overhang_m(spec: FurnitureSpec) -> float:
    """From the front's usual edge, which leaves the carcass's wall bare, to the strip's."""
    return spec.handle.reach_m + spec.wall_m


def edge_strip(spec: FurnitureSpec, lower: FloatArray, upper: FloatArray) -> Box:
    """What a front without a handle has more than other fronts: its board, standing over."""
    reach, thickness = _overhang_m(spec), spec.handle.thickness_m
    low, high = lower.copy(), upper.copy()
    high[1] = lower[1] + thickness
    match spec.hinge:
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
