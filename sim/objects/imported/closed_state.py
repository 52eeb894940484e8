"""Where a joint of a foreign file is closed, and which way it opens.

Files do not say. The rule: a joint with limits is closed at the one of its two ends where the
whole object, every other joint at rest, fills the smaller upright bounding box; where both are
the same to 1 % (a door that slides within its frame, a knob), at the end nearer to 0, and of two
that are equally near at the lower. A joint without limits is closed at 0, as the file has it,
and opens the way that makes the box grow, or else its positive way, by one full turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.records import FloatArray
from sim.objects.urdf.urdf_model import Joint, UrdfModel

SAME_BOX = 0.01
TURN_RAD = 2.0 * np.pi
PROBE_RAD = np.deg2rad(40.0)  # how far a joint without limits is opened to see which way it grows


@dataclass(frozen=True, slots=True)
class Opening:
    """A joint's state in its file's own sign and units, m or rad before any scale."""

    closed: float
    sign: float  # +1 where the file's state grows as the part opens, else -1
    travel: float  # from closed to the other end


LinkPoints = dict[str, FloatArray]  # (N, 3) of each link, in its frame


def resting(model: UrdfModel) -> dict[str, float]:
    """Each movable joint at 0, or at the limit nearest to it."""
    return {j.name: float(np.clip(0.0, j.lower, j.upper)) for j in model.movable()}


def closed_states(model: UrdfModel, points: LinkPoints) -> dict[str, float]:
    """Each movable joint, closed."""
    return {joint.name: opening(model, joint, points).closed for joint in model.movable()}


def opening(model: UrdfModel, joint: Joint, points: LinkPoints) -> Opening:
    """Where the joint is closed, and how it opens."""
    if joint.kind == "continuous":
        plus, minus = (_box_volume(model, joint, s * PROBE_RAD, points) for s in (1.0, -1.0))
        return Opening(0.0, -1.0 if minus > (1.0 + SAME_BOX) * plus else 1.0, TURN_RAD)
    low, high = joint.lower, joint.upper
    at_low, at_high = (_box_volume(model, joint, end, points) for end in (low, high))
    if abs(at_low - at_high) > SAME_BOX * max(at_low, at_high):
        closed = low if at_low < at_high else high
    else:
        closed = low if abs(low) <= abs(high) else high
    return Opening(closed, 1.0 if closed == low else -1.0, high - low)


def _box_volume(model: UrdfModel, joint: Joint, state: float, points: LinkPoints) -> float:
    poses = model.T_root_links({**resting(model), joint.name: state})
    placed = [moved(poses[link], p) for link, p in points.items() if len(p)]
    corners = np.concatenate(placed)
    return float(np.prod(np.maximum(np.ptp(corners, axis=0), 1e-6)))


def moved(T_to_from: gtsam.Pose3, points: FloatArray) -> FloatArray:
    """(N, 3) points in another frame."""
    return np.asarray(points @ T_to_from.rotation().matrix().T + T_to_from.translation())
