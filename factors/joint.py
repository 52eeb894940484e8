"""One joint: kind, frame, pitch, and where it takes the points of the moving part.

The part moves by ``T_world_joint * Exp(q S) * T_world_joint^-1`` with a unit twist S in the joint
frame, whose z axis is the joint axis: rotation about z (revolute), translation along z
(prismatic), or both, `pitch` metres along for every radian about (helical). Frames and tangent
order: docs/conventions.md (GTSAM order: rotation first, increment on the right).

Everything here works on *reference coordinates*: the joint-frame coordinates, at state zero, of
an observed point,

    z = Exp(-q S) T_world_joint^-1 p_world.

A point of the part has the same z in every frame, so z minus the point's latent reference is the
residual. With ``G(z) = [ [z]x | -I ]``, the derivative of a point's coordinates under a twist of
the frame, the chain rule gives (Lynch and Park, Modern Robotics, 2017, sec. 3.3 and 5.1)

    d z / d xi = G(z) Ad(Exp(-q S)),      d z / d q = G(z) S,      d z / d pitch = q G(z) e_vz,

for a right increment xi of T_world_joint; e_vz is the unit translation along z.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Unit = Literal["m", "rad"]


@dataclass(frozen=True, slots=True)
class KindRow:
    """What tells one kind of joint from another."""

    turns: bool  # about z
    slides: bool  # along z by its state; what turns and has a pitch slides by that
    has_pitch: bool  # a variable of its own: metres along z for every radian
    unit: Unit  # of its state
    gauge: tuple[str, ...]  # tangent directions of T_world_joint that no measurement can fix


class JointKind(StrEnum):
    """The kinds of joints that move. Each is its name: `JointKind("revolute")`."""

    PRISMATIC = "prismatic"
    REVOLUTE = "revolute"
    HELICAL = "helical"

    @classmethod
    def _missing_(cls, value: object) -> None:
        raise ValueError(f"joint kind {value!r}, expected one of {sorted(map(str, cls))}")

    @property
    def row(self) -> KindRow:
        """What it is."""
        return KINDS[self]

    @property
    def turns(self) -> bool:
        """Whether the part turns about an axis line."""
        return KINDS[self].turns

    @property
    def has_pitch(self) -> bool:
        """Whether the part slides along the axis that it turns about, by a pitch to be found."""
        return KINDS[self].has_pitch

    @property
    def unit(self) -> Unit:
        """Of the state."""
        return KINDS[self].unit

    @property
    def gauge(self) -> tuple[str, ...]:
        """Tangent directions of T_world_joint that no measurement can fix."""
        return KINDS[self].gauge

    @property
    def observable(self) -> tuple[int, ...]:
        """Tangent indices of T_world_joint that measurements can fix."""
        return tuple(i for i, name in enumerate(TANGENT) if name not in KINDS[self].gauge)

    @property
    def coordinates(self) -> int:
        """How many numbers make a joint of this kind: its observable directions and its pitch."""
        return len(TANGENT) - len(KINDS[self].gauge) + KINDS[self].has_pitch


TANGENT = ("wx", "wy", "wz", "vx", "vy", "vz")
_ABOUT_A_LINE = ("wz", "vz")
_ALONG_A_DIRECTION = ("wz", "vx", "vy", "vz")
KINDS: dict[JointKind, KindRow] = {
    JointKind.PRISMATIC: KindRow(False, True, False, "m", _ALONG_A_DIRECTION),
    JointKind.REVOLUTE: KindRow(True, False, False, "rad", _ABOUT_A_LINE),
    JointKind.HELICAL: KindRow(True, False, True, "rad", _ABOUT_A_LINE),
}


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint of one kind, in place.

    Raises:
        ValueError: an unknown kind, or a pitch of a joint that has none.
    """

    kind: JointKind
    T_world_joint: Array  # (4, 4); z is the axis
    pitch: float  # metres along z for every radian; 0 of a kind that has none

    def __post_init__(self) -> None:
        if type(self.kind) is not JointKind:
            object.__setattr__(self, "kind", JointKind(self.kind))
        if self.pitch and not self.kind.has_pitch:
            raise ValueError(f"pitch {self.pitch} m/rad of a {self.kind} joint, expected 0")

    @property
    def axis(self) -> Array:
        """(3,) unit, world."""
        return self.T_world_joint[:3, 2]

    @property
    def origin(self) -> Array:
        """(3,) of the joint frame, world."""
        return self.T_world_joint[:3, 3]

    @property
    def R_world_joint(self) -> Array:
        """(3, 3)."""
        return self.T_world_joint[:3, :3]

    @property
    def unit_twist(self) -> Array:
        """S (6,), rotation first, in the joint frame."""
        row = KINDS[self.kind]
        along = self.pitch if row.has_pitch else float(row.slides)
        return np.array([0.0, 0.0, float(row.turns), 0.0, 0.0, along])

    def displacement(self, q: Array) -> tuple[Array, Array]:
        """Rotations (T, 3, 3) and translations (T, 3) of Exp(q S) in the joint frame, q (T,)."""
        twist = self.unit_twist
        rotations, translations = np.zeros((q.size, 3, 3)), np.zeros((q.size, 3))
        c, s = np.cos(q * twist[2]), np.sin(q * twist[2])
        rotations[:, 0, 0] = rotations[:, 1, 1] = c
        rotations[:, 0, 1], rotations[:, 1, 0] = -s, s
        rotations[:, 2, 2] = 1.0
        translations[:, 2] = q * twist[5]
        return rotations, translations

    def motion(self, q: Array) -> tuple[Array, Array]:
        """Rotations (T, 3, 3) and translations (T, 3) that take points at state 0 to q, in world.

        Args:
            q: (T,) states, radians or metres.
        """
        twist, axis, o_world = self.unit_twist, self.axis, self.origin
        along = np.outer(axis, axis)
        parts = np.concatenate([along, np.eye(3) - along, skew(axis)]).reshape(3, 9)
        shares = np.ones((q.size, 3))  # Rodrigues' formula: 1, cos and sin of the angle
        np.cos(q * twist[2], out=shares[:, 1])
        np.sin(q * twist[2], out=shares[:, 2])
        R_world = (shares @ parts).reshape(-1, 3, 3)
        t_world = (q * twist[5])[:, None] * axis + o_world - R_world @ o_world
        return R_world, t_world

    def motion_jacobians(self, q: Array) -> tuple[Array, Array, Array]:
        """How the motions M_t = T Exp(q_t S) T^-1 turn: twists d_t of M_t Exp(d_t), world axes.

            d d_t / d xi = Ad(T) (Ad(Exp(-q_t S)) - I),   d d_t / d q_t = Ad(T) S,
            d d_t / d pitch = q_t Ad(T) e_vz

        Args:
            q: (T,) states.

        Returns:
            By xi (T, 6, 6), by each frame's own state (T, 6) and by the pitch (T, 6), rotation
            first.
        """
        adjoint = np.zeros((6, 6))
        R = self.R_world_joint
        adjoint[:3, :3] = adjoint[3:, 3:] = R
        adjoint[3:, :3] = skew(self.origin) @ R
        by_xi = adjoint @ (self.adjoint_of_return(q) - np.eye(6))
        by_state = np.broadcast_to(adjoint @ self.unit_twist, (q.size, 6))
        return by_xi, by_state, q[:, None] * adjoint[:, 5]

    def velocity(self, p_world: Array) -> Array:
        """Ways (..., 3) of points (..., 3) of the part, where they are now, for a unit of state.

        The motion's own twist is the same at every state (Lynch and Park, 2017, sec. 3.3): points
        turn about the axis and slide along it by what `unit_twist` says of either.
        """
        twist = self.unit_twist
        turned = (p_world - self.origin) @ skew(twist[2] * self.axis).T
        return np.asarray(turned + twist[5] * self.axis)

    def reference_coordinates(self, q: Array, p_world: Array) -> Array:
        """Reference coordinates z (T, 3, N) of observed points p_world (T, 3, N), states q (T,)."""
        rotations, translations = self.displacement(q)
        R_ref_world = np.swapaxes(rotations, 1, 2) @ self.R_world_joint.T
        z = R_ref_world @ p_world
        # What slides along the axis it turns about is taken back there too.
        z -= (R_ref_world @ self.origin + translations)[:, :, None]
        return z

    def adjoint_of_return(self, q: Array) -> Array:
        """Ad(Exp(-q S)) for every frame, (T, 6, 6), tangent order rotation first."""
        rotations, translations = self.displacement(q)
        Rt, slide = np.swapaxes(rotations, 1, 2), translations[:, 2:]
        adjoint = np.zeros((q.size, 6, 6))
        adjoint[:, :3, :3] = adjoint[:, 3:, 3:] = Rt
        adjoint[:, 3, :3] = slide * Rt[:, 1]  # rows of [-slide e_z]x Rt
        adjoint[:, 4, :3] = -slide * Rt[:, 0]
        return adjoint


def cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors (3,), without the detours of the general one."""
    x, y, z = a
    u, v, w = b
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def skew(v: Array) -> Array:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out
