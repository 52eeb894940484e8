"""Reads URDF files.

What is wrong is said in one line that names the file (`InputError`). Mesh files are looked up
here, so that one that is missing is found before anything is built.
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
from sim.objects.urdf.urdf_model import KINDS, MOVABLE, Joint, Link, Shape, UrdfModel

SHOWN = 60  # characters of a name that no file can have


def read_urdf(path: Path) -> UrdfModel:
    """Reads and checks a URDF file.

    Raises:
        InputError: it is not there, not XML, not a tree of links, or misses a mesh.
    """
    if not path.is_file():
        raise InputError(path, "no such file", "a URDF file")
    try:
        robot = ET.parse(path).getroot()
    except (ET.ParseError, LookupError, ValueError, OSError) as error:  # also of its encoding
        raise InputError(path, f"is not XML ({error})", "a URDF file") from error
    if robot.tag != "robot":
        raise InputError(path, f"its root is <{robot.tag}>", "<robot>, as a URDF has")
    reader = _Reader(path, robot)
    links = {link.name: link for link in map(reader.link, robot.findall("link"))}
    if not links:
        raise InputError(path, "has no links", "at least two, with a joint between them")
    joints = tuple(reader.joint(element) for element in robot.findall("joint"))
    return UrdfModel(path, _check_tree(path, links, joints), links, joints)


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

    def __init__(self, path: Path, robot: ET.Element) -> None:
        self._path = path
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
            tuple(self._shape(v, name, seen=True) for v in element.findall("visual")),
            tuple(self._shape(c, name, seen=False) for c in element.findall("collision")),
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
        return Joint(name, kind, parent, child, T, axis, lower, upper, friction, damping)

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
        axis = np.array([1.0, 0, 0]) if given is None else self._numbers(given, "xyz", name)
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            if element.get("type") in MOVABLE:
                raise InputError(self._path, f"joint {name!r} has a zero axis", "a direction")
            return np.array([1.0, 0, 0])
        return axis / length

    def _shape(self, element: ET.Element, link: str, seen: bool) -> Shape:
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
            file = self._find(str(mesh.get("filename")), required=seen)
            return Shape(name, T, "mesh", scale, file, rgb)
        for kind, keys in (("cylinder", "radius radius length"), ("sphere", "radius " * 3)):
            found = element.find(f"geometry/{kind}")
            if found is not None:
                size = [self._number(found, key, None, link) or 0.0 for key in keys.split()]
                return Shape(name, T, kind, self._positive(np.array(size), link), None, rgb)  # type: ignore[arg-type]
        box = element.find("geometry/box")
        if box is None:
            wrong = f"link {link!r} has a shape that is not known"
            raise InputError(self._path, wrong, "mesh, box, cylinder or sphere")
        size_m = self._positive(self._numbers(box, "size", link), link)
        return Shape(name, T, "box", size_m, None, rgb)

    def _find(self, filename: str, required: bool) -> Path:
        """The mesh file: beside the URDF, or, for package://, somewhere above it."""
        relative = filename.removeprefix("file://")
        places = [self._path.parent / relative]
        if filename.startswith("package://"):
            inside = filename.removeprefix("package://")
            after = inside.partition("/")[2]
            places = [
                folder / way
                for folder in (self._path.parent, *self._path.resolve().parents)
                for way in (inside, after)
            ]
        for place in places:
            try:
                if place.is_file():
                    return place
            except OSError as error:
                wrong = f"mesh {filename[:SHOWN]} cannot be looked for ({error.strerror})"
                raise InputError(self._path, wrong, "the name of a file") from error
        if required:
            raise InputError(self._path, f"mesh {filename} is missing", f"it at {places[0]}")
        return places[0]

    def _positive(self, size: FloatArray, link: str) -> FloatArray:
        if not (size > 0.0).all():
            raise InputError(self._path, f"link {link!r} has a shape without size", "sizes above 0")
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
