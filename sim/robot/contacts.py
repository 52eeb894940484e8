"""Where bodies of PyBullet touch or come near each other: its contact points, read in one place.

A link has the index of the joint that moves it; the base is link -1.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from akm_fg.arm.body.model import FINGER_JOINTS
from sim.bullet import joint_index, p

# Places in PyBullet's contact point: bodies, links, distance and normal force.
OTHER_BODY, LINK, OTHER_LINK, DISTANCE, FORCE = 2, 3, 4, 8, 9


@dataclass(frozen=True, slots=True)
class Contact:
    """A pair of points of a body and of another, which may be the same body."""

    link: int  # of the body that was asked about
    other_body: int
    other_link: int
    distance_m: float  # negative inside each other
    force_n: float  # along the normal; 0 where physics did not compute it


def contacts(client: int, body: int, other: int | None = None) -> list[Contact]:
    """The contact points of a body, with one other or with all, as the last step left them."""
    named = {} if other is None else {"bodyB": other}
    return _read(p.getContactPoints(bodyA=body, physicsClientId=client, **named))


def nearby(
    client: int,
    body: int,
    other: int,
    within_m: float,
    *,
    link: int | None = None,
    other_link: int | None = None,
) -> list[Contact]:
    """The closest points of links that are at most `within_m` apart, as the bodies stand now.

    Args:
        client: where they are.
        body: whose links are asked about.
        other: the other body.
        within_m: largest distance.
        link: of the body, this one alone.
        other_link: of the other, this one alone.
    """
    chosen = {"linkIndexA": link, "linkIndexB": other_link}
    named = {key: index for key, index in chosen.items() if index is not None}
    return _read(p.getClosestPoints(body, other, within_m, physicsClientId=client, **named))


def finger_links(client: int, robot: int) -> list[int]:
    """Of the robot: the links that may touch a handle."""
    return [joint_index(client, robot, name) for name in FINGER_JOINTS]


def link_name(client: int, body: int, link: int) -> str:
    """What the URDF calls a link that is not the base."""
    name: bytes = p.getJointInfo(body, link, physicsClientId=client)[12]
    return name.decode()


def _read(points: Iterable[Any]) -> list[Contact]:
    return [
        Contact(
            point[LINK],
            point[OTHER_BODY],
            point[OTHER_LINK],
            float(point[DISTANCE]),
            float(point[FORCE]),
        )
        for point in points
    ]
