"""What a household object is: everything that is drawn at random, and how.

As with furniture, a name fixes the object (size, joint, looks, mass, friction); the seed given
with it varies what differs from one meeting to the next: scale, pose, the camera's noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from akm_fg.records import FloatArray
from sim.objects.mechanisms import Catch, Closer
from sim.objects.part_spec import Hinge, hinge_side

Family = Literal[
    "thin_lid",  # a board on a hollow box
    "box_lid",  # a hollow lid
    "laptop",
    "curved_bin",
    "sloped_bin",
    "round_door",  # a washing machine
    "domed_door",
    "suitcase",
    "toilet",
    "book",
    "flap",  # thin, seen from its free side, so that it passes edge-on
    "sliding_lid",
    "tray",
]
Look = Literal["printed", "plain", "dark", "glossy"]
# In this order numbers take them, round and round. Two of thirteen slide.
FAMILIES: tuple[Family, ...] = (
    "thin_lid",
    "laptop",
    "round_door",
    "box_lid",
    "sliding_lid",
    "toilet",
    "curved_bin",
    "flap",
    "suitcase",
    "book",
    "domed_door",
    "sloped_bin",
    "tray",
)
LOOKS: tuple[Look, ...] = ("printed", "plain", "printed", "dark", "glossy")
SMALL_SHARE = 0.25  # of the objects, so far away that the part is small in the picture
SMALL_PX = 1500.0  # area of such a part
BACK_HINGED = (
    "thin_lid",
    "box_lid",
    "laptop",
    "curved_bin",
    "sloped_bin",
    "suitcase",
    "toilet",
)
SLIDING = ("sliding_lid", "tray")
DENSITY_KG_M3 = (250.0, 700.0)  # of the part's solids: card, plastic, wood
# Width, depth, height of the whole in metres, and the end of the range in radians or metres.
_SIDES: dict[Family, tuple[tuple[float, float], ...]] = {
    "thin_lid": ((0.22, 0.50), (0.18, 0.38), (0.10, 0.32)),
    "box_lid": ((0.22, 0.45), (0.18, 0.35), (0.12, 0.30)),
    "laptop": ((0.30, 0.38), (0.21, 0.26), (0.022, 0.030)),
    "curved_bin": ((0.22, 0.36), (0.22, 0.34), (0.35, 0.60)),
    "sloped_bin": ((0.22, 0.40), (0.24, 0.36), (0.35, 0.60)),
    "round_door": ((0.55, 0.62), (0.45, 0.60), (0.80, 0.88)),
    "domed_door": ((0.50, 0.62), (0.45, 0.60), (0.75, 0.88)),
    "suitcase": ((0.45, 0.66), (0.32, 0.44), (0.16, 0.26)),
    "toilet": ((0.34, 0.38), (0.42, 0.48), (0.36, 0.42)),
    "book": ((0.16, 0.24), (0.22, 0.32), (0.025, 0.060)),
    "flap": ((0.26, 0.44), (0.10, 0.30), (0.28, 0.46)),
    "sliding_lid": ((0.26, 0.45), (0.14, 0.26), (0.08, 0.18)),
    "tray": ((0.20, 0.40), (0.28, 0.45), (0.07, 0.16)),
}
_UPPER: dict[Family, tuple[float, float]] = {
    "thin_lid": (1.6, 2.3),
    "box_lid": (1.5, 2.1),
    "laptop": (1.9, 2.4),
    "curved_bin": (1.3, 1.9),
    "sloped_bin": (1.3, 1.9),
    "round_door": (1.9, 2.7),
    "domed_door": (1.7, 2.6),
    "suitcase": (1.5, 2.0),
    "toilet": (1.6, 1.8),
    "book": (2.4, 3.0),
    "flap": (1.8, 2.4),
    "sliding_lid": (0.80, 0.92),  # of the width
    "tray": (0.70, 0.85),  # of the depth
}


@dataclass(frozen=True, slots=True)
class Grip:
    """What a hand takes hold of."""

    style: Literal["edge", "knob"]
    length_m: float
    thickness_m: float
    reach_m: float


@dataclass(frozen=True, slots=True)
class HouseholdSpec:
    """One household object with one moving part. Everything here is truth."""

    name: str
    seed: int  # of the meeting: scale, pose, camera noise
    key: tuple[int, ...]
    split: str
    family: Family
    kind: Literal["prismatic", "revolute"]
    hinge: Hinge | None
    size_m: FloatArray  # (3,) width, depth, height of the whole, scaled
    scale: float
    wall_m: float  # of what is hollow, and of thin lids
    share: float  # 0..1, whatever proportion the family leaves open
    finish: Look
    small: bool  # seen from so far that the part has SMALL_PX pixels
    handle: Grip
    mass_kg: float  # of the moving part
    damping: float  # N s/m or N m s/rad
    friction: float  # Coulomb, N or N m
    upper: float  # end of the range, m or rad
    handle_mu: float
    catch: Catch | None = None
    closer: Closer | None = None

    @property
    def balanced(self) -> bool:
        """Stiff hinges and struts: a lid stays where it is left."""
        return self.hinge not in ("left", "right") or self.family == "book"

    @property
    def view_side(self) -> float:
        """A flap is seen from its free side, anything else from where its hinge stands."""
        side = hinge_side(self.hinge)
        return -side if self.family == "flap" else side

    @property
    def front_m(self) -> tuple[float, float]:
        """Larger sides of the part."""
        width, depth, height = self.size_m.tolist()
        upright = self.family in ("flap", "round_door", "domed_door")
        return (width, height if upright else depth)

    @property
    def travels(self) -> tuple[float, float]:
        """How far it is opened: to most of the range, so that thin parts turn over."""
        if self.kind == "prismatic":
            return (0.4 * self.upper, 0.9 * self.upper)
        least = 0.9 if self.family == "flap" else 0.35
        return (least, min(0.8 * self.upper, 1.9))


def sample_household(
    name: str, key: tuple[int, ...], split: str, number: int, seed: int
) -> HouseholdSpec:
    """Draws the object of a number in its suite from its key, and its scale from the seed."""
    rng = np.random.default_rng(key)
    family = FAMILIES[number % len(FAMILIES)]
    size = np.array([rng.uniform(*side) for side in _SIDES[family]])
    scale = float(np.random.default_rng([*key, seed]).uniform(0.9, 1.1))
    size *= scale
    upper = float(rng.uniform(*_UPPER[family]))
    if family in SLIDING:
        upper *= float(size[0 if family == "sliding_lid" else 1])
    slides = family in SLIDING
    thin = family in ("book", "flap", "laptop")
    wall_m = float(rng.uniform(0.003, 0.005) if thin else rng.uniform(0.004, 0.012))
    volume_m3 = float(size[0] * max(size[1], 0.2) * 1.5 * wall_m)
    knob = family in ("round_door", "domed_door", "flap", "sliding_lid", "tray")
    return HouseholdSpec(
        name=name,
        seed=seed,
        key=key,
        split=split,
        family=family,
        kind="prismatic" if slides else "revolute",
        hinge=_hinge(family, rng),
        size_m=size,
        scale=scale,
        wall_m=wall_m,
        share=float(rng.uniform()),
        finish=LOOKS[int(rng.integers(len(LOOKS)))],
        small=bool(rng.uniform() < SMALL_SHARE),
        handle=Grip("knob", 0.03, 0.02, 0.03) if knob else Grip("edge", 0.10, wall_m, 0.02),
        mass_kg=0.1 + volume_m3 * float(rng.uniform(*DENSITY_KG_M3)),
        damping=float(rng.uniform(2.0, 8.0) if slides else rng.uniform(0.1, 0.5)),
        friction=float(rng.uniform(0.5, 3.0) if slides else rng.uniform(0.05, 0.3)),
        upper=upper,
        handle_mu=float(rng.uniform(0.7, 1.0)),
    )


def _hinge(family: Family, rng: np.random.Generator) -> Hinge | None:
    side: Hinge = "left" if rng.integers(2) else "right"
    if family in SLIDING:
        return None
    if family in BACK_HINGED:
        return "top"  # along the back edge of what lies on top
    return "left" if family == "book" else side
