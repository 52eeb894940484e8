"""What a piece of furniture is: everything that is drawn at random, and how.

A name fixes the object (size, joint, handle, looks, mass, friction). The seed given with it
varies what differs from one meeting to the next: scale, pose, the camera's noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from akm_fg.records import FloatArray
from sim.objects.mechanisms import Catch, Closer
from sim.objects.part_spec import Hinge, hinge_side
from sim.objects.suites.faces import Face
from sim.objects.suites.families import APPLIANCES, DRAWER_FAMILIES, Family, SizeRanges
from sim.objects.suites.furniture_physics import (
    FreeFront,
    sample_catch,
    sample_closer,
    sample_physics,
)
from sim.objects.suites.layouts import Layout, Neighbour, sample_layout
from sim.objects.suites.manners import (
    BLIND_SHARE,
    KNOBS,
    LEVER_MIN_M,
    RAIL_SHARE,
    Manner,
    Spot,
    lever_m,
    sample_manner,
    spot_of,
)

# Fronts that the library gives an appliance, and the block beside a sliding door.
OWN_FRONTS = {
    "microwave": 1,
    "fridge": 2,
    "dishwasher": 1,
    "oven": 2,
    "range_drawer": 2,
    "sliding": 2,
}
HandleStyle = Literal["bar", "rod", "arch", "knob", "lip", "edge"]

PLAIN_SHARE = 1.0 / 3.0  # of the objects, with nothing on them that a tracker could hold on to
HANDLELESS_SHARE = 0.1  # of the objects, with a board's edge in place of a handle
RANGE_MIN_M = 0.40  # every drawer opens at least so far: the benchmark's range
DRAWER_BACK_M = 0.07  # of the drawer, kept in the cabinet at the end of the range
END_M = 0.035  # from the end of a bar to the edge of the cells that its front fills
HANDLE_MIN_M = 0.05  # of a bar, which two fingers still find room on
SLIDING_DOOR = 0.32  # of the width of a cabinet with a sliding door: the door, and its travel


@dataclass(frozen=True, slots=True)
class HandleSpec:
    """A handle's shape and place on its front.

    The style `edge` is a front without a handle: its board stands over the carcass at the free
    edge, and the fingers pinch it there from the side.
    """

    style: HandleStyle
    length_m: float  # of the bar; of a knob, its diameter; of an edge, the stretch to grip
    thickness_m: float  # across the bar: what the fingers close on
    reach_m: float  # from the front to the middle of the bar; of an edge, how far it stands over
    along: float  # -1..1, place between the ends that the front allows
    edge_m: float  # from the front's free edge (drawers: from its top) to the bar


@dataclass(frozen=True, slots=True)
class Looks:
    """What all fronts have in common, and which of them deceive."""

    manner: Manner
    side: float  # -1 or 1, where handles sit that sit on one side
    blind: tuple[int, ...] = ()  # of the locked fronts, from above: those without a handle
    rails: tuple[int, ...] = ()  # those that are panels with a rail
    knobs: int = 0  # on the panel of an appliance


@dataclass(frozen=True, slots=True)
class FurnitureSpec:
    """One piece of furniture, its first free front before others. Everything here is truth."""

    name: str
    seed: int  # of the meeting: scale, pose, camera noise
    key: tuple[int, ...]  # of the object: what else is random about it is drawn from this
    split: str
    family: Family
    kind: Literal["prismatic", "revolute"]
    hinge: Hinge | None
    size_m: FloatArray  # (3,) width, depth, height of the whole, scaled
    scale: float
    own_m: FloatArray  # (3,) the same without the neighbour, scaled
    face: Face  # the part is its first front
    neighbour: Neighbour | None
    looks: Looks
    wall_m: float
    handle: HandleSpec
    plain: bool
    finish: str
    mass_kg: float  # of the moving part
    damping: float  # N s/m or N m s/rad
    friction: float  # Coulomb, N or N m
    upper: float  # end of the range, m or rad
    handle_mu: float  # sliding friction of the handle against rubber with mu 1
    catch: Catch | None  # holds it closed
    closer: Closer | None  # pulls it shut
    more: tuple[FreeFront, ...] = ()  # further fronts that open

    @property
    def balanced(self) -> bool:
        """Hinges that lie are: by springs or struts, as those of real ovens and flaps."""
        return self.hinge in ("top", "bottom")

    @property
    def view_side(self) -> float:
        """Where the hinge stands."""
        return hinge_side(self.hinge)

    @property
    def front_m(self) -> tuple[float, float]:
        """Width and height of the cells that the part fills."""
        across, up = self.face.share(0)
        return float(self.own_m[0] * across), float(self.own_m[2] * up)

    @property
    def handles(self) -> int:
        """How many places look as if one could pull there, the free one and decoys included."""
        return self.fronts - len(self.looks.blind) + self.looks.knobs

    @property
    def fronts(self) -> int:
        """How many fronts look as if they opened, the free one and blind ones included."""
        beside = len(self.neighbour.face.fronts) if self.neighbour else 0
        return OWN_FRONTS.get(self.family, len(self.face.fronts)) + beside


@dataclass(frozen=True, slots=True)
class Slot:
    """An object's place in its suite: all that is not drawn at random."""

    name: str  # SUITE/NAME
    key: tuple[int, ...]
    split: str
    family: Family
    hinge: Hinge | None  # None for a drawer or a sliding door
    plain: bool
    handleless: bool


def sample_furniture(slot: Slot, ranges: SizeRanges, seed: int) -> FurnitureSpec:
    """Draws a piece of furniture from its slot's key, and its scale from the seed."""
    key, family, hinge = slot.key, slot.family, slot.hinge
    rng = np.random.default_rng(key)
    layout = sample_layout(family, hinge, slot.handleless, ranges, key)
    scale = float(np.random.default_rng([*key, seed]).uniform(0.9, 1.1))
    upper = float(rng.uniform(RANGE_MIN_M, 0.46) if hinge is None else rng.uniform(1.05, 1.75))
    own = _roomy(layout.size_m * scale, family, upper)
    across, up = layout.face.share(0)
    front_m = float(own[0] * across), float(own[2] * up)
    wall_m = float(rng.uniform(0.012, 0.02))
    drawn = _edge(key) if slot.handleless else _sample_handle(family, hinge, rng)
    looks = _sample_looks(slot, drawn, front_m, layout)
    handle = fitted(drawn, handle_spot(drawn, looks, hinge, family).upright, front_m)
    physics = sample_physics(front_m[0] * front_m[1], hinge is None, rng)
    # From the hinge to the handle, where a hand feels them; a slide's forces are along the slide.
    lever = None if hinge is None else handle_lever_m(handle, looks, hinge, family, front_m)
    return FurnitureSpec(
        name=slot.name,
        seed=seed,
        key=key,
        split=slot.split,
        family=family,
        kind="prismatic" if hinge is None else "revolute",
        hinge=hinge,
        size_m=_whole(own, layout.neighbour, scale),
        scale=scale,
        own_m=own,
        face=layout.face,
        neighbour=layout.neighbour,
        looks=looks,
        wall_m=wall_m,
        handle=handle,
        plain=slot.plain,
        finish=_sample_finish(family, slot.plain, rng),
        mass_kg=physics.mass_kg,
        damping=physics.damping,
        friction=physics.friction,
        upper=upper,
        handle_mu=physics.handle_mu,
        catch=sample_catch(key, lever),
        closer=sample_closer(key, lever, lying=hinge in ("top", "bottom")),
    )


def _whole(own_m: FloatArray, neighbour: Neighbour | None, scale: float) -> FloatArray:
    """Size (3,) with what stands beside or below."""
    whole = own_m.copy()
    if neighbour is not None:
        axis = 2 if neighbour.side == "below" else 0
        whole[axis] += scale * neighbour.size_m[1 if neighbour.side == "below" else 0]
    return whole


def _roomy(size_m: FloatArray, family: Family, upper: float) -> FloatArray:
    """The size (3,) with room for a drawer's or sliding door's range."""
    width, depth, height = size_m.tolist()
    if family == "sliding":
        width = upper / SLIDING_DOOR
    elif family in DRAWER_FAMILIES:
        depth = max(depth, upper + DRAWER_BACK_M + 0.06)
    return np.array([width, depth, height])


def _sample_looks(
    slot: Slot, handle: HandleSpec, front_m: tuple[float, float], layout: Layout
) -> Looks:
    """Manner and decoys, from a stream of their own."""
    rng = np.random.default_rng([*slot.key, 62])
    side = 1.0 if rng.random() < 0.5 else -1.0
    looks = Looks(sample_manner(slot.hinge, rng), side)
    if slot.hinge and handle_lever_m(handle, looks, slot.hinge, slot.family, front_m) < LEVER_MIN_M:
        looks = Looks("usual", side)
    beside = len(layout.neighbour.face.fronts) if layout.neighbour else 0
    n = OWN_FRONTS.get(slot.family, len(layout.face.fronts)) + beside - 1  # locked ones
    if slot.handleless:  # the panel under fronts that are pinched from above is the lowest
        return replace(looks, blind=() if slot.hinge in ("left", "right") else (n - 1,))
    picked = rng.permutation(n).tolist()
    blind = picked[:1] if n >= 2 and rng.random() < BLIND_SHARE else []
    rails = picked[1:2] if n >= 2 and rng.random() < RAIL_SHARE else []
    knobs = int(rng.choice(KNOBS)) if slot.family in APPLIANCES and slot.family != "fridge" else 0
    return replace(looks, blind=tuple(blind), rails=tuple(rails), knobs=knobs)


def handle_spot(handle: HandleSpec, looks: Looks, hinge: Hinge | None, family: Family) -> Spot:
    """Where the handle sits on a front with its hinge there."""
    if family == "sliding":  # in the middle: the hand fits the recess
        return Spot(True, 0.0, handle.along)
    return spot_of(looks.manner, hinge, handle.along, looks.side)


def handle_lever_m(
    handle: HandleSpec,
    looks: Looks,
    hinge: Hinge,
    family: Family,
    front_m: tuple[float, float],
) -> float:
    """From the hinge to where the hand pulls."""
    if handle.style in ("edge", "lip"):
        return front_m[0] if hinge in ("left", "right") else front_m[1]
    return lever_m(handle_spot(handle, looks, hinge, family), hinge, front_m, handle.edge_m)


def fitted(handle: HandleSpec, upright: bool, front_m: tuple[float, float]) -> HandleSpec:
    """The handle, no longer than its front has room for."""
    if handle.style in ("knob", "lip", "edge"):
        return handle
    room = front_m[1 if upright else 0] - 2.0 * END_M
    return replace(handle, length_m=float(min(handle.length_m, max(room, HANDLE_MIN_M))))


def _edge(key: tuple[int, ...]) -> HandleSpec:
    """A front without a handle whose board stands 4 cm over the carcass."""
    rng = np.random.default_rng([*key, 43])
    thickness, along = rng.uniform(0.014, 0.020), rng.uniform(-0.5, 0.5)
    return HandleSpec("edge", 0.12, float(thickness), 0.040, float(along), 0.0)


def _sample_handle(family: Family, hinge: Hinge | None, rng: np.random.Generator) -> HandleSpec:
    appliance = family in APPLIANCES
    styles: list[HandleStyle] = ["bar", "rod", "arch"]
    if not appliance and family != "sliding":
        styles += ["knob"] if hinge in ("left", "right") else ["knob", "lip"]
    style = styles[int(rng.integers(len(styles)))]
    length = rng.uniform(0.16, 0.30) if appliance else rng.uniform(0.09, 0.20)
    thickness = rng.uniform(0.010, 0.020)
    reach = rng.uniform(0.036, 0.050)
    if style == "knob":
        length, thickness, reach = rng.uniform(0.026, 0.036), 0.0, rng.uniform(0.030, 0.038)
        thickness = length
    if style == "lip":
        thickness, reach = rng.uniform(0.009, 0.014), rng.uniform(0.028, 0.034)
    along = rng.uniform(-0.7, 0.7) if hinge in ("left", "right") else rng.uniform(-0.25, 0.25)
    edge = rng.uniform(0.04, 0.075)
    return HandleSpec(
        style, float(length), float(thickness), float(reach), float(along), float(edge)
    )


def _sample_finish(family: Family, plain: bool, rng: np.random.Generator) -> str:
    choices = ["wood", "veneer", "painted", "stone"]
    if family in APPLIANCES:
        choices = ["brushed", "brushed", "painted", "stone"]
    finish = str(rng.choice(choices))
    return "plain" if plain else finish
