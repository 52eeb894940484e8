"""Where handles sit on fronts: one manner for all fronts of an object, free and locked.

In half of the objects every front has its handle where its own hinge wants it; in the others in the
middle, along one edge of all fronts, or on the wrong side, so that neither hinge nor kind can be
read off. Decoys are fronts without a handle (blind), fixed panels with a rail, and knobs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim.objects.part_spec import Hinge

Manner = Literal["usual", "wrong", "middle_lying", "middle_upright", "above", "below", "side"]
SHARES: dict[Manner, float] = {
    "usual": 0.42,
    "wrong": 0.14,
    "middle_lying": 0.14,
    "middle_upright": 0.10,
    "above": 0.06,
    "below": 0.04,
    "side": 0.10,
}
WRONG = 0.4  # of the way from the middle to the edge: nearer to the hinge there is no lever
LEVER_MIN_M = 0.12  # from hinge to handle: less would ask for more than a child can pull
BLIND_SHARE, RAIL_SHARE = 0.20, 0.20  # of the objects with three fronts or more
KNOBS = (0, 1, 1, 2)  # on the panel of an appliance, each as likely


@dataclass(frozen=True, slots=True)
class Spot:
    """A handle's place on a front: 0 in the middle, -1 and 1 where the room for it ends."""

    upright: bool
    right: float
    up: float


def spot_of(manner: Manner, hinge: Hinge | None, along: float, side: float) -> Spot:
    """Where a handle sits on a front.

    Args:
        manner: of the object.
        hinge: of the front, or what it looks like it had; None for a drawer.
        along: -1..1, of the object: how far its handles are from the middle, along the bar.
        side: -1 or 1, of the object: where handles sit that sit on one side.
    """
    free_side = {"left": 1.0, "right": -1.0}.get(hinge or "", 0.0)
    free_end = {"top": -1.0, "bottom": 1.0}.get(hinge or "", 1.0)
    match manner:
        case "usual" | "wrong":
            share = 1.0 if manner == "usual" else -WRONG
            if free_side:
                return Spot(True, share * free_side, along)
            if hinge is None and manner == "wrong":
                return Spot(True, side, along)
            return Spot(False, along, share * free_end)
        case "middle_lying":
            return Spot(False, 0.0, 0.0)
        case "middle_upright":
            return Spot(True, 0.0, 0.0)
        case "above" | "below":
            return Spot(False, along, 1.0 if manner == "above" else -1.0)
        case "side":
            return Spot(True, side, along)


def lever_m(spot: Spot, hinge: Hinge | None, front_m: tuple[float, float], edge_m: float) -> float:
    """From the hinge to a handle on a front of some width and height; infinite for a drawer."""
    if hinge is None:
        return np.inf
    half = (front_m[0] if hinge in ("left", "right") else front_m[1]) / 2.0
    at = spot.right if hinge in ("left", "right") else spot.up
    away = {"left": 1.0, "right": -1.0, "top": -1.0, "bottom": 1.0}[hinge]
    return half + away * at * max(half - edge_m, 0.0)


def seeming_hinge(front_m: tuple[float, float], rng: np.random.Generator) -> Hinge | None:
    """What a locked front looks like: high ones like doors, low ones like drawers or flaps."""
    width, height = front_m
    if height > 0.9 * width:
        return "left" if rng.random() < 0.5 else "right"
    if height < 0.24:
        return None
    looks: tuple[Hinge | None, ...] = (None, "top", "bottom")
    return looks[int(rng.integers(len(looks)))]


def sample_manner(hinge: Hinge | None, rng: np.random.Generator) -> Manner:
    """The manner of an object whose free front has its hinge there."""
    manners = [m for m in SHARES if (m, hinge) not in (("above", "top"), ("below", "bottom"))]
    shares = np.array([SHARES[m] for m in manners])
    return manners[int(rng.choice(len(manners), p=shares / shares.sum()))]
