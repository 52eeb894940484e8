"""The arm as pinocchio reads it from its description: joints, links, meshes.

What does not fit is refused here, in one line, so that everything built on it may rely on the
order of joints and links.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from akm_fg.arm.body.description import ArmDescription
from akm_fg.errors import InputError

N_ARM = 7
FINGER_JOINTS = ("panda_finger_joint1", "panda_finger_joint2")
JOINTS = (*(f"panda_joint{i}" for i in range(1, N_ARM + 1)), *FINGER_JOINTS)
HAND = "panda_hand"
FINGERS = ("panda_leftfinger", "panda_rightfinger")
ARM_LINKS = tuple(f"panda_link{i}" for i in range(8))
ROBOT_LINKS = (*ARM_LINKS, HAND, *FINGERS)


def read_model(description: ArmDescription) -> pin.Model:
    """The joints and frames; a configuration is the arm's 7 angles, then the fingers' 2 travels.

    Raises:
        InputError: the URDF cannot be read, or is not that of a Franka with its hand.
    """
    urdf, wanted = description.urdf, "a URDF of the Franka with its hand"
    _check_is_urdf(urdf, wanted)
    try:
        model = pin.buildModelFromUrdf(str(urdf))
    except ValueError as error:
        raise InputError(urdf, _one_line(error), wanted) from error
    joints = tuple(model.names)[1:]  # the first is the universe
    if joints != JOINTS:
        raise InputError(urdf, f"its joints are {', '.join(joints) or 'none'}", ", ".join(JOINTS))
    for frame in (*ROBOT_LINKS, description.gripper_frame):
        if not model.existFrame(frame):
            raise InputError(urdf, f"no link {frame}", wanted)
    return model


def read_meshes(description: ArmDescription, model: pin.Model) -> pin.GeometryModel:
    """The collision meshes, one of each link, in the order of ROBOT_LINKS.

    Raises:
        InputError: a mesh cannot be read, or a link has none or several.
    """
    meshes = _geometry(description, model, pin.GeometryType.COLLISION)
    links = [model.frames[shape.parentFrame].name for shape in meshes.geometryObjects]
    if tuple(links) != ROBOT_LINKS:
        raise InputError(
            description.urdf,
            f"its collision shapes belong to {', '.join(links) or 'nothing'}",
            f"one for each of {', '.join(ROBOT_LINKS)}",
        )
    return meshes


def read_drawn_meshes(description: ArmDescription, model: pin.Model) -> pin.GeometryModel:
    """The meshes the robot is drawn by, of all links that have some.

    Raises:
        InputError: a mesh cannot be read, or there is none.
    """
    meshes = _geometry(description, model, pin.GeometryType.VISUAL)
    if not len(meshes.geometryObjects):
        raise InputError(description.urdf, "it has no visual shapes", "meshes")
    return meshes


def _geometry(
    description: ArmDescription, model: pin.Model, kind: pin.GeometryType
) -> pin.GeometryModel:
    urdf, folders = description.urdf, [str(folder) for folder in description.folders]
    try:
        meshes = pin.buildGeomFromUrdf(model, str(urdf), kind, package_dirs=folders)
    except (ValueError, RuntimeError) as error:
        raise InputError(urdf, _one_line(error), f"its meshes in {' or '.join(folders)}") from error
    for shape in meshes.geometryObjects:
        if not hasattr(shape.geometry, "vertices"):
            raise InputError(urdf, f"the shape of {shape.name} is no mesh", "meshes")
    return meshes


def _check_is_urdf(urdf: Path, wanted: str) -> None:
    """Before pinocchio, whose parser writes on standard error what it dislikes."""
    try:
        root = ElementTree.parse(urdf).getroot()
    except OSError as error:
        raise InputError(urdf, error.strerror or "cannot be read", wanted) from error
    except ElementTree.ParseError as error:
        raise InputError(urdf, f"not XML ({error})", wanted) from error
    if root.tag != "robot":
        raise InputError(urdf, f"its root is <{root.tag}>", wanted)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
