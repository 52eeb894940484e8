"""The URDF of an object of boxes with its joints, its meshes beside it."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from akm_fg.records import FloatArray
from sim.objects.meshes import Box, inertia_of_boxes, write_textured_boxes

PART_JOINT, PART_LINK = "part_joint", "part"  # of the first; others have their numbers after
OBJECT_URDF = "object.urdf"  # the whole, in an object's folder
CORPUS_KG = 25.0  # stands fixed: its mass plays no part
INERTIA_MIN = 1e-5  # kg m^2, of the smallest parts: keeps the solver sound


def part_joint(number: int) -> str:
    """The joint of a part that opens, the first being 0."""
    return f"{PART_JOINT}_{number}" if number else PART_JOINT


class MovingSpec(Protocol):
    """What is written of a part and its joint."""

    @property
    def kind(self) -> str:
        """Prismatic or revolute."""

    @property
    def mass_kg(self) -> float:
        """Of the part."""

    @property
    def upper(self) -> float:
        """End of the range, m or rad."""


class JointSpec(MovingSpec, Protocol):
    """The same of an object's first part."""

    @property
    def name(self) -> str:
        """Of the object."""


@dataclass(frozen=True, slots=True)
class MovingBoxes:
    """A part that opens besides the first."""

    spec: MovingSpec
    boxes: Sequence[Box]  # in its own frame
    origin: FloatArray  # (3,) of that frame in the object frame
    axis: FloatArray  # (3,)


def write_urdf(
    spec: JointSpec,
    corpus: list[Box],
    part: list[Box],
    origin: FloatArray,
    axis: FloatArray,
    folder: Path,
    one_grain: bool = False,
    more: Sequence[MovingBoxes] = (),
) -> Path:
    """Writes `object.urdf` and one mesh for each link and material into `folder`.

    Beside it go `corpus.urdf`, the looks of the corpus alone, and `moving.urdf`, the whole with a
    corpus that is not seen: a camera that stands still draws the corpus once.

    Args:
        spec: the part and its joint.
        corpus: boxes in the object frame; a texture MATERIAL.png is expected for each material.
        part: boxes in the part's frame.
        origin: (3,) of the part's frame in the object frame.
        axis: (3,) of the joint.
        folder: where to.
        one_grain: the part's textures go on where the corpus' end, so that its front cannot be
            told from others; else they begin anew with the part's frame.
        more: parts that open besides this one.
    """
    still = _link("corpus", corpus, CORPUS_KG, folder)
    grain = origin if one_grain else np.zeros(3)
    moving = _link(PART_LINK, part, spec.mass_kg, folder, grain)
    elements = [moving, joint_element(spec, origin, axis)]
    for number, other in enumerate(more, start=1):
        grain = other.origin if one_grain else np.zeros(3)
        link = f"{PART_LINK}_{number}"
        elements.append(_link(link, other.boxes, other.spec.mass_kg, folder, grain))
        elements.append(joint_element(other.spec, other.origin, other.axis, number))
    return write_object(spec.name, still, elements, folder)


def write_object(name: str, still: ET.Element, moving: Sequence[ET.Element], folder: Path) -> Path:
    """Writes `object.urdf`, `corpus.urdf` and `moving.urdf` of a corpus, and parts and joints."""
    _write(folder / "corpus.urdf", name, [_looks(still)])
    _write(folder / "moving.urdf", name, [_unseen(still), *moving])
    return _write(folder / OBJECT_URDF, name, [still, *moving])


def _write(path: Path, name: str, elements: list[ET.Element]) -> Path:
    robot = ET.Element("robot", name=name)
    robot.extend(copy.deepcopy(elements))
    ET.indent(robot)  # PyBullet cannot read long lines
    ET.ElementTree(robot).write(path)
    return path


def _looks(link: ET.Element) -> ET.Element:
    """The link without what is touched, which takes as long to load; all of it if none is seen."""
    looks = copy.deepcopy(link)
    if looks.find("visual") is not None:
        for collision in looks.findall("collision"):
            looks.remove(collision)
    return looks


def _unseen(link: ET.Element) -> ET.Element:
    """The link with a speck for its looks; without any, PyBullet draws its collision shapes."""
    unseen = copy.deepcopy(link)
    for visual in unseen.findall("visual"):
        unseen.remove(visual)
    visual = ET.SubElement(unseen, "visual")
    ET.SubElement(visual, "origin", xyz="0 0 0.1", rpy="0 0 0")
    ET.SubElement(ET.SubElement(visual, "geometry"), "box", size="0.0001 0.0001 0.0001")
    return unseen


def _link(
    name: str,
    boxes: Sequence[Box],
    mass_kg: float,
    folder: Path,
    p_grain: FloatArray | None = None,
) -> ET.Element:
    link = ET.Element("link", name=name)
    link.append(inertial_element(mass_kg, *inertia_of_boxes(boxes, mass_kg)))
    for material in sorted({box.material for box in boxes}):
        mesh = folder / f"{name}_{material}.obj"
        chosen = [box for box in boxes if box.material == material]
        write_textured_boxes(mesh, chosen, f"{material}.png", split_m=0.2, p_grain=p_grain)
        geometry = ET.SubElement(ET.SubElement(link, "visual"), "geometry")
        ET.SubElement(geometry, "mesh", filename=mesh.name)
    for box in boxes:
        collision = ET.SubElement(link, "collision", name=box.name)
        rpy = _text(box.T_link_box.rotation().rpy())
        ET.SubElement(collision, "origin", xyz=_text(box.T_link_box.translation()), rpy=rpy)
        geometry = ET.SubElement(collision, "geometry")
        if box.rounded:
            radius, length = f"{box.size_m[0] / 2.0:.9f}", f"{box.size_m[2]:.9f}"
            ET.SubElement(geometry, "cylinder", radius=radius, length=length)
        else:
            ET.SubElement(geometry, "box", size=_text(box.size_m))
    return link


def inertial_element(mass_kg: float, com: FloatArray, inertia: FloatArray) -> ET.Element:
    """Mass, its centre (3,) and the inertia (3, 3) about it, kg m^2, in the link's frame."""
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", xyz=_text(com), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass_kg:.6f}")
    terms = {f"i{'xyz'[i]}{'xyz'[j]}": inertia[i, j] for i in range(3) for j in range(i, 3)}
    ET.SubElement(inertial, "inertia", {k: f"{v:.8f}" for k, v in terms.items()})
    return inertial


def joint_element(
    spec: MovingSpec, origin: FloatArray, axis: FloatArray, number: int = 0
) -> ET.Element:
    """The joint between corpus and a part: origin (3,) and axis (3,) in the object frame."""
    element = ET.Element("joint", name=part_joint(number), type=spec.kind)
    child = f"{PART_LINK}_{number}" if number else PART_LINK
    ET.SubElement(element, "parent", link="corpus")
    ET.SubElement(element, "child", link=child)
    ET.SubElement(element, "origin", xyz=_text(origin), rpy="0 0 0")
    ET.SubElement(element, "axis", xyz=_text(axis))
    ET.SubElement(
        element, "limit", lower="0", upper=f"{spec.upper:.6f}", effort="1000", velocity="10"
    )
    return element


def _text(numbers: FloatArray) -> str:
    return " ".join(f"{x:.9f}" for x in numbers)
