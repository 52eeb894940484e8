"""How large a piece of furniture is, where its fronts are, and what stands beside it.

The free front's size comes from its suite's ranges; the fronts around it fill what a hand at the
end of the arm can reach. Appliances keep the fronts that the library gives them and get a cabinet
with further ones beside or below, as in a kitchen. Sizes are those before the scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from akm_fg.records import FloatArray
from sim.objects.part_spec import Hinge
from sim.objects.suites.faces import Cells, Face, face_of_heights, sample_face, sample_stack
from sim.objects.suites.families import Family, SizeRanges

Side = Literal["left", "right", "below"]
FRONTS = (2, 3, 4, 4, 5, 5, 6, 6, 7, 8)  # of cabinets, each as likely
BESIDE = (2, 3, 3, 4)  # of a cabinet beside an appliance
NEIGHBOUR_SHARE = 0.8  # of the appliances, with a cabinet beside or below
DEPTH_M = (0.48, 0.58)  # of a chest of drawers
EDGE_TOP_M = 0.34  # under the top of fronts that are pinched from above: the hand comes from there

# Width, depth and height. All of it is within the arm's reach from the ground.
APPLIANCE_M = {
    "microwave": ((0.45, 0.60), (0.34, 0.42), (0.26, 0.36)),
    "fridge": ((0.45, 0.58), (0.52, 0.62), (0.80, 1.02)),
    "dishwasher": ((0.44, 0.60), (0.52, 0.60), (0.68, 0.86)),
    "oven": ((0.46, 0.60), (0.52, 0.60), (0.68, 0.88)),
    "range_drawer": ((0.46, 0.62), (0.56, 0.62), (0.72, 0.92)),
    "sliding": ((1.0, 1.0), (0.50, 0.58), (0.62, 0.80)),  # the width follows from the range
}


@dataclass(frozen=True, slots=True)
class Neighbour:
    """A cabinet beside or below an appliance. None of its fronts is free."""

    side: Side
    size_m: tuple[float, float]  # width and height, before the scale
    face: Face


@dataclass(frozen=True, slots=True)
class Layout:
    """Of the piece that has the free front, before the scale."""

    size_m: FloatArray  # (3,) width, depth, height
    face: Face
    neighbour: Neighbour | None = None


def sample_layout(
    family: Family, hinge: Hinge | None, handleless: bool, ranges: SizeRanges, key: tuple[int, ...]
) -> Layout:
    """The layout of an object, from its own stream of random numbers."""
    rng = np.random.default_rng([*key, 61])
    if family in APPLIANCE_M:
        return _appliance(family, hinge, rng)
    part_m = _part_size(family, hinge, ranges, rng)
    depth = rng.uniform(*DEPTH_M) if hinge is None else rng.uniform(0.30, 0.50)
    if handleless:
        size, face = _edged(part_m, hinge, rng)
    else:
        size, face = sample_face(part_m, int(rng.choice(FRONTS)), rng)
    return Layout(np.array([size[0], float(depth), size[1]]), face)


def _part_size(
    family: Family, hinge: Hinge | None, ranges: SizeRanges, rng: np.random.Generator
) -> tuple[float, float]:
    """Width and height of the free front."""
    if family == "cabinet":
        return float(rng.uniform(*ranges.door_width)), float(rng.uniform(*ranges.door_height))
    heights = ranges.drawer_front if hinge is None else ranges.flap_height
    return float(rng.uniform(*ranges.front_width)), float(rng.uniform(*heights))


def _edged(
    part_m: tuple[float, float], hinge: Hinge | None, rng: np.random.Generator
) -> tuple[tuple[float, float], Face]:
    """Fronts without handles: nothing stands beside the edges that are pinched.

    Those with an upright edge are alone in their rows; the others are the topmost, side by side,
    above a blind panel.
    """
    width, height = part_m
    if hinge in ("left", "right"):
        n = 1 if height > 0.6 else int(rng.integers(1, 3))
        others = rng.uniform(0.13, 0.20, n).tolist()
        heights = [height, *others]
        order = rng.permutation(len(heights)).tolist()
        return (width, sum(heights)), face_of_heights(width, heights, order)
    n = int(rng.integers(2, 5))
    width = min(width, 1.1 / n)
    panel = float(np.clip(EDGE_TOP_M - height, 0.08, rng.uniform(0.12, 0.25)))
    free = int(rng.integers(n))
    top = [Cells(0, 1, i, i + 1) for i in range(n)]
    fronts = (top[free], *(cell for i, cell in enumerate(top) if i != free), Cells(1, 2, 0, n))
    whole = height + panel
    return (n * width, whole), Face((height / whole, panel / whole), (1.0 / n,) * n, fronts)


def _appliance(family: Family, hinge: Hinge | None, rng: np.random.Generator) -> Layout:
    size = np.array([rng.uniform(*side) for side in APPLIANCE_M[family]])
    if family == "sliding":
        return Layout(size, Face((1.0,), (1.0,), (Cells(0, 1, 0, 1),)))
    share = float(rng.uniform(0.28, 0.40))  # freezer of a fridge, drawer of a range
    lower = int(rng.integers(2)) if family == "fridge" else 1
    cells = (Cells(lower, lower + 1, 0, 1),)
    face = Face((share, 1.0 - share), (1.0,), cells)
    beside = _neighbour(family, hinge, size, rng) if rng.random() < NEIGHBOUR_SHARE else None
    return Layout(size, face, beside)


def _neighbour(
    family: Family, hinge: Hinge | None, size_m: FloatArray, rng: np.random.Generator
) -> Neighbour:
    n = int(rng.choice(BESIDE))
    if family == "microwave":
        size = float(size_m[0]), float(rng.uniform(0.26, 0.42))
        return Neighbour("below", size, sample_stack(*size, min(n, 2), rng))
    size = float(rng.uniform(0.28, 0.42)), float(size_m[2])
    side: Side = "left" if rng.random() < 0.5 else "right"
    if family == "fridge":  # its thick door needs the room beside its hinge
        side = "right" if hinge == "left" else "left"
    return Neighbour(side, size, sample_stack(*size, n, rng))
