"""Cabinets of which several fronts open: drawn as those with one, with further fronts freed.

Sizes, fronts, handles, decoys and looks are the catalogue's own. A front that is freed opens the
way it looks: low ones slide, high ones turn about a side. A draw without drawers and doors enough
is drawn anew from the next key, so that a name still fixes its object.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from akm_fg.errors import InputError
from sim.objects.part_spec import Hinge, mechanisms
from sim.objects.suites.families import Family, SizeRanges
from sim.objects.suites.furniture_physics import (
    FreeFront,
    sample_catch,
    sample_closer,
    sample_physics,
)
from sim.objects.suites.furniture_spec import (
    DRAWER_BACK_M,
    PLAIN_SHARE,
    RANGE_MIN_M,
    FurnitureSpec,
    Slot,
    fitted,
    handle_lever_m,
    handle_spot,
    sample_furniture,
)
from sim.objects.suites.manners import LEVER_MIN_M, seeming_hinge

STREAM = 64  # of the random numbers of freed fronts
CABINETS = 3  # in keys, where drawers have 0, doors 1 and household objects 2
FREE = (3, 4)  # fronts that open: at least, at most
MOST_FRONTS = 6  # that look as if they did
TRIES = 400
# The first front, round and round: what it is decides the piece's sizes.
FIRST: tuple[tuple[Family, Hinge | None], ...] = (
    ("cabinet", "left"),
    ("chest", None),
    ("cabinet", "right"),
)


@dataclass(frozen=True, slots=True)
class CabinetSuite:
    """A set of cabinets with several parts that open, loaded by name and seed."""

    name: str
    split: str  # what it may be used for
    seed: int  # of the whole suite
    count: int
    ranges: SizeRanges

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[FurnitureSpec]:
        """Every object as met with seed 0."""
        return (self.load(name) for name in self.names())

    def names(self) -> tuple[str, ...]:
        """cabinet-001, cabinet-002, ..."""
        return tuple(f"cabinet-{i + 1:03d}" for i in range(self.count))

    def load(self, name: str, seed: int = 0) -> FurnitureSpec:
        """One object as met with `seed`, which varies scale, pose and camera noise.

        Raises:
            InputError: no such object.
        """
        if name not in self.names():
            known = f"cabinet-001 to cabinet-{self.count:03d}"
            raise InputError(f"{self.name}/{name}", "no such object", known)
        i = int(name.removeprefix("cabinet-")) - 1
        family, hinge = FIRST[i % len(FIRST)]
        order = np.random.default_rng([self.seed, CABINETS, 10**6]).permutation(self.count)
        plain = bool(order[i] < round(PLAIN_SHARE * self.count))
        for k in range(TRIES):
            key = (self.seed, CABINETS, i, k)
            slot = Slot(f"{self.name}/{name}", key, self.split, family, hinge, plain, False)
            spec = with_free_fronts(sample_furniture(slot, self.ranges, seed))
            if _is_mixed(spec):
                return spec
        raise AssertionError(f"{self.name}/{name}: no cabinet in {TRIES} draws")


def _is_mixed(spec: FurnitureSpec) -> bool:
    """Whether drawers and doors are among as many free fronts as are wanted."""
    least, most = FREE
    kinds = [spec.kind, *(front.kind for front in spec.more)]
    return (
        least <= len(kinds) <= most
        and len(set(kinds)) == 2
        and spec.fronts <= MOST_FRONTS
        and spec.handle.style != "lip"  # which is on the upper edge: no place for doors
    )


def with_free_fronts(spec: FurnitureSpec) -> FurnitureSpec:
    """The cabinet with further fronts freed, and deep enough for its drawers."""
    rng = np.random.default_rng([*spec.key, STREAM])
    fixed = {*spec.looks.blind, *spec.looks.rails}
    # Blind fronts and rails are counted from above, as they are built.
    from_above = spec.face.from_above()
    freed: list[FreeFront] = []
    for place in rng.permutation(len(from_above)).tolist():
        front = _freed(spec, from_above[place], np.random.default_rng([*spec.key, STREAM, place]))
        if place not in fixed and front is not None and len(freed) + 1 < FREE[1]:
            freed.append(front)
    more = tuple(sorted(freed, key=lambda front: front.front))
    several = replace(spec, more=more)
    slides = [part.upper for part in mechanisms(several) if part.kind == "prismatic"]
    depth = max([float(spec.own_m[1]), *(upper + DRAWER_BACK_M + 0.06 for upper in slides)])
    deep = [np.array([size[0], depth, size[2]]) for size in (spec.own_m, spec.size_m)]
    return replace(several, own_m=deep[0], size_m=deep[1])


def _freed(spec: FurnitureSpec, front: int, rng: np.random.Generator) -> FreeFront | None:
    """A front with a joint as it looks; None where a hand would have no lever, or it lies."""
    across, up = spec.face.share(front)
    front_m = float(spec.own_m[0] * across), float(spec.own_m[2] * up)
    # As it looks in any meeting: the scale is the meeting's.
    hinge = seeming_hinge((front_m[0] / spec.scale, front_m[1] / spec.scale), rng)
    if hinge in ("top", "bottom"):
        return None
    upper = float(rng.uniform(RANGE_MIN_M, 0.46) if hinge is None else rng.uniform(1.05, 1.75))
    physics = sample_physics(front_m[0] * front_m[1], hinge is None, rng)
    upright = handle_spot(spec.handle, spec.looks, hinge, spec.family).upright
    handle, lever = fitted(spec.handle, upright, front_m), None
    if hinge is not None:
        lever = handle_lever_m(handle, spec.looks, hinge, spec.family, front_m)
        if lever < LEVER_MIN_M * spec.scale:
            return None
    key = (*spec.key, STREAM, front)
    return FreeFront(
        front=front,
        kind="prismatic" if hinge is None else "revolute",
        hinge=hinge,
        mass_kg=physics.mass_kg,
        damping=physics.damping,
        friction=physics.friction,
        upper=upper,
        handle_mu=physics.handle_mu,
        catch=sample_catch(key, lever),
        closer=sample_closer(key, lever, lying=False),
    )
