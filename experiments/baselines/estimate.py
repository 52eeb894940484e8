"""What a baseline or a peer says about a joint: point estimates, no covariance.

Frames, signs and the pivot follow docs/conventions.md, so that every method is scored alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factors.joint import JointKind

Array = NDArray[np.float64]
KINDS = tuple(kind for kind in JointKind if not kind.has_pitch)  # the paper knows no screws


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """One joint and its states, as a method without uncertainties gives them."""

    kind: JointKind  # prismatic or revolute
    axis: Array  # (3,) unit, world; the states grow along it (their mean is not negative)
    pivot: Array | None  # (3,) world, the point of the axis nearest to the part; None: prismatic
    states: Array  # (T,) metres or radians, zero at the first; NaN where nothing was seen
    losses: Mapping[str, float]  # final loss by name, as its method defines it
    time_s: Mapping[str, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", JointKind(self.kind))
        if self.kind not in KINDS:
            raise ValueError(f"joint kind {self.kind}, expected one of {[*map(str, KINDS)]}")
        if self.axis.shape != (3,) or abs(np.linalg.norm(self.axis) - 1) > 1e-6:
            raise ValueError(f"axis {self.axis}, expected a unit vector (3,)")
        if (self.pivot is None) == self.kind.turns:
            raise ValueError(f"pivot {self.pivot} of a {self.kind} joint")
        if self.states.ndim != 1 or self.states[:1].any():
            raise ValueError("states must be (T,) and zero at the first frame")


def joint_estimate(
    kind: JointKind,
    axis: Array,
    point_on_axis: Array,
    states: Array,
    part_centroid: Array,
    losses: Mapping[str, float],
    time_s: Mapping[str, float],
) -> JointEstimate:
    """An estimate in the project's conventions from any axis, point of it and states.

    Args:
        kind: prismatic or revolute.
        axis: (3,) of any length and either sign, world.
        point_on_axis: (3,) any point of a hinge's axis; ignored for a prismatic joint.
        states: (T,) relative to any zero.
        part_centroid: (3,) of the moving points; the pivot is the axis point nearest to it.
        losses: final loss by name.
        time_s: seconds by stage.

    Raises:
        ValueError: an axis without direction, or an unknown kind.
    """
    kind, length = JointKind(kind), float(np.linalg.norm(axis))
    if not length > 0:
        raise ValueError(f"axis {axis} has no direction")
    unit = np.asarray(axis, dtype=np.float64) / length
    relative = np.asarray(states, dtype=np.float64) - states[0]
    sign = -1.0 if np.nanmean(relative) < 0 else 1.0
    pivot = point_on_axis + unit * (unit @ (part_centroid - point_on_axis))
    return JointEstimate(
        kind=kind,
        axis=sign * unit,
        pivot=pivot if kind.turns else None,
        states=sign * relative,
        losses=dict(losses),
        time_s=dict(time_s),
    )
