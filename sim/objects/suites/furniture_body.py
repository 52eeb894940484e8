"""The boxes of a piece of furniture, from scene_synthesizer, without its handles.

The library's own moving parts other than the chosen one stay where they are, as fronts of the
corpus. Object frame: x along the front, y into the furniture, z up, origin on the floor.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from scene_synthesizer import procedural_assets

from akm_fg.records import FloatArray
from sim.bullet import quiet
from sim.objects.meshes import Box
from sim.objects.suites.furniture_spec import FurnitureSpec

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
    """Builds the library's asset and reads its boxes back."""
    with tempfile.TemporaryDirectory(prefix="akm-fg-sim-") as scratch:
        with quiet():
            path = Path(scratch) / "raw.urdf"
            _asset(spec, scratch).scene().export(str(path))
        root = ET.parse(path).getroot()
    moving = [joint for joint in root.iter("joint") if joint.get("type") != "fixed"]
    wanted = PART_LINK.get(spec.family)
    part = wanted[spec.part_at[0]] if wanted else _child(moving[0])
    frames = {_child(joint): _numbers(joint.find("origin"), "xyz") for joint in moving}
    boxes: dict[str, list[Box]] = {"corpus": [], "part": []}
    for link in root.iter("link"):
        name = str(link.get("name"))
        shift = np.zeros(3) if name == part else frames.get(name, np.zeros(3))
        found = [_box(c, shift) for c in link.iter("collision")]
        boxes["part" if name == part else "corpus"] += [box for box in found if box is not None]
    joint = next(j for j in moving if _child(j) == part)
    axis = _numbers(joint.find("axis"), "xyz")
    body = Body(boxes["corpus"], boxes["part"], frames[part], axis / np.linalg.norm(axis))
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


def _asset(spec: FurnitureSpec, scratch: str) -> Any:
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


def _child(joint: ET.Element) -> str:
    child = joint.find("child")
    assert child is not None
    return str(child.get("link"))


def _numbers(element: ET.Element | None, key: str) -> FloatArray:
    assert element is not None
    return np.array([float(x) for x in str(element.get(key)).split()])


def _box(collision: ET.Element, shift: FloatArray) -> Box | None:
    """A box or upright disc of the library; None for handles, racks and baskets."""
    name = str(collision.get("name"))
    origin = collision.find("origin")
    rod = collision.find("geometry/cylinder")
    if rod is not None:
        radius, length = float(str(rod.get("radius"))), float(str(rod.get("length")))
        size = np.array([2.0 * radius, 2.0 * radius, length])
    elif collision.find("geometry/box") is not None:
        size = _numbers(collision.find("geometry/box"), "size")
    else:
        return None
    if "handle" in name or "basket" in name or np.sort(size)[1] < 2.0 * WIRE_M:
        return None
    T = gtsam.Pose3(gtsam.Rot3.RzRyRx(*_numbers(origin, "rpy")), _numbers(origin, "xyz") + shift)
    return Box(name, size, T, _material(name), rounded=rod is not None)


def _material(name: str) -> str:
    if "window" in name:
        return "glass"
    if "heater" in name:
        return "handle"
    front = any(word in name for word in ("closed", "panel", "door_front", "cover_front"))
    front = front or name.endswith("board_0") or "_door_" in name
    return "front" if front or name.endswith("_door") else "carcass"
