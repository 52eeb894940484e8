"""Descriptions as URDF, for PyBullet, pinocchio, MuJoCo and ROS."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from akm_fg.errors import InsufficientData
from akm_fg.export.description import Description, ExportedJoint, Link
from akm_fg.records import FloatArray
from factors.joint import JointKind

_TYPES = {JointKind.PRISMATIC: "prismatic", JointKind.REVOLUTE: "revolute"}
# URDF asks for both; nobody measured them, and they should not bind.
_EFFORT, _VELOCITY = "1000", "10"


def urdf(description: Description, meshes: str) -> bytes:
    """The file's text.

    Args:
        description: the object.
        meshes: folder of its meshes, from where the file lies.

    Raises:
        InsufficientData: a joint of a kind that URDF does not have.
    """
    robot = ET.Element("robot", name=description.name)
    mujoco = ET.SubElement(robot, "mujoco")
    # MuJoCo would drop what is only looked at, the folders of meshes, and the body that rests.
    ET.SubElement(mujoco, "compiler", discardvisual="false", strippath="false", fusestatic="false")
    _link(robot, description.static, meshes)
    for joint, link in description.parts:
        _link(robot, link, meshes)
        _joint(robot, joint, description.static.name, link.name)
    ET.indent(robot)
    return ET.tostring(robot, encoding="utf-8", xml_declaration=True) + b"\n"


def _link(robot: ET.Element, link: Link, meshes: str) -> None:
    body = ET.SubElement(robot, "link", name=link.name)
    inertial = ET.SubElement(body, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(link.mass.centre), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{link.mass.mass_kg:.6g}")
    xx, yy, zz = (f"{value:.6g}" for value in link.mass.inertia)
    ET.SubElement(inertial, "inertia", ixx=xx, iyy=yy, izz=zz, ixy="0", ixz="0", iyz="0")
    files = [f"{link.name}-hull-{i}.obj" for i in range(len(link.pieces))]
    for what, file in (("visual", f"{link.name}.obj"), *(("collision", name) for name in files)):
        shape = ET.SubElement(body, what)
        ET.SubElement(shape, "origin", xyz="0 0 0", rpy="0 0 0")
        geometry = ET.SubElement(shape, "geometry")
        ET.SubElement(geometry, "mesh", filename=f"{meshes}/{file}")


def _joint(robot: ET.Element, joint: ExportedJoint, parent: str, child: str) -> None:
    if joint.kind not in _TYPES:
        raise InsufficientData(
            f"{joint.name}: URDF has no {joint.kind} joint; --mjcf writes one as hinge and slide"
        )
    made = ET.SubElement(robot, "joint", name=joint.name, type=_TYPES[joint.kind])
    ET.SubElement(made, "origin", xyz=numbers(joint.origin_world), rpy="0 0 0")
    ET.SubElement(made, "parent", link=parent)
    ET.SubElement(made, "child", link=child)
    ET.SubElement(made, "axis", xyz=numbers(joint.axis_world))
    lower, upper = f"{joint.lower:.9g}", f"{joint.upper:.9g}"
    ET.SubElement(made, "limit", lower=lower, upper=upper, effort=_EFFORT, velocity=_VELOCITY)


def numbers(values: FloatArray) -> str:
    """To nine digits: a nanometre at a metre."""
    return " ".join(f"{value:.9g}" for value in values)
