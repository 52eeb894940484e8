"""Solids of household objects: hollow, curved and thin ones, by boolean operations (manifold3d).

Object frame: x along the front, y into the object, z up, origin on the floor under the middle. The
part is given closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import trimesh

from akm_fg.records import FloatArray
from sim.objects.household.household_spec import HouseholdSpec

SIDES = 64  # of the prism that a cylinder is drawn as
GAP_M = 0.001  # between part and corpus, closed
LIP_M = 0.012  # how far a lid stands over, for fingers
KNOB_M = 0.022
Low = Sequence[float] | FloatArray


@dataclass(frozen=True, slots=True)
class Solid:
    """A closed mesh in the object frame."""

    mesh: trimesh.Trimesh
    material: str  # body, part, inside or knob
    pieces: list[trimesh.Trimesh] = field(default_factory=list)  # convex; its hull if none

    @property
    def hard(self) -> list[trimesh.Trimesh]:
        """Convex collision shapes."""
        return self.pieces or [self.mesh.convex_hull]


@dataclass(frozen=True, slots=True)
class Shapes:
    """An object's solids, its joint and where it is gripped, all in the object frame."""

    corpus: list[Solid]
    part: list[Solid]
    origin: FloatArray  # (3,) a point of the axis
    axis: FloatArray  # (3,) unit; the part opens along it
    grip: FloatArray  # (3,) where the fingers close
    approach: FloatArray  # (3,) unit, the way they come


def shapes_of(spec: HouseholdSpec) -> Shapes:
    """The object of a spec."""
    match spec.family:
        case "thin_lid" | "box_lid" | "suitcase" | "laptop":
            return _lidded_box(spec)
        case "curved_bin" | "sloped_bin":
            return _bin(spec)
        case "round_door" | "domed_door":
            return _round_door(spec)
        case "toilet":
            return _toilet(spec)
        case "book":
            return _book(spec)
        case "flap":
            return _flap(spec)
        case "sliding_lid":
            return _sliding_lid(spec)
        case "tray":
            return _tray(spec)


def _box(low: Low, high: Low) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=np.array([low, high], dtype=float))


def _cylinder(radius: float, length: float, axis: int, middle: Low) -> trimesh.Trimesh:
    """A cylinder along x, y or z."""
    turn = {0: [0, 1, 0], 1: [1, 0, 0]}.get(axis)
    mesh = trimesh.creation.cylinder(radius, length, sections=SIDES)
    if turn is not None:
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, turn))
    mesh.apply_translation(middle)
    return mesh


def _cut(a: trimesh.Trimesh, *others: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.boolean.difference([a, *others], engine="manifold")


def _common(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.boolean.intersection(list(meshes), engine="manifold")


def _hollow(low: Low, high: Low, wall: float, opened: Low, material: str) -> Solid:
    """A box without the side that `opened` (3,), an outward normal, names."""
    a, b, way = np.array(low, float), np.array(high, float), np.array(opened, float)
    past = 2 * wall
    inner = _box(a + wall + np.minimum(way, 0) * past, b - wall + np.maximum(way, 0) * past)
    walls = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            if way[axis] == sign:
                continue
            c, d = a.copy(), b.copy()
            if sign < 0:
                d[axis] = a[axis] + wall
            else:
                c[axis] = b[axis] - wall
            walls.append(_box(c, d))
    return Solid(_cut(_box(a, b), inner), material, walls)


def _lid(spec: HouseholdSpec, base_m: float, part: list[Solid], corpus: list[Solid]) -> Shapes:
    """Hinged along the back edge at a height; gripped at the lip in front."""
    depth = float(spec.size_m[1])
    lip = np.array([0.0, -depth / 2 - LIP_M / 2, base_m + GAP_M + spec.wall_m / 2])
    return Shapes(
        corpus,
        part,
        np.array([0.0, depth / 2, base_m]),
        np.array([-1.0, 0, 0]),
        lip,
        np.array([0.0, 1.0, 0]),
    )


def _lip(spec: HouseholdSpec, base_m: float) -> Solid:
    depth, low = float(spec.size_m[1]), base_m + GAP_M
    front = [-0.05, -depth / 2 - LIP_M, low], [0.05, -depth / 2 + 0.002, low + spec.wall_m]
    return Solid(_box(*front), "part")


def _lidded_box(spec: HouseholdSpec) -> Shapes:
    """A hollow box with a thin or a hollow lid, a suitcase, a laptop."""
    (w, d, h), wall = spec.size_m.tolist(), spec.wall_m
    if spec.family == "laptop":
        base = h - 0.008
        corpus = [Solid(_box([-w / 2, -d / 2, 0], [w / 2, d / 2, base]), "body")]
        top = _box([-w / 2, -d / 2, base + GAP_M], [w / 2, d / 2, h])
        return _lid(spec, base, [Solid(top, "part"), _lip(spec, base)], corpus)
    thick = {"thin_lid": wall, "suitcase": 0.5 * h}.get(spec.family, (0.15 + 0.25 * spec.share) * h)
    base = h - thick
    corpus = [_hollow([-w / 2, -d / 2, 0], [w / 2, d / 2, base], wall, [0, 0, 1], "body")]
    low, high = [-w / 2, -d / 2, base + GAP_M], [w / 2, d / 2, h + GAP_M]
    if spec.family == "thin_lid":
        lid = Solid(_box(low, high), "part")
    else:
        lid = _hollow(low, high, wall, [0, 0, -1], "part")
    return _lid(spec, base, [lid, _lip(spec, base)], corpus)


def _bin(spec: HouseholdSpec) -> Shapes:
    """A hollow bin whose lid is an arch, or slopes towards the front."""
    (w, d, h), wall = spec.size_m.tolist(), spec.wall_m
    rise = (0.12 + 0.12 * spec.share) * d
    base = h - rise
    corpus = [_hollow([-w / 2, -d / 2, 0], [w / 2, d / 2, base], wall, [0, 0, 1], "body")]
    over = base + GAP_M
    if spec.family == "curved_bin":
        radius = (d * d / 4 + rise * rise) / (2 * rise)
        middle = [0.0, 0.0, over + rise - radius]
        above = _box([-w, -d, over], [w, d, over + 2 * rise])
        outer = _cylinder(radius, w, 0, middle)
        inner = _cylinder(radius - wall, w - 2 * wall, 0, middle)
        lid = _common(_cut(outer, inner), above)
    else:
        lid = _cut(_wedge(w, d, over, rise), _wedge(w - 2 * wall, d - 2 * wall, over, rise - wall))
    return _lid(spec, base, [Solid(lid, "part"), _lip(spec, base)], corpus)


def _wedge(w: float, d: float, low: float, rise: float) -> trimesh.Trimesh:
    """Flat below, from a front edge up to a back of the full rise."""
    x, y = w / 2, d / 2
    profile = [(-y, low - 1e-4), (y, low - 1e-4), (y, low + rise), (-y, low + 0.15 * rise)]
    points = [(s * x, b, c) for s in (-1, 1) for b, c in profile]
    return trimesh.convex.convex_hull(np.array(points))


def _side(spec: HouseholdSpec) -> float:
    """-1 where the hinge stands on the left, 1 on the right."""
    return -1.0 if spec.hinge == "left" else 1.0


def _knob(middle: Low) -> Solid:
    p = np.array(middle, dtype=float)
    return Solid(_box(p - KNOB_M / 2, p + KNOB_M / 2), "knob")


def _round_door(spec: HouseholdSpec) -> Shapes:
    """A washing machine: a disc or a dome before a round opening."""
    w, d, h = spec.size_m.tolist()
    side, r, thick = _side(spec), (0.26 + 0.06 * spec.share) * w, 0.035
    front, middle = -d / 2, 0.55 * h
    body = _box([-w / 2, front, 0], [w / 2, d / 2, h])
    drum = _cylinder(0.8 * r, 0.5 * d, 1, [0, front + 0.2 * d, middle])
    corpus = [Solid(_cut(body, drum), "body", [body])]
    y = front - GAP_M - thick / 2
    ring = _cylinder(r, thick, 1, [0, y, middle])
    part = [Solid(ring, "part")]
    if spec.family == "domed_door":
        rise = (0.25 + 0.25 * spec.share) * r
        radius = (0.64 * r * r + rise * rise) / (2 * rise)
        ball = trimesh.creation.icosphere(subdivisions=4, radius=radius)
        ball.apply_translation([0, y - thick / 2 + radius - rise, middle])
        ahead = _box([-r, y - thick / 2 - rise - 0.01, middle - r], [r, y, middle + r])
        part.append(Solid(_common(ball, ahead), "inside"))
    else:
        pane = _cylinder(0.68 * r, 0.004, 1, [0, y - thick / 2 - 0.002, middle])
        part.append(Solid(pane, "inside"))
    grip = np.array([-side * 0.88 * r, y - thick / 2 - KNOB_M / 2, middle])
    part.append(_knob(grip.tolist()))
    origin = np.array([side * r, front - GAP_M, middle])
    return Shapes(corpus, part, origin, np.array([0, 0, side]), grip, np.array([0.0, 1, 0]))


def _toilet(spec: HouseholdSpec) -> Shapes:
    """An oval lid on a hollow bowl before a tank."""
    w, d, h = spec.size_m.tolist()
    thick = 0.012 + 0.008 * spec.share
    base = h - thick
    bowl, inner, lid = (
        _oval(w * k, d * k, base if k <= 1 else thick, 0.0 if k <= 1 else base + GAP_M)
        for k in (0.98, 0.8, 1.02)
    )
    inner.apply_translation([0, 0, 0.3 * h])
    tank = _box([-0.5 * w, d / 2 + 0.03, 0], [0.5 * w, d / 2 + 0.19, h + 0.36])
    corpus = [Solid(_cut(bowl, inner), "body"), Solid(tank, "body")]
    return _lid(spec, base, [Solid(lid, "part"), _lip(spec, base)], corpus)


def _oval(w: float, d: float, height: float, low: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.cylinder(1.0, height, sections=SIDES)
    mesh.apply_scale([w / 2, d / 2, 1.0])
    mesh.apply_translation([0, 0, low + height / 2])
    return mesh


def _book(spec: HouseholdSpec) -> Shapes:
    """A cover that turns about the spine on the left, on a block of pages."""
    (w, d, h), wall = spec.size_m.tolist(), spec.wall_m
    base = h - wall
    corpus = [Solid(_box([-w / 2, -d / 2, 0], [w / 2 - 0.003, d / 2, base]), "inside")]
    cover = _box([-w / 2, -d / 2, base + GAP_M], [w / 2 + 0.003, d / 2, h + GAP_M])
    grip = np.array([w / 2 - 0.005, 0.0, base + GAP_M + wall / 2])
    origin = np.array([-w / 2, 0.0, base])
    part = [Solid(cover, "part")]
    return Shapes(corpus, part, origin, np.array([0.0, -1, 0]), grip, np.array([-1.0, 0, 0]))


def _flap(spec: HouseholdSpec) -> Shapes:
    """A thin door on a frame."""
    (w, d, h), wall = spec.size_m.tolist(), spec.wall_m
    side, front = _side(spec), -d / 2
    frame = _hollow([-w / 2, front, 0], [w / 2, d / 2, h], 0.02, [0, -1, 0], "body")
    y = front - GAP_M
    panel = _box([-w / 2, y - wall, 0.004], [w / 2, y, h])
    grip = np.array([-side * (w / 2 - 0.03), y - wall - KNOB_M / 2, 0.5 * h])
    part = [Solid(panel, "part"), _knob(grip.tolist())]
    origin = np.array([side * w / 2, y, h / 2])
    return Shapes([frame], part, origin, np.array([0, 0, side]), grip, np.array([0.0, 1, 0]))


def _sliding_lid(spec: HouseholdSpec) -> Shapes:
    """A board that slides along the box that it closes."""
    (w, d, h), wall = spec.size_m.tolist(), spec.wall_m
    base = h - wall
    corpus = [_hollow([-w / 2, -d / 2, 0], [w / 2, d / 2, base], 0.008, [0, 0, 1], "body")]
    lid = _box([-w / 2, -d / 2, base + GAP_M], [w / 2, d / 2, h + GAP_M])
    grip = np.array([0.35 * w, 0.0, h + GAP_M + KNOB_M / 2])
    part = [Solid(lid, "part"), _knob(grip.tolist())]
    way = np.array([1.0, 0, 0])
    return Shapes(corpus, part, np.array([0.0, 0, base]), way, grip, np.array([0.0, 0, -1]))


def _tray(spec: HouseholdSpec) -> Shapes:
    """A hollow tray in a sleeve."""
    (w, d, h), wall = spec.size_m.tolist(), spec.wall_m
    sleeve = _hollow([-w / 2, -d / 2, 0], [w / 2, d / 2, h], wall, [0, -1, 0], "body")
    inset = wall + 2 * GAP_M
    low = [-w / 2 + inset, -d / 2 - 0.004, inset]
    high = [w / 2 - inset, d / 2 - inset, h - inset]
    grip = np.array([0.0, -d / 2 - 0.004 - KNOB_M / 2, h / 2])
    part = [_hollow(low, high, wall, [0, 0, 1], "part"), _knob(grip.tolist())]
    way = np.array([0.0, -1, 0])
    return Shapes([sleeve], part, np.array([0.0, 0, h / 2]), way, grip, np.array([0.0, 1, 0]))
