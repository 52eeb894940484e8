"""Kinematics of one joint: where the joint takes the points of the moving part.

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

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MovingKind = Literal["prismatic", "revolute", "helical"]

UNIT_TWIST: dict[str, Array] = {
    "revolute": np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
    "prismatic": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
    "helical": np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),  # plus its pitch
}


def unit_twist(kind: str, pitch: float = 0.0) -> Array:
    """The joint's unit twist S (6,), rotation first, in the joint frame.

    Args:
        kind: joint kind.
        pitch: of a helical joint, metres per radian.

    Raises:
        ValueError: an unknown kind, or a pitch of a joint that is not helical.
    """
    if kind not in UNIT_TWIST:
        raise ValueError(f"joint kind {kind!r}, expected one of {sorted(UNIT_TWIST)}")
    if kind == "helical":
        return UNIT_TWIST[kind] + np.array([0.0, 0.0, 0.0, 0.0, 0.0, pitch])
    if pitch:
        raise ValueError(f"pitch {pitch} m/rad of a {kind} joint, expected 0")
    return UNIT_TWIST[kind]


def joint_displacement(kind: str, q: Array, pitch: float = 0.0) -> tuple[Array, Array]:
    """Rotations (T, 3, 3) and translations (T, 3) of Exp(q S) in the joint frame, q (T,)."""
    twist = unit_twist(kind, pitch)
    rotations, translations = np.zeros((q.size, 3, 3)), np.zeros((q.size, 3))
    c, s = np.cos(q * twist[2]), np.sin(q * twist[2])
    rotations[:, 0, 0] = rotations[:, 1, 1] = c
    rotations[:, 0, 1], rotations[:, 1, 0] = -s, s
    rotations[:, 2, 2] = 1.0
    translations[:, 2] = q * twist[5]
    return rotations, translations


def part_motion(
    kind: str, T_world_joint: Array, q: Array, pitch: float = 0.0
) -> tuple[Array, Array]:
    """Rotations (T, 3, 3) and translations (T, 3) that take points at state 0 to state q, in world.

    Args:
        kind: joint kind.
        T_world_joint: (4, 4).
        q: (T,) states, radians or metres.
        pitch: of a helical joint, metres per radian.
    """
    twist, axis, o_world = unit_twist(kind, pitch), T_world_joint[:3, 2], T_world_joint[:3, 3]
    along = np.outer(axis, axis)
    parts = np.concatenate([along, np.eye(3) - along, skew(axis)]).reshape(3, 9)
    shares = np.ones((q.size, 3))  # Rodrigues' formula: 1, cos and sin of the angle
    np.cos(q * twist[2], out=shares[:, 1])
    np.sin(q * twist[2], out=shares[:, 2])
    R_world = (shares @ parts).reshape(-1, 3, 3)
    t_world = (q * twist[5])[:, None] * axis + o_world - R_world @ o_world
    return R_world, t_world


def reference_coordinates(
    kind: str, T_world_joint: Array, q: Array, p_world: Array, pitch: float = 0.0
) -> Array:
    """Reference coordinates z (T, 3, N) of observed points p_world (T, 3, N), states q (T,)."""
    R_world_joint, o_world = T_world_joint[:3, :3], T_world_joint[:3, 3]
    rotations, translations = joint_displacement(kind, q, pitch)
    R_ref_world = np.swapaxes(rotations, 1, 2) @ R_world_joint.T
    z = R_ref_world @ p_world
    z -= (R_ref_world @ o_world + translations)[:, :, None]  # slides along the axis it turns about
    return z


def adjoint_of_return(kind: str, q: Array, pitch: float = 0.0) -> Array:
    """Ad(Exp(-q S)) for every frame, (T, 6, 6), tangent order rotation first."""
    rotations, translations = joint_displacement(kind, q, pitch)
    Rt, slide = np.swapaxes(rotations, 1, 2), translations[:, 2:]
    adjoint = np.zeros((q.size, 6, 6))
    adjoint[:, :3, :3] = adjoint[:, 3:, 3:] = Rt
    adjoint[:, 3, :3] = slide * Rt[:, 1]  # rows of [-slide e_z]x Rt
    adjoint[:, 4, :3] = -slide * Rt[:, 0]
    return adjoint


def motion_jacobians(
    kind: str, T_world_joint: Array, q: Array, pitch: float = 0.0
) -> tuple[Array, Array, Array]:
    """How the motions M_t = T Exp(q_t S) T^-1 turn: twists d_t of M_t Exp(d_t), world axes.

        d d_t / d xi = Ad(T) (Ad(Exp(-q_t S)) - I),   d d_t / d q_t = Ad(T) S,
        d d_t / d pitch = q_t Ad(T) e_vz

    Returns:
        By xi (T, 6, 6), by each frame's own state (T, 6) and by the pitch (T, 6), rotation first.
    """
    adjoint = np.zeros((6, 6))
    R = T_world_joint[:3, :3]
    adjoint[:3, :3] = adjoint[3:, 3:] = R
    adjoint[3:, :3] = skew(T_world_joint[:3, 3]) @ R
    by_xi = adjoint @ (adjoint_of_return(kind, q, pitch) - np.eye(6))
    by_state = np.broadcast_to(adjoint @ unit_twist(kind, pitch), (q.size, 6))
    return by_xi, by_state, q[:, None] * adjoint[:, 5]


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
