"""The suites: which objects there are, by name; each is drawn from its own numbers alone.

Furniture stands here; `sim.objects.household` has the others. All are found by `find_suite`.

`furniture-116` is the benchmark. NOTHING IS EVER TUNED ON IT: no threshold, no prior, no memory,
no network. Its seeds stand below and are not chosen for any result; whoever needs objects to look
at while building uses `furniture-dev`, whose seeds and sizes are others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from akm_fg.errors import InputError
from sim.objects.household.household_spec import HouseholdSpec
from sim.objects.household.household_suites import HOUSEHOLD, HouseholdSuite
from sim.objects.part_spec import Hinge
from sim.objects.suites.families import HANDLELESS_FAMILIES, Family, SizeRanges
from sim.objects.suites.furniture_spec import (
    HANDLELESS_SHARE,
    PLAIN_SHARE,
    FurnitureSpec,
    Slot,
    sample_furniture,
)
from sim.objects.suites.several import CabinetSuite

# Families in the order in which numbers take them, round and round.
DRAWERS: tuple[Family, ...] = ("chest", "desk", "chest", "chest", "range_drawer", "desk")
DOORS: tuple[tuple[Family, Hinge], ...] = (
    ("cabinet", "left"),
    ("cabinet", "right"),
    ("flap", "bottom"),
    ("microwave", "left"),
    ("cabinet", "right"),
    ("dishwasher", "bottom"),
    ("cabinet", "left"),
    ("flap", "top"),
    ("fridge", "right"),
    ("oven", "bottom"),
    ("fridge", "left"),
    ("cabinet", "right"),
    ("microwave", "right"),
    ("cabinet", "left"),
)


@dataclass(frozen=True, slots=True)
class Suite:
    """A set of pieces of furniture with names, loaded by name and seed."""

    name: str
    split: str  # what it may be used for
    seed: int  # of the whole suite
    n_drawers: int
    n_slides: int  # sliding doors; they are numbered after the drawers where looks are drawn
    n_doors: int
    ranges: SizeRanges

    def __len__(self) -> int:
        return self.n_drawers + self.n_slides + self.n_doors

    def __iter__(self) -> Iterator[FurnitureSpec]:
        """Every object as met with seed 0, drawers first."""
        return (self.load(name) for name in self.names())

    def names(self) -> tuple[str, ...]:
        """drawer-001, ..., slide-001, ..., door-001, ..."""
        return tuple(f"{kind}-{i + 1:03d}" for kind, n in self._counts() for i in range(n))

    def _counts(self) -> tuple[tuple[str, int], ...]:
        return (("drawer", self.n_drawers), ("slide", self.n_slides), ("door", self.n_doors))

    def load(self, name: str, seed: int = 0) -> FurnitureSpec:
        """One object as met with `seed`, which varies scale, pose and camera noise.

        Raises:
            InputError: no such object.
        """
        if name not in self.names():
            known = ", ".join(f"{kind}-001 to {kind}-{n:03d}" for kind, n in self._counts())
            raise InputError(f"{self.name}/{name}", "no such object", known)
        kind, number = name.rsplit("-", 1)
        door = kind == "door"
        i = int(number) - 1 + (self.n_drawers if kind == "slide" else 0)
        family, hinge = self._family(door, i)
        slot = Slot(
            name=f"{self.name}/{name}",
            key=(self.seed, int(door), i),
            split=self.split,
            family=family,
            hinge=hinge,
            plain=i in self._share(door, PLAIN_SHARE, 10**6, range(self._n(door))),
            handleless=i in self._share(door, HANDLELESS_SHARE, 10**6 + 1, self._bare(door)),
        )
        return sample_furniture(slot, self.ranges, seed)

    def _n(self, door: bool) -> int:
        return self.n_doors if door else self.n_drawers + self.n_slides

    def _family(self, door: bool, i: int) -> tuple[Family, Hinge | None]:
        if door:
            return DOORS[i % len(DOORS)]
        return ("sliding" if i >= self.n_drawers else DRAWERS[i % len(DRAWERS)]), None

    def _bare(self, door: bool) -> Sequence[int]:
        """Which doors or drawers could do without a handle."""
        return [
            i
            for i in range(self._n(door))
            if self._family(door, i)[0] in HANDLELESS_FAMILIES
            and self._family(door, i)[1] != "top"  # no hand gets under its free edge
        ]

    def _share(self, door: bool, share: float, stream: int, among: Sequence[int]) -> set[int]:
        """So large a share of all doors or drawers, drawn at random from some of them."""
        rng = np.random.default_rng([self.seed, int(door), stream])
        order = rng.permutation(len(among))
        return {
            i for i, rank in zip(among, order, strict=True) if rank < round(share * self._n(door))
        }


SUITES = {
    suite.name: suite
    for suite in (
        # The benchmark. Nothing is ever tuned on it; see above.
        Suite(
            name="furniture-116",
            split="test",
            seed=116,
            n_drawers=56,
            n_slides=4,
            n_doors=56,
            ranges=SizeRanges(
                front_width=(0.34, 0.80),
                drawer_front=(0.11, 0.28),
                door_width=(0.28, 0.50),
                door_height=(0.34, 0.85),
                flap_height=(0.26, 0.46),
            ),
        ),
        Suite(
            name="furniture-dev",
            split="dev",
            seed=40,
            n_drawers=18,
            n_slides=2,
            n_doors=20,
            ranges=SizeRanges(
                front_width=(0.30, 0.70),
                drawer_front=(0.13, 0.31),
                door_width=(0.30, 0.46),
                door_height=(0.30, 0.75),
                flap_height=(0.28, 0.42),
            ),
        ),
    )
}


# Cabinets of which several parts open. Nothing is tuned on `furniture-multi` either.
CABINETS = {
    suite.name: suite
    for suite in (
        CabinetSuite("furniture-multi", "test", 512, 12, SUITES["furniture-116"].ranges),
        CabinetSuite("furniture-multi-dev", "dev", 43, 4, SUITES["furniture-dev"].ranges),
    )
}

AnySuite = Suite | CabinetSuite | HouseholdSuite
ALL_SUITES: dict[str, AnySuite] = {**HOUSEHOLD, **CABINETS, **SUITES}


def find_suite(name: str) -> AnySuite:
    """The suite called `name`.

    Raises:
        InputError: no such suite.
    """
    if name not in ALL_SUITES:
        raise InputError(f"suite {name}", "not known", f"one of {', '.join(ALL_SUITES)}")
    return ALL_SUITES[name]


def load_spec(full_name: str, seed: int) -> FurnitureSpec | HouseholdSpec:
    """The object SUITE/NAME as met with `seed`.

    Raises:
        InputError: no such suite or object.
    """
    suite, _, name = full_name.partition("/")
    return find_suite(suite).load(name, seed)
