"""What a piece of furniture is: everything that is drawn at random, and how.

A name fixes the object (size, joint, handle, looks, mass, friction). The seed given with it
varies what differs from one meeting to the next: scale, pose, the camera's noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from akm_fg.records import FloatArray
from sim.objects.mechanisms import Catch, Closer
from sim.objects.part_spec import Hinge, hinge_side
from sim.objects.suites.furniture_physics import sample_catch, sample_closer, sample_physics

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
HandleStyle = Literal["bar", "rod", "arch", "knob", "lip", "edge"]

APPLIANCES = ("range_drawer", "microwave", "fridge", "dishwasher", "oven")
PLAIN_SHARE = 1.0 / 3.0  # of the objects, with nothing on them that a tracker could hold on to
DRAWER_FAMILIES = ("chest", "desk", "range_drawer")
HANDLELESS_FAMILIES = ("chest", "desk", "cabinet", "flap")
HANDLELESS_SHARE = 0.1  # of the objects, with a board's edge in place of a handle
RANGE_MIN_M = 0.40  # every drawer opens at least so far: the benchmark's range
DRAWER_BACK_M = 0.07  # of the drawer, kept in the cabinet at the end of the range
SLIDING_DOOR = 0.32  # of the width of a cabinet with a sliding door: the door, and its travel


@dataclass(frozen=True, slots=True)
class HandleSpec:
    """A handle's shape and place on its front.

    The style `edge` is a front without a handle: its board stands over the carcass at the free
    edge, and the fingers pinch it there from the side.
    """

    style: HandleStyle
    length_m: float  # of the bar; of a knob, its diameter; of an edge, the stretch to grip
    thickness_m: float  # across the bar: what the fingers close on
    reach_m: float  # from the front to the middle of the bar; of an edge, how far it stands over
    along: float  # -1..1, place between the ends that the front allows
    edge_m: float  # from the front's free edge (drawers: from its top) to the bar


@dataclass(frozen=True, slots=True)
class FurnitureSpec:
    """One piece of furniture with one moving part. Everything here is truth."""

    name: str
    seed: int  # of the meeting: scale, pose, camera noise
    key: tuple[int, ...]  # of the object: what else is random about it is drawn from this
    split: str
    family: Family
    kind: Literal["prismatic", "revolute"]
    hinge: Hinge | None
    size_m: FloatArray  # (3,) width, depth, height of the whole, scaled
    scale: float
    rows: tuple[float, ...]  # shares of the height, from the top, of stacked fronts
    columns: tuple[float, ...]  # shares of the width, from the left
    part_at: tuple[int, int]  # row and column of the part
    wall_m: float
    handle: HandleSpec
    plain: bool
    finish: str
    mass_kg: float  # of the moving part
    damping: float  # N s/m or N m s/rad
    friction: float  # Coulomb, N or N m
    upper: float  # end of the range, m or rad
    handle_mu: float  # sliding friction of the handle against rubber with mu 1
    catch: Catch | None  # holds it closed
    closer: Closer | None  # pulls it shut

    @property
    def balanced(self) -> bool:
        """Hinges that lie are: by springs or struts, as those of real ovens and flaps."""
        return self.hinge in ("top", "bottom")

    @property
    def view_side(self) -> float:
        """Where the hinge stands."""
        return hinge_side(self.hinge)

    @property
    def front_m(self) -> tuple[float, float]:
        """Width and height of the row and column that the part fills."""
        row, column = self.part_at
        return float(self.size_m[0] * self.columns[column]), float(self.size_m[2] * self.rows[row])


@dataclass(frozen=True, slots=True)
class SizeRanges:
    """From where a suite draws its sizes, metres."""

    front_width: tuple[float, float]
    drawer_front: tuple[float, float]  # height of one drawer's front
    door_width: tuple[float, float]
    door_height: tuple[float, float]
    flap_height: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Slot:
    """An object's place in its suite: all that is not drawn at random."""

    name: str  # SUITE/NAME
    key: tuple[int, ...]
    split: str
    family: Family
    hinge: Hinge | None  # None for a drawer or a sliding door
    plain: bool
    handleless: bool


def sample_furniture(slot: Slot, ranges: SizeRanges, seed: int) -> FurnitureSpec:
    """Draws a piece of furniture from its slot's key, and its scale from the seed."""
    key, family, hinge = slot.key, slot.family, slot.hinge
    rng = np.random.default_rng(key)
    size, rows, columns, part_at = _layout(family, hinge, ranges, rng)
    scale = float(np.random.default_rng([*key, seed]).uniform(0.9, 1.1))
    upper = float(rng.uniform(RANGE_MIN_M, 0.46) if hinge is None else rng.uniform(1.05, 1.75))
    size = _roomy(size * scale, family, upper)
    wall_m = float(rng.uniform(0.012, 0.02))
    handle = _sample_handle(family, hinge, rng)
    finish = _sample_finish(family, slot.plain, rng)
    area_m2 = float(size[0] * columns[part_at[1]] * size[2] * rows[part_at[0]])
    physics = sample_physics(area_m2, hinge is None, rng)
    if slot.handleless:  # last: what was drawn above stays what it is without this
        handle = _edge(key)
        size, rows, columns, part_at = _clear_edge(hinge, (size, rows, columns, part_at))
    # From the hinge to the free edge; a slide's forces are along the slide.
    lever_m = None if hinge is None else _lever_m(hinge, (size, rows, columns, part_at))
    return FurnitureSpec(
        name=slot.name,
        seed=seed,
        key=key,
        split=slot.split,
        family=family,
        kind="prismatic" if hinge is None else "revolute",
        hinge=hinge,
        size_m=size,
        scale=scale,
        rows=rows,
        columns=columns,
        part_at=part_at,
        wall_m=wall_m,
        handle=handle,
        plain=slot.plain,
        finish=finish,
        mass_kg=physics.mass_kg,
        damping=physics.damping,
        friction=physics.friction,
        upper=upper,
        handle_mu=physics.handle_mu,
        catch=sample_catch(key, lever_m),
        closer=sample_closer(key, lever_m, lying=hinge in ("top", "bottom")),
    )


def _roomy(size_m: FloatArray, family: Family, upper: float) -> FloatArray:
    """The size (3,) with room for a drawer's or sliding door's range."""
    width, depth, height = size_m.tolist()
    if family == "sliding":
        width = upper / SLIDING_DOOR
    elif family in DRAWER_FAMILIES:
        depth = max(depth, upper + DRAWER_BACK_M + 0.06)
    return np.array([width, depth, height])


_Layout = tuple[FloatArray, tuple[float, ...], tuple[float, ...], tuple[int, int]]


def _layout(
    family: Family, hinge: Hinge | None, ranges: SizeRanges, rng: np.random.Generator
) -> _Layout:
    """Size (3,) of the whole, its rows and columns, and which of them is the part."""
    if family in ("chest", "desk"):
        return _drawer_layout(family, ranges, rng)
    if family == "sliding":
        box = ((1.0, 1.0), (0.50, 0.58), (0.62, 0.80))  # the width follows from the range
        return np.array([rng.uniform(*side) for side in box]), (1.0,), (1.0,), (0, 0)
    if family == "cabinet":
        return _door_layout(ranges.door_width, ranges.door_height, rng)
    if family == "flap":
        return _door_layout(ranges.front_width, ranges.flap_height, rng)
    box_of = {
        "microwave": ((0.45, 0.60), (0.34, 0.42), (0.26, 0.36)),
        "fridge": ((0.45, 0.58), (0.52, 0.62), (1.25, 1.65)),
        "dishwasher": ((0.44, 0.60), (0.52, 0.60), (0.68, 0.86)),
        "oven": ((0.46, 0.60), (0.52, 0.60), (0.68, 0.88)),
        "range_drawer": ((0.46, 0.62), (0.56, 0.62), (0.72, 0.92)),
    }
    size = np.array([rng.uniform(*side) for side in box_of[family]])
    share = float(rng.uniform(0.28, 0.40))  # freezer of a fridge, drawer of a range
    lower = int(rng.integers(2)) if family == "fridge" else 1
    return size, (share, 1.0 - share), (1.0,), (lower, 0)


def _drawer_layout(family: Family, ranges: SizeRanges, rng: np.random.Generator) -> _Layout:
    """A chest of drawers, or a desk's or kitchen base's drawer above a closed front."""
    n_columns = int(rng.choice([1, 1, 2]))
    width = float(rng.uniform(*ranges.front_width)) * (1.0 if n_columns == 1 else 1.7)
    n = int(rng.integers(2, 5)) if family == "chest" else 2
    heights = rng.uniform(*ranges.drawer_front) * rng.uniform(0.85, 1.15, n)
    if family == "desk":
        heights[1] = rng.uniform(0.35, 0.55)
    row = int(rng.integers(n)) if family == "chest" else 0
    columns = (1.0,) if n_columns == 1 else (0.5, 0.5)
    size = np.array([width, rng.uniform(0.48, 0.58), heights.sum()])
    shares = tuple((heights / heights.sum()).tolist())
    return size, shares, columns, (row, int(rng.integers(n_columns)))


def _door_layout(
    width_m: tuple[float, float], height_m: tuple[float, float], rng: np.random.Generator
) -> _Layout:
    """A door, alone or with a closed front above, below or beside it."""
    width, height = rng.uniform(*width_m), rng.uniform(*height_m)
    rows: tuple[float, ...] = (1.0,)
    columns: tuple[float, ...] = (1.0,)
    row = column = 0
    beside = rng.choice(["none", "above", "below", "right", "left"])
    if beside in ("above", "below"):
        other = float(rng.uniform(0.15, 0.35))
        part = height / (height + other)
        rows = (1.0 - part, part) if beside == "above" else (part, 1.0 - part)
        row = 1 if beside == "above" else 0
        height += other
    elif beside in ("right", "left"):
        columns, column, width = (0.5, 0.5), int(beside == "left"), 2.0 * width
    size = np.array([width, rng.uniform(0.30, 0.5), height])
    return size, rows, columns, (row, column)


def _lever_m(hinge: Hinge, layout: _Layout) -> float:
    size, rows, columns, (row, column) = layout
    return float(size[0] * columns[column] if hinge in ("left", "right") else size[2] * rows[row])


def _clear_edge(hinge: Hinge | None, layout: _Layout) -> _Layout:
    """The layout with nothing beside the part's free edge: alone in its row, or the topmost."""
    size, rows, columns, (row, column) = layout
    if hinge in ("left", "right"):
        return size * [columns[column], 1.0, 1.0], rows, (1.0,), (row, 0)
    rest = tuple(share for i, share in enumerate(rows) if i != row)
    return size, (rows[row], *rest), columns, (0, column)


def _edge(key: tuple[int, ...]) -> HandleSpec:
    """A front without a handle whose board stands 4 cm over the carcass."""
    rng = np.random.default_rng([*key, 43])
    thickness, along = rng.uniform(0.014, 0.020), rng.uniform(-0.5, 0.5)
    return HandleSpec("edge", 0.12, float(thickness), 0.040, float(along), 0.0)


def _sample_handle(family: Family, hinge: Hinge | None, rng: np.random.Generator) -> HandleSpec:
    appliance = family in APPLIANCES
    styles: list[HandleStyle] = ["bar", "rod", "arch"]
    if not appliance and family != "sliding":
        styles += ["knob"] if hinge in ("left", "right") else ["knob", "lip"]
    style = styles[int(rng.integers(len(styles)))]
    length = rng.uniform(0.16, 0.30) if appliance else rng.uniform(0.09, 0.20)
    thickness = rng.uniform(0.010, 0.020)
    reach = rng.uniform(0.036, 0.050)
    if style == "knob":
        length, thickness, reach = rng.uniform(0.026, 0.036), 0.0, rng.uniform(0.030, 0.038)
        thickness = length
    if style == "lip":
        thickness, reach = rng.uniform(0.009, 0.014), rng.uniform(0.028, 0.034)
    along = rng.uniform(-0.7, 0.7) if hinge in ("left", "right") else rng.uniform(-0.25, 0.25)
    edge = rng.uniform(0.04, 0.075)
    return HandleSpec(
        style, float(length), float(thickness), float(reach), float(along), float(edge)
    )


def _sample_finish(family: Family, plain: bool, rng: np.random.Generator) -> str:
    choices = ["wood", "veneer", "painted", "stone"]
    if family in APPLIANCES:
        choices = ["brushed", "brushed", "painted", "stone"]
    finish = str(rng.choice(choices))
    return "plain" if plain else finish
