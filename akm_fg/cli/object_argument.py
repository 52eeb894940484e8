"""OBJECT as a person writes it: door, furniture-dev/door-003, cabinet.urdf, a PartNet folder."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from akm_fg.errors import InputError

if TYPE_CHECKING:
    from sim.objects import PartSpec

WHAT = "door, drawer, or SUITE/NAME such as furniture-dev/door-003"


@dataclass(frozen=True, slots=True)
class ObjectArgument:
    """An object to be opened in the simulator."""

    name: str  # as `sim.episode.open_world` takes it

    @property
    def label(self) -> str:
        """For titles and file names."""
        return re.sub(r"[^\w.]+", "-", self.name).strip("-")

    @property
    def words(self) -> str:
        """The part of a command line that names it."""
        return f"--object {self.name}"

    def spec(self, seed: int) -> PartSpec:
        """What the simulator knows of it.

        Raises:
            InputError: there is no such object.
        """
        from sim.staging import find_spec

        try:
            return find_spec(self.name, seed)
        except ValueError as error:
            raise InputError("--object", f"{self.name!r} is not known", WHAT) from error


def parse_object(text: str) -> ObjectArgument:
    """The object that a person names."""
    return ObjectArgument(text)
