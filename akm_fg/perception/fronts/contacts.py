"""Where a hand might take hold of an object, from its shape alone, and how promising that is.

What sticks out of a front is made to be held. Where nothing does, a front may be held by an edge
that stands free, or in a recess; in its middle hardly ever.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from akm_fg.perception.fronts.find_fronts import FrontsConfig, find_fronts
from akm_fg.perception.fronts.front_records import (
    ContactCandidate,
    Front,
    Fronts,
    Protrusion,
)
from akm_fg.records import BoolArray, FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class ContactConfig:
    """Which places are proposed. How they were counted: docs/decisions/0018."""

    fronts: FrontsConfig = field(default_factory=FrontsConfig)
    protrusion: float = 0.9
    odd_protrusion: float = 0.25  # no hand closes around it, or it is too short to hold
    protrusion_end: float = 0.8  # times, of a long one not in its middle
    open_edge: float = 0.4  # the camera sees that there is room behind it
    edge: float = 0.06  # of a board that ends in the air; what is behind it is not seen
    flush_edge: float = 0.01  # the plane goes on beyond it, or something stands there
    plain: float = 0.01
    not_facing: float = 0.15  # times, where a front looks away from the robot or lies
    facing: float = 0.5  # cosine between a front's normal and the horizontal way to the robot
    long_m: float = 0.12  # a protrusion that is held at other places than its middle too
    graspable_m: tuple[float, float] = (0.003, 0.07)  # width across, of the hand's opening
    high_m: float = 0.022  # fingertips reach 7 mm behind what they hold, and keep off the front
    # Places to look at beside an edge, in the front's frame: outwards from it and over the plane.
    # Beyond a board that ends, there is air; and behind one that stands over, where a finger goes.
    beyond_m: tuple[float, float] = (0.025, -0.01)
    behind_m: tuple[float, float] = (-0.005, -0.035)
    air_m: float = 0.015  # so far behind a place something is seen: there is air
    inset_m: float = 0.018  # of an edge's contact: half a finger
    # A longer edge of a front on which nothing stands out is held at several places: boards side
    # by side may look like one. Two of the narrowest fronts that people build are as long.
    long_edge_m: float = 0.45
    apart_m: float = 0.20  # between these places: less than a front is wide
    one_board: float = 0.7  # that such a place is on the same board as the others
    # An edge gives a lever; one of a door's four is its hinge's, and nobody sees which.
    lever: float = 0.8
    seen_within_m: float = 0.02  # a place is proposed where something was seen so near to it
    most: int = 60


def contact_candidates(
    frame: RgbdFrame, mask: BoolArray, config: ContactConfig | None = None
) -> tuple[ContactCandidate, ...]:
    """Places to take hold of, the most promising first; none where no front is seen.

    Args:
        frame: the robot's own pixels carry no depth; the world is the robot's.
        mask: (H, W) the object.
        config: tuning.

    Raises:
        ValueError: the mask has another size than the image.
    """
    config = config or ContactConfig()
    return contacts_of(find_fronts(frame, mask, config.fronts), frame, config)


def contacts_of(
    fronts: Fronts, frame: RgbdFrame, config: ContactConfig | None = None
) -> tuple[ContactCandidate, ...]:
    """The same of fronts that were found already."""
    config = config or ContactConfig()
    seen = _Seen(frame)
    found = [
        replace(c, thing=i)
        for i, p in enumerate(fronts.protrusions)
        for c in _of_protrusion(p, fronts, seen, config)
    ]
    with_handle = {protrusion.front for protrusion in fronts.protrusions}
    for i, front in enumerate(fronts.fronts):
        found.extend(_of_front(i, front, seen, config, bare=i not in with_handle))
    return tuple(sorted(found, key=lambda c: -c.prior)[: config.most])


class _Seen:
    """What a frame shows, to look places up in."""

    def __init__(self, frame: RgbdFrame) -> None:
        self._camera, self._T = frame.camera, frame.T_world_cam
        self._depth = np.where(frame.depth_m > 0, frame.depth_m, np.nan)

    def air(self, p_world: FloatArray, behind_m: float) -> bool:
        """Whether what is seen at a place (3,) is farther away than that by `behind_m`."""
        p_cam = self._T.transformTo(p_world)
        u, v = (np.nan_to_num(x, nan=-1.0) for x in self._camera.project(p_cam))
        column, row = round(float(u)), round(float(v))
        if not (0 <= column < self._camera.width and 0 <= row < self._camera.height):
            return False
        return bool(self._depth[row, column] > p_cam[2] + behind_m)  # NaN compares False

    def nearest(self, p_world: FloatArray, within_m: float) -> tuple[FloatArray, FloatArray] | None:
        """Point (3,) and pixel (2,) of what was seen nearest to a place (3,), or None."""
        p_cam = self._T.transformTo(p_world)
        uv = self._camera.project(p_cam)
        if not np.isfinite(uv).all():
            return None
        reach = int(np.ceil(within_m * self._camera.fx / p_cam[2])) + 1
        u0, v0 = (int(x) for x in np.rint(uv))
        low_u, low_v = max(u0 - reach, 0), max(v0 - reach, 0)
        window = np.s_[low_v : max(v0 + reach + 1, 0), low_u : max(u0 + reach + 1, 0)]
        v, u = np.nonzero(np.isfinite(self._depth[window]))
        if not len(u):
            return None
        pixels = np.column_stack([u + low_u, v + low_v]).astype(float)
        depth = self._depth[window][v, u].astype(float)
        off = np.linalg.norm(self._camera.back_project(pixels, depth) - p_cam, axis=1)
        best = int(off.argmin())
        if off[best] > within_m:
            return None
        found = self._T.transformFrom(self._camera.back_project(pixels[best], depth[best]))
        return found, pixels[best]


def _of_protrusion(
    protrusion: Protrusion, fronts: Fronts, seen: _Seen, config: ContactConfig
) -> Iterator[ContactCandidate]:
    """Its middle; of a long one places towards its ends too."""
    front = fronts.fronts[protrusion.front]
    least, most = config.graspable_m
    fits = least < protrusion.width_m < most and protrusion.height_m > config.high_m
    prior = (config.protrusion if fits else config.odd_protrusion) * _facing(front, config)
    yield ContactCandidate(
        protrusion.p_world, protrusion.uv, protrusion.front, front.normal_world, prior, "protrusion"
    )
    if protrusion.length_m > config.long_m:
        for side in (-0.3, 0.3):
            place = protrusion.p_world + side * protrusion.length_m * protrusion.axis_world
            at = seen.nearest(place, config.seen_within_m)
            if at is not None:
                lower = prior * config.protrusion_end
                yield ContactCandidate(
                    at[0], at[1], protrusion.front, front.normal_world, lower, "protrusion"
                )


def _of_front(
    index: int, front: Front, seen: _Seen, config: ContactConfig, bare: bool
) -> Iterator[ContactCandidate]:
    """The middles of its edges, places all along long ones where it is bare, and its middle."""
    facing = _facing(front, config)
    middle, half = (front.lower_m + front.upper_m) / 2.0, front.extent_m / 2.0
    at = seen.nearest(front.frame.world(np.append(middle, 0.0)), config.seen_within_m)
    if at is not None:
        prior = config.plain * facing
        yield ContactCandidate(at[0], at[1], index, front.normal_world, prior, "plain")
    for out in (np.array(side) for side in ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))):
        along = np.abs(out[::-1])
        offsets = _along_edge(float(along @ front.extent_m), bare, config)
        serves = config.lever * (config.one_board if len(offsets) > 1 else 1.0)
        for offset in offsets:
            edge = middle + half * out + offset * along
            place = np.append(edge - np.minimum(config.inset_m, half) * out, 0.0)
            at = seen.nearest(front.frame.world(place), config.seen_within_m)
            if at is not None:
                prior = _edge_prior(front, edge, out, seen, config) * facing
                yield ContactCandidate(
                    at[0], at[1], index, front.normal_world, prior, "edge", serves=serves
                )


def _along_edge(length_m: float, bare: bool, config: ContactConfig) -> FloatArray:
    """(K,) where an edge may be held, from its middle, m."""
    if not bare or length_m < config.long_edge_m:
        return np.zeros(1)
    count = round(length_m / config.apart_m)
    return np.asarray(length_m * ((np.arange(count) + 0.5) / count - 0.5))


def _edge_prior(
    front: Front, edge: FloatArray, out: FloatArray, seen: _Seen, config: ContactConfig
) -> float:
    """By whether there is air beyond an edge, at a place (2,) on it, and behind it."""

    def air(outwards_m: float, over_m: float) -> bool:
        place = np.append(edge + outwards_m * out, over_m)
        return seen.air(front.frame.world(place), config.air_m)

    if not air(*config.beyond_m):
        return config.flush_edge
    return config.open_edge if air(*config.behind_m) else config.edge


def _facing(front: Front, config: ContactConfig) -> float:
    """1 of a front that looks towards the robot, less of others."""
    to_robot = -front.middle_world
    to_robot[2] = 0.0
    towards = front.normal_world @ to_robot / max(float(np.linalg.norm(to_robot)), 1e-9)
    return 1.0 if towards > config.facing else config.not_facing
