"""Grasps of a board at its free edge: one finger on the side that is seen, one behind it.

How thick the board is, and whether there is room behind it, one view from before it does not tell:
the thickness of furniture boards is assumed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.records import FloatArray


@dataclass(frozen=True, slots=True)
class EdgeConfig:
    """A free edge, and how it is pinched."""

    directions: int = 16  # in the board's plane in which its end is looked for
    flat_m: float = 0.010  # from the plane through the contact, a point is of the board
    band_m: float = 0.010  # half width of the strip in which the end is looked for
    near_m: float = 0.035  # the board ends no farther from the contact
    beyond_m: float = 0.03  # and nothing of it comes so far behind its end
    least_points: int = 8
    board_m: float = 0.018
    deep_m: float = 0.018  # from the edge to the middle of the pads: `EDGE_GRIP` of the suites
    tilts_rad: tuple[float, ...] = (0.0, 0.4, -0.4)  # in the board's plane: both pads stay on it
    # About the edge, with the hand before the front: an arm that stands there seldom reaches round
    # a wide front to come along it. Within the friction cone of rubber on lacquer (45 deg) the
    # pads do not slide off.
    oblique_rad: tuple[float, ...] = (0.35, 0.6)
    apart_rad: float = 1.1  # between directions that are both taken
    best: int = 3  # directions


def edge_poses(
    points: FloatArray,
    p_world: FloatArray,
    normal: FloatArray,
    pixel_m: float,
    config: EdgeConfig,
) -> Iterator[tuple[FloatArray, float]]:
    """Gripper poses (4, 4) with their tilts, at the nearest edges first.

    Args:
        points: (N, 3) of the object near the contact.
        p_world: (3,) the contact.
        normal: (3,) unit, out of the board.
        pixel_m: between neighbouring points.
        config: tuning.
    """
    aside = np.cross([0.0, 0.0, 1.0], normal)
    if np.linalg.norm(aside) < 0.1:
        aside = np.cross([1.0, 0.0, 0.0], normal)
    x = aside / np.linalg.norm(aside)
    plane = np.column_stack([x, np.cross(normal, x)])
    d = points - p_world
    flat = np.abs(d @ normal) < config.flat_m
    xy = d[flat] @ plane
    ends: list[tuple[float, FloatArray]] = []
    for angle in np.arange(config.directions) * 2.0 * np.pi / config.directions:
        out = np.array([np.cos(angle), np.sin(angle)])
        end = _end(xy, out, pixel_m, config)
        if end is not None:
            ends.append((end, plane @ out))
    ends.sort(key=lambda one: one[0])
    for end, out_world in _apart(ends, config)[: config.best]:
        for turn, tilt in pinch_turns(config):
            yield pinch(p_world + end * out_world, out_world, normal, turn, config).matrix(), tilt


def pinch_turns(config: EdgeConfig) -> list[tuple[gtsam.Rot3, float]]:
    """How a hand that pinches an edge may be turned, and by how much: not at all first."""
    turns = [(gtsam.Rot3.Ry(tilt), tilt) for tilt in config.tilts_rad]
    # About x the approach, -out, leans towards -normal: the hand is before the front.
    turns[1:1] = [(gtsam.Rot3.Rx(oblique), oblique) for oblique in config.oblique_rad]
    return turns


def pinch(
    p_edge: FloatArray,
    out: FloatArray,
    normal: FloatArray,
    turn: gtsam.Rot3,
    config: EdgeConfig,
) -> gtsam.Pose3:
    """The gripper's pose at a board's edge, in the frame of the points.

    Args:
        p_edge: (3,) on the board's outer face, at its end.
        out: (3,) unit, in the board, across the edge and off it.
        normal: (3,) unit, out of the board's outer face.
        turn: of the hand, one of `pinch_turns`.
        config: how thick the board is, and how deep the pads go.
    """
    R = np.column_stack([np.cross(normal, -out), normal, -out])
    p = p_edge - config.deep_m * out - config.board_m / 2.0 * normal
    return gtsam.Pose3(gtsam.Rot3(R) * turn, p)


def _apart(
    ends: list[tuple[float, FloatArray]], config: EdgeConfig
) -> list[tuple[float, FloatArray]]:
    """The nearest end, and others in clearly different directions: what is between is oblique."""
    kept: list[tuple[float, FloatArray]] = []
    for end, out in ends:
        if all(out @ other < np.cos(config.apart_rad) for _, other in kept):
            kept.append((end, out))
    return kept


def _end(xy: FloatArray, out: FloatArray, pixel_m: float, config: EdgeConfig) -> float | None:
    """How far from the contact the board ends in a direction (2,); None: it goes on."""
    along, across = xy @ out, xy @ np.array([-out[1], out[0]])
    strip = np.sort(along[(np.abs(across) < config.band_m) & (along > -config.band_m)])
    if len(strip) < config.least_points:
        return None
    steps = np.flatnonzero(np.diff(strip) > 3.0 * pixel_m)
    end = float(strip[steps[0]] if len(steps) else strip[-1])
    goes_on = ((strip > end) & (strip < end + config.beyond_m)).any()
    return None if goes_on or not 0.0 <= end <= config.near_m else end
