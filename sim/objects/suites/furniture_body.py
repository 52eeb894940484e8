"""The boxes of a piece of furniture, from scene_synthesizer, without its handles.

The library's own moving parts other than the chosen one stay where they are, as fronts of the
corpus; so does a cabinet beside or below an appliance. Object frame: x along the front, y into the
furniture, z up, origin on the floor.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np
from scene_synthesizer import procedural_assets

from akm_fg.records import FloatArray
from sim.objects.library_boxes import box_of, build_asset, shifted
from sim.objects.meshes import Box
from sim.objects.part_spec import Hinge
from sim.objects.suites.faces import Face
from sim.objects.suites.families import APPLIANCES
from sim.objects.suites.furniture_spec import FurnitureSpec
from sim.objects.urdf.urdf_model import Link

PART_LINK = {  # of the library's URDF, where it is not the only moving one
    "fridge": ("object_freezer_door", "object_door"),
    "range_drawer": ("object_drawer_0_2",) * 2,
    "oven": ("object_door_0_1",) * 2,
    "dishwasher": ("object_door_0_1",) * 2,
}
WIRE_M = 0.006  # racks are hundreds of thin wires inside, and none of them is ever seen
# The library's names are as seen from inside.
COMPARTMENT = {
    None: "drawer",
    "left": "door_right",
    "right": "door_left",
    "top": "door_bottom",
    "bottom": "door_top",
}


Corners = tuple[FloatArray, FloatArray]  # lower and upper (3,), (3,), of a box


@dataclass(frozen=True, slots=True)
class Moving:
    """A part that opens besides the first."""

    boxes: list[Box]  # in its own frame
    origin: FloatArray  # (3,) of that frame, a point of the axis
    axis: FloatArray  # (3,) unit; the part opens along it

    def front(self) -> Corners:
        """Lower and upper corners (3,), (3,) of its front, in the object frame."""
        lower, upper = _front_of(self.boxes)
        return lower + self.origin, upper + self.origin


@dataclass(frozen=True, slots=True)
class Body:
    """Boxes of corpus and part in their links' frames, and the joint in the object frame."""

    corpus: list[Box]
    part: list[Box]
    origin: FloatArray  # (3,) of the part's frame, a point of the axis
    axis: FloatArray  # (3,) unit; the part opens along it
    locked: list[Corners]  # the other fronts, in the object frame, from above; free ones too
    panel: Corners | None  # where an appliance may have knobs
    more: tuple[Moving, ...] = ()  # as the spec has them

    def front(self) -> Corners:
        """Lower and upper corners (3,), (3,) of the part's front, in the part's frame."""
        return _front_of(self.part)

    def more_in_locked(self) -> list[int]:
        """Where among the other fronts those are that open."""
        middles = np.array([(lower + upper) / 2.0 for lower, upper in self.locked]).reshape(-1, 3)
        fronts = [moving.front() for moving in self.more]
        return [
            int(np.linalg.norm(middles - (lower + upper) / 2.0, axis=1).argmin())
            for lower, upper in fronts
        ]


def _front_of(boxes: list[Box]) -> Corners:
    return _around([box for box in boxes if box.material in ("front", "glass")])


def make_body(spec: FurnitureSpec) -> Body:
    """Builds the library's asset and takes its boxes, and those of what stands beside it."""
    asset = build_asset(lambda scratch: _make_asset(spec, scratch))
    moving = {joint.child: joint for joint in asset.movable()}
    child = _child(spec, moving)
    # All links hang on one that stands in the object frame's origin, and none is turned.
    origins = {name: joint.T_parent_joint.translation() for name, joint in moving.items()}
    freed = [_compartment(spec.face, front.front, front.hinge) for front in spec.more]
    still = [
        [shifted(box, origins.get(link.name, np.zeros(3))) for box in _boxes(link)]
        for link in asset.links.values()
        if link.name not in (child, *freed)
    ]
    corpus = [box for boxes in still for box in boxes]
    part = _boxes(asset.links[child])
    more = tuple(Moving(_boxes(asset.links[n]), origins[n], moving[n].axis) for n in freed)
    body = Body(corpus, part, origins[child], moving[child].axis, [], None, more)
    if spec.family == "sliding":
        body = _faced(body, spec)
        # Its twin has no handle that it would run into; the blocks that both stand between do.
        ends = [
            box
            for box in body.corpus
            if box.name.endswith(("left_part_collision", "right_part_collision"))
        ]
        locked = [_around([max(ends, key=lambda box: float(box.size_m[0]))])]
    elif spec.family in APPLIANCES:
        fronts = [[box for box in boxes if box.material in ("front", "glass")] for boxes in still]
        locked = [_around(boxes) for boxes in fronts if boxes and "closed" not in boxes[0].name]
        body = replace(body, panel=_panel(corpus, spec))
    else:
        locked = [_around([box]) for box in corpus if "closed" in box.name]
        locked += [free.front() for free in more]
    return _in_the_middle(_beside(replace(body, locked=locked), spec), spec)


def _child(spec: FurnitureSpec, moving: Collection[str]) -> str:
    """The library's link of the first free front."""
    wanted = PART_LINK.get(spec.family)
    if wanted is not None:
        return wanted[spec.face.fronts[0].top]
    if spec.more:
        return _compartment(spec.face, 0, spec.hinge)
    return next(iter(moving))


def _compartment(face: Face, front: int, hinge: Hinge | None) -> str:
    """What the library calls a free front of its cabinets, by its upper left cell."""
    at = face.fronts[front]
    return f"object_{'drawer' if hinge is None else 'door'}_{at.left}_{at.top}"


def _around(boxes: list[Box]) -> Corners:
    """The corners of a box around some that are parallel to the axes."""
    corners = [
        box.T_link_box.translation() + sign * box.size_m / 2.0
        for box in boxes
        for sign in (-1.0, 1.0)
    ]
    return np.min(corners, axis=0), np.max(corners, axis=0)


def _panel(corpus: list[Box], spec: FurnitureSpec) -> Corners | None:
    """Where an appliance's knobs are: above its door, or beside a microwave's."""
    if spec.family == "microwave":
        sides = [box for box in corpus if box.name.endswith(("_left", "_right"))]
        return _around([max(sides, key=lambda box: float(box.size_m[0]))])
    above = [box for box in corpus if box.name.endswith("closed_0_0")]
    return _around(above) if above else None


def _beside(body: Body, spec: FurnitureSpec) -> Body:
    """The body with its neighbour, whose fronts are in line with its own."""
    neighbour = spec.neighbour
    if neighbour is None:
        return body
    width, height = (spec.scale * side for side in neighbour.size_m)
    size = np.array([width, float(spec.own_m[1]), height])
    asset = build_asset(lambda _: _cabinet(neighbour.face, size, spec.wall_m, {}))
    boxes = [box for link in asset.links.values() for box in _boxes(link)]
    ahead = float((body.origin + body.front()[0])[1]) - float(_around(boxes)[0][1])
    own, offset = spec.own_m, np.array([0.0, ahead, 0.0])
    if neighbour.side == "below":
        lift = np.array([0.0, 0.0, height])
        body = _shifted(body, lift)
    else:
        sign = 1.0 if neighbour.side == "right" else -1.0
        offset[0] = sign * (float(own[0]) + width) / 2.0
    boxes = [shifted(box, offset) for box in boxes]
    locked = [_around([box]) for box in boxes if "closed" in box.name]
    return replace(body, corpus=[*body.corpus, *boxes], locked=[*body.locked, *locked])


def _in_the_middle(body: Body, spec: FurnitureSpec) -> Body:
    """The body with its middle above the origin, and its locked fronts from above."""
    aside = 0.0
    if spec.neighbour is not None and spec.neighbour.side != "below":
        sign = 1.0 if spec.neighbour.side == "right" else -1.0
        aside = -sign * float(spec.size_m[0] - spec.own_m[0]) / 2.0
    body = _shifted(body, np.array([aside, 0.0, 0.0]))
    order = sorted(body.locked, key=lambda c: (-round(float(c[1][2]), 3), float(c[0][0])))
    return replace(body, locked=order)


def _shifted(body: Body, by_m: FloatArray) -> Body:
    """The body moved by (3,) metres in the object frame."""
    return Body(
        [shifted(box, by_m) for box in body.corpus],
        body.part,
        body.origin + by_m,
        body.axis,
        [(lower + by_m, upper + by_m) for lower, upper in body.locked],
        None if body.panel is None else (body.panel[0] + by_m, body.panel[1] + by_m),
        tuple(replace(moving, origin=moving.origin + by_m) for moving in body.more),
    )


def _faced(body: Body, spec: FurnitureSpec) -> Body:
    """The library's cabinet with a sliding door, turned to face -y and put on the floor.

    Its door opens towards its own -x. Half of them are mirrored, so that both ways occur; every
    box is parallel to the axes and keeps its shape.
    """
    low, high = _around(body.corpus + body.part)
    shift = np.array([(low[0] + high[0]) / 2.0, 0.0, low[2]])
    x_sign = float(np.random.default_rng([*spec.key, 53]).choice([-1.0, 1.0]))
    signs = np.array([x_sign, -1.0, 1.0])

    def moved(box: Box) -> Box:
        T = box.T_link_box
        p_object = signs * (T.translation() - shift)
        return replace(box, T_link_box=gtsam.Pose3(T.rotation(), p_object))

    corpus, part = [moved(box) for box in body.corpus], [moved(box) for box in body.part]
    return replace(body, corpus=corpus, part=part, axis=np.array([-x_sign, 0.0, 0.0]))


def _make_asset(spec: FurnitureSpec, scratch: str) -> Any:
    """The library's asset of the spec's family."""
    width, depth, height = spec.own_m.tolist()
    sides = {"width": width, "depth": depth, "height": height}
    plain: dict[str, Any] = {"handle_shape_args": None}
    left = spec.hinge == "right"  # the handle is where the hinge is not
    match spec.family:
        case "microwave":
            return procedural_assets.MicrowaveAsset(
                **sides, thickness=0.03, handle_left=left, tmp_mesh_dir=scratch
            )
        case "fridge":
            return procedural_assets.RefrigeratorAsset(
                **sides,
                **plain,
                door_shape_args=None,
                handle_left=left,
                num_door_shelves=0,
                thickness=0.05,
                freezer_compartment_height=spec.face.rows[0] * height,
            )
        case "dishwasher":
            return procedural_assets.DishwasherAsset(
                **sides, **plain, handle_length=0.3, door_thickness=0.03
            )
        case "oven" | "range_drawer":
            return procedural_assets.RangeAsset(
                **sides,
                **plain,
                handle_length=0.3,
                storage_height=0.25 * height,
                oven_height=0.6 * height,
                control_panel_height=0.15 * height,
            )
        case "sliding":
            return procedural_assets.CNCMachineAsset(
                **sides, handle_length=0.3, handle_shape_args=None, button_size=0.0
            )
        case _:
            free = {0: spec.hinge} | {front.front: front.hinge for front in spec.more}
            return _cabinet(spec.face, spec.own_m, spec.wall_m, free)


def _cabinet(
    face: Face, size_m: FloatArray, wall_m: float, free: Mapping[int, Hinge | None]
) -> Any:
    """A cabinet with the fronts of a face, all closed but those that are free, by their hinges.

    A closed compartment's board is the board of a drawer or door there, to the millimetre.
    """
    width, depth, height = size_m.tolist()
    types = ["closed"] * len(face.fronts)
    for front, hinge in free.items():
        types[front] = COMPARTMENT[hinge]
    return procedural_assets.CabinetAsset(
        width=width,
        depth=depth,
        height=height,
        compartment_mask=face.mask().tolist(),
        compartment_types=types,
        compartment_heights=[share * height for share in face.rows],
        compartment_widths=[share * width for share in face.columns],
        outer_wall_thickness=wall_m,
        inner_wall_thickness=wall_m,
        drawer_wall_thickness=0.012,
    )


def _boxes(link: Link) -> list[Box]:
    """The link's boxes and upright discs, without handles, racks and baskets."""
    found = [
        box_of(shape, _material(shape.name))
        for shape in link.collisions
        if "handle" not in shape.name and "basket" not in shape.name
    ]
    return [box for box in found if box is not None and np.sort(box.size_m)[1] >= 2.0 * WIRE_M]


def _material(name: str) -> str:
    if "window" in name:
        return "glass"
    if "heater" in name:
        return "handle"
    front = any(word in name for word in ("closed", "panel", "door_front", "cover_front"))
    front = front or name.endswith("board_0") or "_door_" in name
    return "front" if front or name.endswith("_door") else "carcass"
