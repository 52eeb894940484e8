"""Grasps of a front that stands open, at its free edge: one finger before it and one behind it.

A drawer that is drawn out to the robot's base offers its handle to no arm: the hand would have to
stand where the robot's shoulder is. Its front's upper edge is still reached from above. The front
is the plane that most of the part's surface lies on, out of which the contact was approached; its
free edges are those that go away from where the part is closed: from there on the hand, which is
wide along the fingers' opening, needs room behind the front.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import gtsam
import numpy as np

from akm_fg.grasping.board_edge import EdgeConfig, pinch, pinch_turns
from akm_fg.model.records import Contact, ModelPart
from akm_fg.records import FloatArray


@dataclass(frozen=True, slots=True)
class BoardConfig:
    """A front, and where it is pinched."""

    alike_rad: float = 0.35  # between the approach to the contact and the front's normal
    plane_m: float = 0.004  # half thickness of the layers among which the front is looked for
    flat_m: float = 0.008  # from the front's plane, a point is of the front
    least_points: int = 200  # of a front
    places_m: tuple[float, ...] = (0.0, 0.07, -0.07, 0.14, -0.14)  # along the edge
    strip_m: float = 0.012  # half width in which the edge is looked for
    strip_points: int = 8
    rim: float = 97.0  # percentile of a strip's points that is its end
    edge: EdgeConfig = field(default_factory=EdgeConfig)  # how a hand pinches it
    # Between where the edge is and where it is when closed: half the hand's width along the
    # fingers' opening (102 mm), and what the arm keeps clear (20 mm).
    room_m: float = 0.125


@dataclass(frozen=True, slots=True)
class BoardGrasp:
    """A pinched edge, in the part's frame."""

    T_part_grasp: gtsam.Pose3
    p_part_edge: FloatArray  # (3,) in the middle of the board

    def opening_m(self, part: ModelPart, q: float) -> float:
        """How far the edge is from where it is when the part is closed."""
        return float(
            np.linalg.norm(part.T_world_part(q).transformFrom(self.p_part_edge) - self.p_part_edge)
        )


def board_grasps(part: ModelPart, config: BoardConfig | None = None) -> list[BoardGrasp]:
    """Of the front that the part's first contact is on; none where it has none.

    The straight ones come first, of an edge that turns that which is farthest from the hinge.
    """
    config = config or BoardConfig()
    if not part.contacts:
        return []
    front = front_of(part, part.contacts[0], config)
    if front is None:
        return []
    ways = list(_ways_out(part, front))
    return [
        grasp
        for turn, _ in pinch_turns(config.edge)
        for out in ways
        for grasp in _along_edge(front, out, turn, config)
    ]


@dataclass(frozen=True, slots=True)
class Front:
    """The plane that most of a part's surface lies on, out of which a contact was approached."""

    p: FloatArray  # (N, 3) its points, in the part's frame
    normal: FloatArray  # (3,) unit, outwards
    p_contact: FloatArray  # (3,) where it was held

    @property
    def depth_m(self) -> float:
        """Of its plane, along the normal."""
        return float(np.median(self.p @ self.normal))


def front_of(part: ModelPart, contact: Contact, config: BoardConfig) -> Front | None:
    """The front that a contact belongs to; None: too little of one is known."""
    T = contact.T_part_grasp
    approach = T.rotation().matrix()[:, 2]
    surface = part.surface
    facing = surface.normal_world @ -approach > np.cos(config.alike_rad)
    if facing.sum() < config.least_points:
        return None
    mean = surface.normal_world[facing].mean(axis=0)
    normal = mean / np.linalg.norm(mean)
    p = surface.p_world[facing]
    depth = p @ normal
    layers = np.round((depth - depth.min()) / (2.0 * config.plane_m)).astype(int)
    most = depth[layers == np.bincount(layers).argmax()].mean()
    flat = np.abs(depth - most) < config.flat_m
    if flat.sum() < config.least_points:
        return None
    return Front(p[flat], np.asarray(normal), T.translation())


def _ways_out(part: ModelPart, front: Front) -> Iterator[FloatArray]:
    """Unit vectors (3,) in the front, across the edges that are looked for: off a hinge, and up."""
    joint = part.joint
    if not joint.turns and abs(joint.axis @ front.normal) < LEVELLED:
        return
    ways: list[FloatArray] = []
    if joint.turns:
        off = np.cross(joint.axis, front.normal)
        ways.append(off * np.sign(off @ (front.p_contact - joint.joint.origin)))
    up = np.array([0.0, 0.0, 1.0])
    ways.append(up - (up @ front.normal) * front.normal)
    said: list[FloatArray] = []
    for way in ways:
        length = float(np.linalg.norm(way))
        if length < LEVELLED or any(way @ other > LEVELLED * length for other in said):
            continue
        said.append(way / length)
        yield said[-1]


def _along_edge(
    front: Front, out: FloatArray, turn: gtsam.Rot3, config: BoardConfig
) -> Iterator[BoardGrasp]:
    """Pinches beside the contact along one edge."""
    along = np.cross(front.normal, out)
    d = front.p - front.p_contact
    x, y = d @ along, d @ out
    before = front.depth_m - front.p_contact @ front.normal  # the contact's, to the plane
    for place in config.places_m:
        strip = y[np.abs(x - place) < config.strip_m]
        if len(strip) < config.strip_points:
            continue
        end = float(np.percentile(strip, config.rim))
        edge = front.p_contact + place * along + end * out + before * front.normal
        middle = edge - config.edge.board_m / 2.0 * front.normal
        yield BoardGrasp(pinch(edge, out, front.normal, turn, config.edge), middle)


LEVELLED = 0.5  # of a unit vector, that lies along another: 60 deg
