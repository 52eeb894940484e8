"""Reads URDF files.

What cannot be read is said in one line that names the file (`InputError`). What can be read, but
is probably not meant so, is a note of the model: a mesh that is missing, a shape without size, a
joint without axis, limits that look like degrees, a joint that should follow another.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.records import FloatArray
from sim.objects.urdf.mesh_paths import mesh_path, shown_mesh
from sim.objects.urdf.urdf_model import KINDS, MOVABLE, Joint, Link, Shape, UrdfModel

FULL_TURN_RAD = 2.0 * math.pi + 0.01  # a hinge's limit beyond it is hardly meant in radians


def read_urdf(path: Path, allowed: Path | None = None) -> UrdfModel:
    """Reads and checks a URDF file.

    Args:
        path: of the file.
        allowed: a folder outside of its own, from which it may name meshes.

    Raises:
        InputError: it is not there, not XML, a xacro file, not a tree of links, or names a mesh
            that lies elsewhere.
    """
    if not path.is_file():
        raise InputError(path, "no such file", "a URDF file")
    try:
        robot = ET.parse(path).getroot()
    except (ET.ParseError, LookupError, ValueError, OSError) as error:  # also of its encoding
        raise InputError(path, f"is not XML ({error})", "a URDF file") from error
    if robot.tag != "robot":
        raise InputError(path, f"its root is <{robot.tag}>", "<robot>, as a URDF has")
    if any(
        "xacro" in element.tag.partition("}")[0] for element in robot.iter() if "}" in element.tag
    ):
        raise InputError(path, "is a xacro file", "a URDF: run `xacro FILE > object.urdf` first")
    reader = _Reader(path, robot, allowed)
    links = {link.name: link for link in map(reader.link, robot.findall("link"))}
    if not links:
        raise InputError(path, "has no links", "at least two, with a joint between them")
    joints = tuple(reader.joint(element) for element in robot.findall("joint"))
    root = _check_tree(path, links, joints)
    return UrdfModel(path, root, links, joints, tuple(dict.fromkeys(reader.notes)))


def _check_tree(path: Path, links: dict[str, Link], joints: Sequence[Joint]) -> str:
    """The root link."""
    n_parents = Counter(joint.child for joint in joints)
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                wrong = f"joint {joint.name!r} names a link {end!r} that is not there"
                raise InputError(path, wrong, f"one of {', '.join(links)}")
    twice = sorted(child for child, count in n_parents.items() if count > 1)
    if twice:
        raise InputError(path, f"link {twice[0]!r} hangs on several joints", "a tree of links")
    roots = [name for name in links if name not in n_parents]
    if not roots:
        raise InputError(path, "its joints form a loop", "a tree of links with one root")
    reached, grown = set(roots[:1]), True
    while grown:
        more = {joint.child for joint in joints if joint.parent in reached} - reached
        reached, grown = reached | more, bool(more)
    if len(roots) == 1 and len(reached) < len(links):
        raise InputError(path, "its joints form a loop", "a tree of links with one root")
    if len(roots) > 1:
        wrong = f"links {', '.join(roots)} have no parent"
        raise InputError(path, wrong, "a tree of links with one root")
    return roots[0]


class _Reader:
    """Elements of one file into records."""

    def __init__(self, path: Path, robot: ET.Element, allowed: Path | None = None) -> None:
        self._path, self._allowed = path, allowed
        self._meshes: dict[str, Path] = {}  # by name; what is seen is mostly touched too
        self.notes: list[str] = []  # what is probably not meant as it is written
        self._colours = {
            str(material.get("name")): rgb
            for material in robot.iter("material")
            if (rgb := self._rgb(material)) is not None
        }

    def link(self, element: ET.Element) -> Link:
        name = self._name(element)
        mass = element.find("inertial/mass")
        mass_kg = None if mass is None else self._number(mass, "value", 0.0, name)
        return Link(
            name,
            self._shapes(element, "visual", name),
            self._shapes(element, "collision", name),
            mass_kg if mass_kg is not None and mass_kg > 0.0 else None,
        )

    def joint(self, element: ET.Element) -> Joint:
        name, kind = self._name(element), str(element.get("type"))
        if kind not in KINDS:
            wrong = f"joint {name!r} is of type {kind!r}"
            raise InputError(self._path, wrong, f"one of {', '.join(KINDS)}")
        ends = [element.find(end) for end in ("parent", "child")]
        if any(end is None for end in ends):
            raise InputError(self._path, f"joint {name!r} lacks a parent or a child", "both")
        axis = self._axis(element, name)
        lower, upper = self._limits(element, name, kind)
        if kind in MOVABLE and upper - lower < 1e-6:
            kind = "fixed"  # as URDF means limits that are not given
        dynamics = element.find("dynamics")
        friction, damping = (
            None if dynamics is None else self._number(dynamics, key, None, name)
            for key in ("friction", "damping")
        )
        parent, child = (str(end.get("link")) for end in ends if end is not None)
        T = self._origin(element, name)
        self._note_joint(element, name, kind, max(abs(lower), abs(upper)))
        return Joint(name, kind, parent, child, T, axis, lower, upper, friction, damping)

    def _note_joint(self, element: ET.Element, name: str, kind: str, limit: float) -> None:
        """What of a joint that moves is probably meant otherwise."""
        if kind not in MOVABLE:
            return
        axis, mimic = element.find("axis"), element.find("mimic")
        if axis is None or axis.get("xyz") is None:
            self.notes.append(f"joint {name!r} names no axis; it is x then, as URDF has it")
        if kind == "revolute" and limit > FULL_TURN_RAD:
            told = f"joint {name!r} has limits of up to {limit:g} rad, more than a turn"
            self.notes.append(f"{told}: probably degrees; write radians")
        if mimic is not None:
            told = f"joint {name!r} should follow {mimic.get('joint')!r} (mimic)"
            self.notes.append(f"{told}; here one joint moves, and all others are fixed, closed")

    def _limits(self, element: ET.Element, name: str, kind: str) -> tuple[float, float]:
        """Both, sorted: files with the larger one as `lower` are common."""
        if kind == "continuous":
            return -math.inf, math.inf
        limit = element.find("limit")
        if kind not in MOVABLE:
            return 0.0, 0.0
        if limit is None:
            raise InputError(self._path, f"joint {name!r} has no <limit>", "lower and upper")
        ends = [self._number(limit, key, 0.0, name) for key in ("lower", "upper")]
        low, high = sorted(end for end in ends if end is not None)
        return low, high

    def _axis(self, element: ET.Element, name: str) -> FloatArray:
        given = element.find("axis")
        if given is None or given.get("xyz") is None:
            return np.array([1.0, 0, 0])
        axis = self._numbers(given, "xyz", name)
        largest = float(np.abs(axis).max())
        if largest < 1e-9:
            if element.get("type") in MOVABLE:
                raise InputError(self._path, f"joint {name!r} has a zero axis", "a direction")
            return np.array([1.0, 0, 0])
        direction = axis / largest  # whose square is a number, too
        return np.asarray(direction / np.linalg.norm(direction))

    def _shapes(self, element: ET.Element, tag: str, link: str) -> tuple[Shape, ...]:
        """Of a link; what has no size, and a visual mesh that is not there, is left out."""
        shapes = [self._shape(found, link) for found in element.findall(tag)]
        kept = []
        for shape in shapes:
            if shape.mesh is None and not shape.size.all():
                told = f"link {link!r} has a {shape.kind} without size"
            elif tag == "visual" and shape.mesh is not None and not shape.mesh.is_file():
                told = f"mesh {shown_mesh(shape.mesh, self._path)!r} of link {link!r} is missing"
            else:
                kept.append(shape)
                continue
            self.notes.append(f"{told}; left out")
        return tuple(kept)

    def _shape(self, element: ET.Element, link: str) -> Shape:
        T = self._origin(element, link)
        name, rgb = str(element.get("name", "")), None
        material = element.find("material")
        if material is not None:
            rgb = self._rgb(material) or self._colours.get(str(material.get("name")))
        mesh = element.find("geometry/mesh")
        if mesh is not None:
            scale = np.ones(3)
            if mesh.get("scale"):
                scale = self._numbers(mesh, "scale", link, sizes=(1, 3)) * scale
            file = self._mesh(str(mesh.get("filename")))
            return Shape(name, T, "mesh", scale, file, rgb)
        for kind, keys in (("cylinder", "radius radius length"), ("sphere", "radius " * 3)):
            found = element.find(f"geometry/{kind}")
            if found is not None:
                size = [self._number(found, key, None, link) or 0.0 for key in keys.split()]
                return Shape(name, T, kind, self._sound(np.array(size), link), None, rgb)  # type: ignore[arg-type]
        box = element.find("geometry/box")
        if box is None:
            wrong = f"link {link!r} has a shape that is not known"
            raise InputError(self._path, wrong, "mesh, box, cylinder or sphere")
        size_m = self._sound(self._numbers(box, "size", link), link)
        return Shape(name, T, "box", size_m, None, rgb)

    def _mesh(self, name: str) -> Path:
        if name not in self._meshes:
            self._meshes[name] = mesh_path(self._path, name, self._allowed)
        return self._meshes[name]

    def _sound(self, size: FloatArray, link: str) -> FloatArray:
        if not (size >= 0.0).all():
            wrong = f"link {link!r} has a shape of negative size"
            raise InputError(self._path, wrong, "sizes above 0")
        return size

    def _origin(self, element: ET.Element, owner: str) -> gtsam.Pose3:
        origin = element.find("origin")
        if origin is None:
            return gtsam.Pose3()
        xyz, rpy = (
            self._numbers(origin, key, owner) if origin.get(key) else np.zeros(3)
            for key in ("xyz", "rpy")
        )
        return gtsam.Pose3(gtsam.Rot3.RzRyRx(*rpy.tolist()), xyz)

    def _rgb(self, material: ET.Element) -> tuple[float, float, float] | None:
        colour = material.find("color")
        if colour is None:
            return None
        r, g, b = self._numbers(colour, "rgba", "material", sizes=(3, 4))[:3].tolist()
        return r, g, b

    def _name(self, element: ET.Element) -> str:
        name = element.get("name")
        if not name:
            raise InputError(self._path, f"a <{element.tag}> has no name", "a name")
        return name

    def _number(
        self, element: ET.Element, key: str, default: float | None, owner: str
    ) -> float | None:
        if element.get(key) is None:
            return default
        return float(self._numbers(element, key, owner, sizes=(1,))[0])

    def _numbers(
        self, element: ET.Element, key: str, owner: str, sizes: tuple[int, ...] = (3,)
    ) -> FloatArray:
        text = str(element.get(key))
        try:
            numbers = np.array([float(word) for word in text.split()])
        except ValueError:
            numbers = np.zeros(0)
        if len(numbers) not in sizes or not np.isfinite(numbers).all():
            count = " or ".join(map(str, sizes))
            wrong = f"{owner!r}: <{element.tag} {key}={text!r}>"
            raise InputError(self._path, wrong, f"{count} finite number{'s'[: max(sizes) > 1]}")
        return numbers
