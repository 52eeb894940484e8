"""The household suites. Nothing is ever tuned on `household-60`; `household-dev` is for that."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from akm_fg.errors import InputError
from sim.objects.household.household_spec import HouseholdSpec, sample_household


@dataclass(frozen=True, slots=True)
class HouseholdSuite:
    """A set of household objects with names, loaded by name and seed."""

    name: str
    split: str  # what it may be used for
    seed: int  # of the whole suite
    count: int

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[HouseholdSpec]:
        """Every object as met with seed 0."""
        return (self.load(name) for name in self.names())

    def names(self) -> tuple[str, ...]:
        """thing-001, thing-002, ..."""
        return tuple(f"thing-{i + 1:03d}" for i in range(self.count))

    def load(self, name: str, seed: int = 0) -> HouseholdSpec:
        """One object as met with `seed`, which varies scale, pose and camera noise.

        Raises:
            InputError: no such object.
        """
        if name not in self.names():
            known = f"thing-001 to thing-{self.count:03d}"
            raise InputError(f"{self.name}/{name}", "no such object", known)
        number = int(name.removeprefix("thing-")) - 1
        full = f"{self.name}/{name}"
        return sample_household(full, (self.seed, 2, number), self.split, number, seed)


HOUSEHOLD = {
    suite.name: suite
    for suite in (
        HouseholdSuite("household-60", "test", 260, 60),
        HouseholdSuite("household-dev", "dev", 41, 24),
    )
}
