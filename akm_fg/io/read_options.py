"""What a person says of an input that its file does not."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from akm_fg.io.conventions import InputConventions
from akm_fg.io.sources.source import SourceOptions
from akm_fg.records import FloatArray

QuaternionOrder = Literal["xyzw", "wxyz"]
LengthUnit = Literal["m", "mm"]

METRES_A_UNIT: dict[LengthUnit, float] = {"m": 1.0, "mm": 1e-3}
LARGEST_EXTENT_M = 20.0
"""No articulated part moves through, or is, more than this: such numbers are millimetres."""


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """None: found out from the file, and said where it is a guess."""

    quaternion: QuaternionOrder | None = None  # order of a pose log's quaternions
    unit: LengthUnit | None = None  # of positions and of their covariances
    conventions: InputConventions = field(default_factory=InputConventions)  # of recordings
    source: SourceOptions = field(default_factory=SourceOptions)  # of other people's formats


LARGEST_NUMBER = 1e9  # of a coordinate in any unit: what is beyond is a broken file
MIDDLE_PER_CENT = (5.0, 95.0)  # of positions: a tracker's jumps are no extent


def extent_of(positions: FloatArray) -> float:
    """Longest side of the box around most of the positions (N, 3)."""
    low, high = np.percentile(positions, MIDDLE_PER_CENT, axis=0)
    return float((high - low).max())


def guessed_unit(extent: float, options: ReadOptions) -> tuple[LengthUnit, tuple[str, ...]]:
    """The unit of lengths, and what is to be said about it.

    Args:
        extent: of all positions in the file, in its own unit.
        options: what a person said; a unit that was said is not doubted.
    """
    if options.unit is not None:
        return options.unit, ()
    if extent <= LARGEST_EXTENT_M:
        return "m", ()
    note = (
        f"positions span {extent:.3g}: likely millimetres, read as such "
        "(--unit m if they are metres)"
    )
    return "mm", (note,)
