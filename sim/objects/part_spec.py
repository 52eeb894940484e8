"""What the world knows of any object with moving parts: as asked for, and as built.

Object frame: x along the front (to the right as seen from before it), y into the object, z up,
origin on the floor under the middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import gtsam
import numpy as np

from akm_fg.records import FloatArray
from sim.objects.mechanisms import Catch, Closer

Hinge = Literal["left", "right", "top", "bottom"]  # where it is, as seen from before the front


class Mechanism(Protocol):
    """A part that opens, as far as physics goes."""

    @property
    def kind(self) -> Literal["prismatic", "revolute"]:
        """Of the joint."""

    @property
    def mass_kg(self) -> float:
        """Of the part."""

    @property
    def damping(self) -> float:
        """N s/m or N m s/rad."""

    @property
    def friction(self) -> float:
        """Coulomb, N or N m."""

    @property
    def upper(self) -> float:
        """End of the range, m or rad; it begins at 0, closed."""

    @property
    def handle_mu(self) -> float:
        """Sliding friction of the handle against rubber with mu 1."""

    @property
    def balanced(self) -> bool:
        """Springs or struts carry its weight."""

    @property
    def catch(self) -> Catch | None:
        """Holds it closed."""

    @property
    def closer(self) -> Closer | None:
        """Pulls it shut."""


class PartSpec(Mechanism, Protocol):
    """What the world needs to know of any object with one moving part."""

    @property
    def name(self) -> str:
        """What the object is called."""

    @property
    def seed(self) -> int:
        """Of what varies from one meeting to the next."""

    @property
    def hinge(self) -> Hinge | None:
        """Where the part turns; None where it slides."""

    @property
    def size_m(self) -> FloatArray:
        """(3,) width, depth, height."""

    @property
    def view_side(self) -> float:
        """+1 or -1: from where, along x, the opened front is seen best; 0: from both."""


@runtime_checkable
class SeveralParts(Protocol):
    """An object of which more than one part may open."""

    @property
    def more(self) -> Sequence[Mechanism]:
        """The parts after the first."""


def mechanisms(spec: PartSpec) -> tuple[Mechanism, ...]:
    """Every part of an object that opens, the first one first."""
    return (spec, *spec.more) if isinstance(spec, SeveralParts) else (spec,)


@dataclass(frozen=True, slots=True)
class BuiltObject:
    """An object's files and geometry, in its own frame."""

    spec: PartSpec
    urdf: Path
    axis_object: FloatArray  # (3,) unit; the part opens along it (right-hand rule)
    pivot_object: FloatArray  # (3,) a point of the joint axis
    T_object_handle: gtsam.Pose3  # closed; z the way the fingers approach, x along the bar
    p_object_front: FloatArray  # (3,) middle of the closed front
    handle_thickness_m: float  # between the fingers
    # (N, 3) of every place that looks as if one could pull there, closed: those of free parts
    # first, then those of locked fronts and decoys, NaN where such a front has none. For scoring.
    p_object_handles: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    # (M, 3) of the parts that open besides the first, in the spec's order.
    more_axes_object: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    more_pivots_object: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def view_low(self) -> bool:
        """Whether the front turns down: a camera sees it only from low."""
        return self.spec.hinge == "bottom"


def middle_of_front(points: FloatArray) -> FloatArray:
    """Middle (3,) of the front of a closed part, of its points (N, 3) in the object's frame."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2.0
    return np.array([middle[0], low[1], middle[2]])


def hinge_side(hinge: Hinge | None) -> float:
    """+1 or -1: the side, along x, where the hinge stands; 0 where it lies, or there is none."""
    return {"left": -1.0, "right": 1.0}.get(hinge or "", 0.0)


# The ranges over which every object is opened, whatever more it has: the paper's protocol.
STANDARD_OPENING = {"prismatic": 0.40, "revolute": float(np.deg2rad(40.0))}  # m, rad


def standard_range(spec: PartSpec) -> float:
    """End of the standardised range, m or rad: 0.40 m or 40 deg, or the joint's own end."""
    return min(STANDARD_OPENING[spec.kind], spec.upper)
