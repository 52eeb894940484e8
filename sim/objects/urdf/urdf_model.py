"""A URDF as the world needs it: a tree of links with shapes, and its joints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.records import FloatArray

MOVABLE = ("revolute", "prismatic", "continuous")
KINDS = (*MOVABLE, "fixed", "floating", "planar")


@dataclass(frozen=True, slots=True)
class Shape:
    """A visual or collision shape of a link."""

    name: str
    T_link_shape: gtsam.Pose3
    kind: Literal["mesh", "box", "cylinder", "sphere"]
    size: FloatArray  # (3,) box: sides, m; cylinder: radius, radius, length; mesh: its scale
    mesh: Path | None  # of a mesh; it exists unless it is a collision shape's
    rgb: tuple[float, float, float] | None  # 0..1, where the URDF says so


@dataclass(frozen=True, slots=True)
class Link:
    """One rigid body."""

    name: str
    visuals: tuple[Shape, ...]
    collisions: tuple[Shape, ...]
    mass_kg: float | None  # None where the URDF does not say, or says nonsense


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint in the file's own sign and units (m, rad)."""

    name: str
    kind: str  # one of KINDS
    parent: str
    child: str
    T_parent_joint: gtsam.Pose3
    axis: FloatArray  # (3,) unit, in the joint's frame
    lower: float  # the smaller limit; of a continuous joint, minus infinity
    upper: float
    friction: float | None  # Coulomb, N or N m, where the URDF says so
    damping: float | None  # N s/m or N m s/rad

    def T_joint_child(self, state: float) -> gtsam.Pose3:
        """How the child stands at `state`, m or rad."""
        if self.kind == "prismatic":
            return gtsam.Pose3(gtsam.Rot3(), self.axis * state)
        if self.kind in ("revolute", "continuous"):
            return gtsam.Pose3(gtsam.Rot3.Rodrigues(self.axis * state), np.zeros(3))
        return gtsam.Pose3()


@dataclass(frozen=True, slots=True)
class UrdfModel:
    """A tree of links; `joints` are in the order of the file."""

    path: Path
    root: str
    links: dict[str, Link]
    joints: tuple[Joint, ...]
    notes: tuple[str, ...] = ()  # what is probably not meant as it is written; names no folder

    def movable(self) -> tuple[Joint, ...]:
        """Joints that can be freed."""
        return tuple(joint for joint in self.joints if joint.kind in MOVABLE)

    def joint(self, name: str | None) -> Joint:
        """The movable joint called `name`; the only one there is, for None.

        Raises:
            InputError: no such joint, or several and none named.
        """
        there = self.movable()
        listed = ", ".join(joint.name for joint in there)
        if not there:
            raise InputError(self.path, "has no joint that moves", f"one of {', '.join(MOVABLE)}")
        if name is None and len(there) == 1:
            return there[0]
        if name is None:
            raise InputError(self.path, "several joints move", f"one named by --joint: {listed}")
        for joint in there:
            if joint.name == name:
                return joint
        raise InputError(self.path, f"no joint {name!r} that moves", f"one of {listed}")

    def below(self, joint: Joint) -> set[str]:
        """Names of the links that move with the joint."""
        moved = {joint.child}
        for other in self._from_root():
            if other.parent in moved:
                moved.add(other.child)
        return moved

    def T_root_links(self, states: dict[str, float]) -> dict[str, gtsam.Pose3]:
        """Where each link stands; joints not in `states` are at 0."""
        poses = {self.root: gtsam.Pose3()}
        for joint in self._from_root():
            T = joint.T_parent_joint * joint.T_joint_child(states.get(joint.name, 0.0))
            poses[joint.child] = poses[joint.parent] * T
        return poses

    def _from_root(self) -> list[Joint]:
        """The joints, parents before children."""
        ordered: list[Joint] = []
        known = {self.root}
        while len(ordered) < len(self.joints):
            ready = [j for j in self.joints if j.parent in known and j.child not in known]
            assert ready  # `_check_tree` has seen to it
            ordered += ready
            known |= {joint.child for joint in ready}
        return ordered
