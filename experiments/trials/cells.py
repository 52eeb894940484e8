"""The cells of the synthetic grid: one name, one setting, the same tracks for every method.

door 15 deg, 3 mm, 40 points, 20 frames, drifting
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from experiments.trials.openings import Opening, make_opening

DRIFTING_SHARE = 0.2
CORRELATION_M = 0.07  # of spatially correlated noise: a sixth of the panel
CONDITIONS = ("clean", "drifting", "correlated")
NOISES_MM = (1.0, 3.0, 10.0)
POINTS = (10, 40, 200)
TRAVELS: tuple[tuple[str, float], ...] = (
    ("door", 5.0),
    ("door", 15.0),
    ("door", 40.0),
    ("drawer", 5.0),
    ("drawer", 15.0),
    ("drawer", 40.0),
)
_NAME = re.compile(
    r"(?P<part>door|drawer) (?P<travel>[\d.]+) (?:deg|cm), (?P<noise_mm>[\d.]+) mm, "
    r"(?P<points>\d+) points, (?P<frames>\d+) frames, (?P<condition>\w+)"
)


@dataclass(frozen=True, slots=True)
class Cell:
    """One setting of the grid."""

    part: str  # door or drawer
    travel: float  # degrees or centimetres
    noise_mm: float = 3.0
    points: int = 40
    frames: int = 20
    condition: str = "clean"

    def __post_init__(self) -> None:
        if self.part not in ("door", "drawer") or self.condition not in CONDITIONS:
            raise ValueError(f"{self.part}, {self.condition}: door or drawer, one of {CONDITIONS}")

    @property
    def travel_name(self) -> str:
        """As a person says it: door 15 deg."""
        return f"{self.part} {self.travel:g} {'deg' if self.part == 'door' else 'cm'}"

    @property
    def name(self) -> str:
        """Everything, for rows."""
        size = f"{self.points} points, {self.frames} frames"
        return f"{self.travel_name}, {self.noise_mm:g} mm, {size}, {self.condition}"

    @property
    def kind(self) -> str:
        """The true kind of the joint."""
        return "revolute" if self.part == "door" else "prismatic"

    def opening(self, seed: int) -> Opening:
        """The tracks of one trial. They claim the true standard deviation of a coordinate.

        The cell is part of the seed: cells that shared their random numbers could not be pooled.
        """
        noise_m = self.noise_mm / 1e3
        return make_opening(
            [seed, *self.name.encode()],
            self.kind,
            travel=float(np.deg2rad(self.travel)) if self.part == "door" else self.travel / 100,
            points=self.points,
            frames=self.frames,
            noise_m=noise_m,
            claimed_m=noise_m,
            wild_share=DRIFTING_SHARE if self.condition == "drifting" else 0.0,
            correlation_m=CORRELATION_M if self.condition == "correlated" else 0.0,
        )


def cell_named(name: str) -> Cell:
    """The cell of a row.

    Raises:
        ValueError: not the name of a cell.
    """
    match = _NAME.fullmatch(name)
    if match is None:
        raise ValueError(f"{name!r} names no cell; expected like {Cell('door', 15.0).name!r}")
    return Cell(
        match["part"],
        float(match["travel"]),
        float(match["noise_mm"]),
        int(match["points"]),
        int(match["frames"]),
        match["condition"],
    )


def table_cells() -> list[Cell]:
    """The twelve cells that methods are compared in: 40 points, 20 frames, 3 mm."""
    return [
        Cell(part, travel, condition=condition)
        for condition in ("clean", "drifting")
        for part, travel in TRAVELS
    ]


def grid_cells() -> list[Cell]:
    """All of noise, travel, tracks and condition, the twelve of the table first."""
    grid = [
        Cell(part, travel, noise_mm, points, condition=condition)
        for condition in CONDITIONS
        for noise_mm in NOISES_MM
        for points in POINTS
        for part, travel in TRAVELS
    ]
    table = table_cells()
    return table + [cell for cell in grid if cell not in table]
