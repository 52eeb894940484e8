"""Descriptions as MuJoCo's own format, which has colours, screws and contacts to leave out."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from akm_fg.export.description import Description, ExportedJoint, Link
from akm_fg.export.urdf import numbers
from factors.joint import JointKind

_LOOKS, _TOUCHES = "2", "3"  # groups: MuJoCo's viewer shows the first and hides the second


def mjcf(description: Description, meshes: str) -> bytes:
    """The file's text.

    A screw is a hinge and a slide about one axis that an equality holds together.

    Args:
        description: the object.
        meshes: folder of its meshes, from where the file lies.
    """
    root = ET.Element("mujoco", model=description.name)
    ET.SubElement(root, "compiler", angle="radian", meshdir=meshes, texturedir=meshes)
    asset, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    resting = _body(asset, world, description.static, "0 0 0")
    contact = ET.SubElement(root, "contact")
    beside = [description.static.name]
    for joint, link in description.parts:
        body = _body(asset, resting, link, numbers(joint.origin_world))
        _joint(root, body, joint)
        # Meshes of what touches in the closed state overlap by their errors.
        for other in beside:
            ET.SubElement(contact, "exclude", body1=other, body2=link.name)
        beside.append(link.name)
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _body(asset: ET.Element, parent: ET.Element, link: Link, pos: str) -> ET.Element:
    name = link.name
    ET.SubElement(asset, "texture", name=name, type="2d", file=f"{name}.png")
    ET.SubElement(asset, "material", name=name, texture=name)
    # What is only looked at need have no volume.
    ET.SubElement(asset, "mesh", name=name, file=f"{name}.obj", inertia="shell")
    body = ET.SubElement(parent, "body", name=name, pos=pos)
    mass = link.mass
    ET.SubElement(
        body,
        "inertial",
        pos=numbers(mass.centre),
        mass=f"{mass.mass_kg:.6g}",
        diaginertia=numbers(mass.inertia),
    )
    looks = ET.SubElement(body, "geom", type="mesh", mesh=name, material=name, group=_LOOKS)
    looks.attrib.update(contype="0", conaffinity="0")  # nothing touches it
    for i in range(len(link.pieces)):
        piece = f"{name}-hull-{i}"
        ET.SubElement(asset, "mesh", name=piece, file=f"{piece}.obj")
        ET.SubElement(body, "geom", type="mesh", mesh=piece, group=_TOUCHES)
    return body


def _joint(root: ET.Element, body: ET.Element, joint: ExportedJoint) -> None:
    axis, limits = numbers(joint.axis_world), f"{joint.lower:.9g} {joint.upper:.9g}"
    kind = "slide" if joint.kind == JointKind.PRISMATIC else "hinge"
    ET.SubElement(
        body, "joint", name=joint.name, type=kind, axis=axis, limited="true", range=limits
    )
    if not joint.kind.has_pitch:
        return
    along = f"{joint.name}-along"
    ET.SubElement(body, "joint", name=along, type="slide", axis=axis)
    held = root.find("equality")
    held = ET.SubElement(root, "equality") if held is None else held
    pitch = f"0 {joint.pitch_m_per_rad:.9g} 0 0 0"
    ET.SubElement(held, "joint", joint1=along, joint2=joint.name, polycoef=pitch)
