"""An object as robot descriptions have it: links with meshes, and the joints between them.

Joint positions are zero where the part is closed: q_exported = q - closed_state. The axis and its
line do not move with the state, so they are those of the posterior's joint. A link's frame has the
world's axes and lies at the joint's origin, the point of the axis nearest to the moving points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InsufficientData
from akm_fg.model.records import ModelPart
from akm_fg.records import FloatArray
from factors.joint import JointKind, Unit


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles with a colour for each corner."""

    points: FloatArray  # (V, 3) metres
    triangles: NDArray[np.int64]  # (F, 3)
    rgb: NDArray[np.uint8]  # (V, 3)

    def moved(self, by: FloatArray) -> Mesh:
        """Shifted by a vector (3,)."""
        return Mesh(self.points + by, self.triangles, self.rgb)


@dataclass(frozen=True, slots=True)
class Mass:
    """Of a link, in its frame; nominal."""

    mass_kg: float
    centre: FloatArray  # (3,)
    inertia: FloatArray  # (3,) about the centre along the frame's axes, kg m^2


@dataclass(frozen=True, slots=True)
class Link:
    """A body: what it looks like and what it touches with, in its own frame."""

    name: str
    visual: Mesh
    pieces: tuple[Mesh, ...]  # convex
    mass: Mass


@dataclass(frozen=True, slots=True)
class ExportedJoint:
    """A joint of an exported part."""

    name: str
    kind: JointKind
    origin_world: FloatArray  # (3,)
    axis_world: FloatArray  # (3,) unit
    lower: float  # from the closed state
    upper: float
    limits_met: bool  # False: the limits are the range that was seen
    pitch_m_per_rad: float

    @property
    def unit(self) -> Unit:
        """Of the state."""
        return self.kind.unit


@dataclass(frozen=True, slots=True)
class Description:
    """An object: the part that rests, whose frame is the world's, and those that move."""

    name: str
    static: Link
    parts: tuple[tuple[ExportedJoint, Link], ...]


def joint_of(part: ModelPart) -> ExportedJoint:
    """The joint of a part.

    Raises:
        InsufficientData: its kind is undecided, or no motion was seen.
    """
    if part.posterior.kind != part.joint.kind:
        raise InsufficientData(
            f"{part.name}: the kind of its joint is {part.posterior.kind}; "
            "expected a decided one for a description that others rely on"
        )
    lower, upper = part.range_seen()
    if not lower < upper:
        raise InsufficientData(f"{part.name}: its joint was seen in one state only")
    return ExportedJoint(
        f"{part.name}-joint",
        part.joint.kind,
        part.joint.joint.origin,
        part.joint.axis,
        lower - part.closed_state,
        upper - part.closed_state,
        part.limits is not None,
        part.joint.pitch_m_per_rad or 0.0,
    )
