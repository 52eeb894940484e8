"""The boxes of a piece of furniture, from scene_synthesizer, without its handles.

The library's own moving parts other than the chosen one stay where they are, as fronts of the
corpus. Object frame: x along the front, y into the furniture, z up, origin on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np
from scene_synthesizer import procedural_assets

from akm_fg.records import FloatArray
from sim.objects.library_boxes import box_of, build_asset, shifted
from sim.objects.meshes import Box
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


@dataclass(frozen=True, slots=True)
class Body:
    """Boxes of corpus and part in their links' frames, and the joint in the object frame."""

    corpus: list[Box]
    part: list[Box]
    origin: FloatArray  # (3,) of the part's frame, a point of the axis
    axis: FloatArray  # (3,) unit; the part opens along it

    def front(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corners (3,), (3,) of the part's front, in the part's frame."""
        corners = [
            box.T_link_box.translation() + sign * box.size_m / 2.0
            for box in self.part
            if box.material in ("front", "glass")
            for sign in (-1.0, 1.0)
        ]
        return np.min(corners, axis=0), np.max(corners, axis=0)


def make_body(spec: FurnitureSpec) -> Body:
    """Builds the library's asset and takes its boxes."""
    asset = build_asset(lambda scratch: _make_asset(spec, scratch))
    wanted = PART_LINK.get(spec.family)
    moving = asset.movable()
    joint = next(j for j in moving if wanted is None or j.child == wanted[spec.part_at[0]])
    # All links hang on one that stands in the object frame's origin, and none is turned.
    origins = {j.child: j.T_parent_joint.translation() for j in moving}
    corpus = [
        shifted(box, origins.get(link.name, np.zeros(3)))
        for link in asset.links.values()
        if link.name != joint.child
        for box in _boxes(link)
    ]
    part = _boxes(asset.links[joint.child])
    body = Body(corpus, part, origins[joint.child], joint.axis)
    return _faced(body, spec) if spec.family == "sliding" else body


def _faced(body: Body, spec: FurnitureSpec) -> Body:
    """The library's cabinet with a sliding door, turned to face -y and put on the floor.

    Its door opens towards its own -x. Half of them are mirrored, so that both ways occur; every
    box is parallel to the axes and keeps its shape.
    """
    everything = body.corpus + body.part
    centres = np.array([box.T_link_box.translation() for box in everything])
    halves = np.array([box.size_m for box in everything]) / 2.0
    low, high = (centres - halves).min(axis=0), (centres + halves).max(axis=0)
    shift = np.array([(low[0] + high[0]) / 2.0, 0.0, low[2]])
    x_sign = float(np.random.default_rng([*spec.key, 53]).choice([-1.0, 1.0]))
    signs = np.array([x_sign, -1.0, 1.0])

    def moved(box: Box) -> Box:
        T = box.T_link_box
        p_object = signs * (T.translation() - shift)
        return replace(box, T_link_box=gtsam.Pose3(T.rotation(), p_object))

    corpus, part = [moved(box) for box in body.corpus], [moved(box) for box in body.part]
    return Body(corpus, part, body.origin, np.array([-x_sign, 0.0, 0.0]))


def _make_asset(spec: FurnitureSpec, scratch: str) -> Any:
    """The library's asset of the spec's family."""
    width, depth, height = spec.size_m.tolist()
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
                freezer_compartment_height=spec.rows[0] * height,
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
            return _cabinet(spec)


def _cabinet(spec: FurnitureSpec) -> Any:
    """Stacked and adjoining fronts, all closed but the part."""
    width, depth, height = spec.size_m.tolist()
    n_columns = len(spec.columns)
    mask = np.arange(len(spec.rows) * n_columns).reshape(-1, n_columns)
    types = ["closed"] * mask.size
    types[mask[spec.part_at]] = COMPARTMENT[spec.hinge]
    return procedural_assets.CabinetAsset(
        width=width,
        depth=depth,
        height=height,
        compartment_mask=mask.tolist(),
        compartment_types=types,
        compartment_heights=[share * height for share in spec.rows],
        compartment_widths=[share * width for share in spec.columns],
        outer_wall_thickness=spec.wall_m,
        inner_wall_thickness=spec.wall_m,
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
