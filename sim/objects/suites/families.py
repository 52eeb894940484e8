"""What kinds of furniture there are, and from where a suite draws their sizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Family = Literal[
    "chest",
    "desk",
    "range_drawer",
    "sliding",
    "cabinet",
    "flap",
    "microwave",
    "fridge",
    "dishwasher",
    "oven",
]
APPLIANCES = ("range_drawer", "microwave", "fridge", "dishwasher", "oven")
DRAWER_FAMILIES = ("chest", "desk", "range_drawer")
HANDLELESS_FAMILIES = ("chest", "desk", "cabinet", "flap")


@dataclass(frozen=True, slots=True)
class SizeRanges:
    """From where a suite draws its sizes, metres."""

    front_width: tuple[float, float]
    drawer_front: tuple[float, float]  # height of one drawer's front
    door_width: tuple[float, float]
    door_height: tuple[float, float]
    flap_height: tuple[float, float]
