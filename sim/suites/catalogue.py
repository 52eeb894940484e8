"""The suites: which objects there are, by name; each is drawn from its own numbers alone.

`furniture-116` is the benchmark. NOTHING IS EVER TUNED ON IT: no threshold, no prior, no memory,
no network. Its seeds stand below and are not chosen for any result; whoever needs objects to look
at while building uses `furniture-dev`, whose seeds and sizes are others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from akm_fg.errors import InputError
from sim.suites.furniture_spec import (
    PLAIN_SHARE,
    Family,
    FurnitureSpec,
    Hinge,
    SizeRanges,
    Slot,
    sample_furniture,
)

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
    """A set of objects with names, loaded by name and seed."""

    name: str
    split: str  # what it may be used for
    seed: int  # of the whole suite
    n_drawers: int
    n_doors: int
    ranges: SizeRanges

    def __len__(self) -> int:
        return self.n_drawers + self.n_doors

    def __iter__(self) -> Iterator[FurnitureSpec]:
        """Every object as met with seed 0, drawers first."""
        return (self.load(name) for name in self.names())

    def names(self) -> tuple[str, ...]:
        """drawer-001, ..., door-001, ..."""
        kinds = (("drawer", self.n_drawers), ("door", self.n_doors))
        return tuple(f"{kind}-{i + 1:03d}" for kind, n in kinds for i in range(n))

    def load(self, name: str, seed: int = 0) -> FurnitureSpec:
        """One object as met with `seed`, which varies scale, pose and camera noise.

        Raises:
            InputError: no such object.
        """
        if name not in self.names():
            known = (
                f"drawer-001 to drawer-{self.n_drawers:03d} or door-001 to door-{self.n_doors:03d}"
            )
            raise InputError(f"{self.name}/{name}", "no such object", known)
        kind, number = name.rsplit("-", 1)
        door, i = kind == "door", int(number) - 1
        family, hinge = DOORS[i % len(DOORS)] if door else (DRAWERS[i % len(DRAWERS)], None)
        slot = Slot(
            name=f"{self.name}/{name}",
            key=(self.seed, int(door), i),
            split=self.split,
            family=family,
            hinge=hinge,
            plain=bool(self._plain(door)[i]),
        )
        return sample_furniture(slot, self.ranges, seed)

    def _plain(self, door: bool) -> np.ndarray:
        """(n,) which doors or drawers are plain: exactly PLAIN_SHARE of them, at random."""
        n = self.n_doors if door else self.n_drawers
        order = np.random.default_rng([self.seed, int(door), 10**6]).permutation(n)
        return order < round(PLAIN_SHARE * n)


SUITES = {
    suite.name: suite
    for suite in (
        # The benchmark. Nothing is ever tuned on it; see above.
        Suite(
            name="furniture-116",
            split="test",
            seed=116,
            n_drawers=60,
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
            n_drawers=20,
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


def find_suite(name: str) -> Suite:
    """The suite called `name`.

    Raises:
        InputError: no such suite.
    """
    if name not in SUITES:
        raise InputError(f"suite {name}", "not known", f"one of {', '.join(SUITES)}")
    return SUITES[name]


def load_spec(full_name: str, seed: int) -> FurnitureSpec:
    """The object SUITE/NAME as met with `seed`.

    Raises:
        InputError: no such suite or object.
    """
    suite, _, name = full_name.partition("/")
    return find_suite(suite).load(name, seed)
