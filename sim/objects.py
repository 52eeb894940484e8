"""The two embedded objects, `door` and `drawer`: one cabinet each, varied by a seed.

Geometry comes from scene_synthesizer; masses, inertia, damping, friction and looks are ours,
because its masses are grams and it has no textures. Object frame: x along the front, y into the
cabinet, z up, origin on the floor under the middle. The gripper frame is that of `Arm`.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import gtsam
import numpy as np
from scene_synthesizer.procedural_assets import CabinetAsset

from akm_fg.records import FloatArray
from sim.bullet import quiet
from sim.meshes import Box, inertia_of_boxes, write_textured_boxes
from sim.textures import FRONT_TEXTURES, Rgb, brushed_metal, rotated

OBJECT_NAMES = ("door", "drawer")
PART_JOINT = "part_joint"


@dataclass(frozen=True, slots=True)
class ObjectSpec:
    """One cabinet with one moving part. Everything here is truth: for building and scoring."""

    name: str
    seed: int
    kind: Literal["prismatic", "revolute"]
    hinge: Literal["left", "right"] | None  # as seen from the front; None for a drawer
    size_m: FloatArray  # (3,) width, depth, height
    front_height_m: float  # of the moving front; a closed panel fills the rest below it
    handle_bar_m: float  # thickness of the bar
    handle_length_m: float
    handle_reach_m: float  # from the front to the outside of the bar
    handle_shift_m: FloatArray  # (2,) of the handle from its usual place, along x and z
    mass_kg: float  # of the moving part
    damping: float  # N s/m or N m s/rad
    friction: float  # Coulomb, N or N m
    upper: float  # end of the range, m or rad
    handle_mu: float  # sliding friction of the handle against rubber with mu 1
    front_texture: str


@dataclass(frozen=True, slots=True)
class BuiltObject:
    """An object's files and geometry, in its own frame."""

    spec: ObjectSpec
    urdf: Path
    axis_object: FloatArray  # (3,) unit; the part opens along it (right-hand rule)
    pivot_object: FloatArray  # (3,) a point of the joint axis
    T_object_handle: gtsam.Pose3  # closed; z into the cabinet, x along the bar


def sample_object(name: str, seed: int) -> ObjectSpec:
    """The object `name` as varied by `seed`.

    Figures are those of kitchen and office furniture: drawers of 2 to 6 kg on slides with 2 to
    6 N of friction, doors of 3 to 8 kg with 0.2 to 0.8 N m in the hinges.

    Raises:
        ValueError: no such object.
    """
    if name not in OBJECT_NAMES:
        raise ValueError(f"object {name!r}, expected one of {', '.join(OBJECT_NAMES)}")
    rng = np.random.default_rng([seed, OBJECT_NAMES.index(name)])
    drawer = name == "drawer"
    height = rng.uniform(0.6, 0.75)
    front = rng.uniform(0.2, 0.3) if drawer else rng.uniform(0.38, 0.5)
    hinge: Literal["left", "right"] = "left" if rng.random() < 0.5 else "right"
    return ObjectSpec(
        name=name,
        seed=seed,
        kind="prismatic" if drawer else "revolute",
        hinge=None if drawer else hinge,
        size_m=np.array([rng.uniform(0.38, 0.52), 0.56 if drawer else 0.4, height]),
        front_height_m=front,
        handle_bar_m=rng.uniform(0.012, 0.02),
        handle_length_m=rng.uniform(0.12, 0.18),
        handle_reach_m=rng.uniform(0.042, 0.055),
        handle_shift_m=rng.uniform(-0.03, 0.03, 2),
        mass_kg=rng.uniform(2.0, 6.0) if drawer else rng.uniform(3.0, 8.0),
        damping=rng.uniform(3.0, 12.0) if drawer else rng.uniform(0.3, 1.0),
        friction=rng.uniform(2.0, 6.0) if drawer else rng.uniform(0.2, 0.8),
        upper=0.44 if drawer else np.pi / 2,
        handle_mu=rng.uniform(0.8, 1.0),
        front_texture=str(rng.choice(sorted(FRONT_TEXTURES))),
    )


def build_object(spec: ObjectSpec, folder: Path) -> BuiltObject:
    """Writes the object's URDF, meshes and textures into `folder`."""
    links, joint = _synthesize(spec)
    rng = np.random.default_rng([spec.seed, 77])
    _write_textures(spec, folder, rng)
    robot = ET.Element("robot", name=spec.name)
    moved = _place_handle(links["part"], spec)
    for name, boxes in (("corpus", links["corpus"]), ("part", moved)):
        mass = spec.mass_kg if name == "part" else 25.0
        robot.append(_link(name, boxes, mass, folder))
    robot.append(_joint(spec, joint))
    urdf = folder / "object.urdf"
    ET.ElementTree(robot).write(urdf)
    bar = next(box for box in moved if box.name.endswith("handle_part_0"))
    R_object_handle = gtsam.Rot3(np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]))
    if spec.kind == "revolute":  # the bar stands upright: x along it
        R_object_handle = R_object_handle * gtsam.Rot3.Rz(-np.pi / 2)
    p_bar = joint.origin + bar.T_link_box.translation()
    return BuiltObject(
        spec=spec,
        urdf=urdf,
        axis_object=joint.axis,
        pivot_object=joint.origin,
        T_object_handle=gtsam.Pose3(R_object_handle, p_bar),
    )


@dataclass(frozen=True, slots=True)
class _Joint:
    origin: FloatArray  # (3,) object frame
    axis: FloatArray  # (3,)


def _synthesize(spec: ObjectSpec) -> tuple[dict[str, list[Box]], _Joint]:
    """Boxes of the corpus and of the part, each in its link's frame, and the joint."""
    width, depth, height = spec.size_m.tolist()
    # The library's door_left has its hinge on the right as seen from the front.
    kind = "drawer"
    if spec.kind == "revolute":
        kind = "door_right" if spec.hinge == "left" else "door_left"
    with tempfile.TemporaryDirectory() as scratch, quiet():
        asset = CabinetAsset(
            width=width,
            depth=depth,
            height=height,
            compartment_mask=[[0], [1]],
            compartment_types=[kind, "closed"],
            compartment_heights=[spec.front_height_m, height - spec.front_height_m],
            outer_wall_thickness=0.016,
            drawer_wall_thickness=0.012,
            handle_width=spec.handle_length_m,
            handle_height=spec.handle_reach_m,
            handle_depth=spec.handle_bar_m,
        )
        path = Path(scratch) / "raw.urdf"
        asset.scene().export(str(path))
        root = ET.parse(path).getroot()
    moving = next(j for j in root.iter("joint") if j.get("type") != "fixed")
    child = moving.find("child").get("link")  # type: ignore[union-attr]
    origin = _numbers(moving.find("origin"), "xyz")
    links: dict[str, list[Box]] = {"corpus": [], "part": []}
    for link in root.iter("link"):
        for collision in link.iter("collision"):
            links["part" if link.get("name") == child else "corpus"].append(_box(collision))
    return links, _Joint(origin, _numbers(moving.find("axis"), "xyz"))


def _numbers(element: ET.Element | None, key: str) -> FloatArray:
    assert element is not None
    return np.array([float(x) for x in str(element.get(key)).split()])


def _box(collision: ET.Element) -> Box:
    name = str(collision.get("name"))
    rpy = _numbers(collision.find("origin"), "rpy")
    material = "carcass"
    if "handle" in name:
        material = "handle"
    elif name.endswith(("board_0", "_door")) or "closed" in name:
        material = "front"
    T_link_box = gtsam.Pose3(gtsam.Rot3.RzRyRx(*rpy), _numbers(collision.find("origin"), "xyz"))
    return Box(name, _numbers(collision.find("geometry/box"), "size"), T_link_box, material)


def _place_handle(boxes: list[Box], spec: ObjectSpec) -> list[Box]:
    """The part's boxes with the handle shifted by the spec's x and z."""
    shift = np.array([spec.handle_shift_m[0], 0.0, spec.handle_shift_m[1]])
    if spec.kind == "revolute":  # keep the bar on the door: shift only towards the hinge
        shift[0] = abs(shift[0]) * (1.0 if spec.hinge == "right" else -1.0)
    moved = []
    for box in boxes:
        T = box.T_link_box
        if box.material == "handle":
            T = gtsam.Pose3(T.rotation(), T.translation() + shift)
        moved.append(Box(box.name, box.size_m, T, box.material))
    return moved


def _write_textures(spec: ObjectSpec, folder: Path, rng: np.random.Generator) -> None:
    front = FRONT_TEXTURES[spec.front_texture](rng)
    textures: dict[str, Rgb] = {
        "front": rotated(front) if rng.random() < 0.5 else front,
        "carcass": FRONT_TEXTURES[spec.front_texture](rng),
        "handle": brushed_metal(rng),
    }
    for name, image in textures.items():
        cv2.imwrite(str(folder / f"{name}.png"), image[..., ::-1])


def _link(name: str, boxes: list[Box], mass_kg: float, folder: Path) -> ET.Element:
    link = ET.Element("link", name=name)
    com, inertia = inertia_of_boxes(boxes, mass_kg)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(com), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass_kg:.6f}")
    terms = {f"i{'xyz'[i]}{'xyz'[j]}": inertia[i, j] for i in range(3) for j in range(i, 3)}
    ET.SubElement(inertial, "inertia", {k: f"{v:.8f}" for k, v in terms.items()})
    for material in sorted({box.material for box in boxes}):
        mesh = folder / f"{name}_{material}.obj"
        chosen = [box for box in boxes if box.material == material]
        write_textured_boxes(mesh, chosen, f"{material}.png", split_m=0.2)
        geometry = ET.SubElement(ET.SubElement(link, "visual"), "geometry")
        ET.SubElement(geometry, "mesh", filename=mesh.name)
    for box in boxes:
        collision = ET.SubElement(link, "collision", name=box.name)
        rpy = _text(box.T_link_box.rotation().rpy())
        ET.SubElement(collision, "origin", xyz=_text(box.T_link_box.translation()), rpy=rpy)
        geometry = ET.SubElement(collision, "geometry")
        ET.SubElement(geometry, "box", size=_text(box.size_m))
    return link


def _joint(spec: ObjectSpec, joint: _Joint) -> ET.Element:
    element = ET.Element("joint", name=PART_JOINT, type=spec.kind)
    ET.SubElement(element, "parent", link="corpus")
    ET.SubElement(element, "child", link="part")
    ET.SubElement(element, "origin", xyz=_text(joint.origin), rpy="0 0 0")
    ET.SubElement(element, "axis", xyz=_text(joint.axis))
    ET.SubElement(
        element, "limit", lower="0", upper=f"{spec.upper:.6f}", effort="1000", velocity="10"
    )
    return element


def _text(numbers: FloatArray) -> str:
    return " ".join(f"{x:.9f}" for x in numbers)
