"""Orientation-track factor: the measured orientations of the part follow the joint.

Claim: the part's orientation at state 0, R_ref, turned by the joint, is what was measured:
``R_world_part_t = R_wj Exp(q_t S)_rot R_wj^T R_ref``. Variables: T_world_joint (Pose3; only its
rotation acts), R_ref (Rot3, latent) and one state a frame. Error per frame, radians, in the
measured part frame:

    e_t = Log( R_ref^T A_t ),   A_t = R_wj R_S(q_t)^T R_wj^T R_world_part_t,

with a Student-t kernel per frame, so that a flipped marker costs one frame. With Jl and Jr the
left and right Jacobians of SO(3) (Sola et al., A micro Lie theory, 2018, eqs. 142 to 145):

    d e/d R_ref = -Jl^-1(e),   d e/d q = -Jr^-1(e) A^T R_wj s,
    d e/d w     = Jr^-1(e) (A^T - R_world_part^T) R_wj.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.adapter import make_factor, square_root_rows
from factors.joint import Joint, JointKind, skew
from factors.student_t import twice_negative_log_kernel, weight

Array = NDArray[np.float64]
_NEAR_PI = -0.9  # cosine of angles whose axis is not taken from the antisymmetric part


def log_so3(R: Array) -> Array:
    """Rotation vectors (T, 3), length at most pi, of rotation matrices (T, 3, 3)."""
    flat = R.reshape(-1, 9)
    twice_sine = flat[:, [7, 2, 3]] - flat[:, [5, 6, 1]]  # times the axis
    sine = 0.5 * np.sqrt((twice_sine * twice_sine).sum(axis=1))
    cosine = 0.5 * (flat[:, 0] + flat[:, 4] + flat[:, 8] - 1)
    ratio = np.arctan2(sine, cosine) / np.maximum(sine, 1e-12)
    w = np.where(sine > 1e-12, 0.5 * ratio, 0.5)[:, None] * twice_sine
    for t in np.flatnonzero(cosine < _NEAR_PI):  # the sine says little there
        w[t] = gtsam.Rot3.Logmap(gtsam.Rot3(R[t]))
    return w


def right_jacobian_inverse(w: Array) -> Array:
    """Inverse right Jacobians of SO(3), (T, 3, 3), of rotation vectors (T, 3), length <= pi."""
    angle2 = (w * w).sum(axis=-1)
    angle = np.sqrt(np.maximum(angle2, 1e-12))
    series = 1 / 12 + angle2 / 720
    closed = 1 / angle**2 - 1 / (2 * angle * np.tan(angle / 2))  # finite at pi
    W = skew(w)
    return np.eye(3) + W / 2 + np.where(angle2 < 1e-4, series, closed)[:, None, None] * (W @ W)


def orientation_residual(
    joint: Joint, R_ref: Array, q: Array, R_world_part: Array
) -> tuple[Array, Array, Array, Array]:
    """Errors (T, 3) and their Jacobians by w (T, 3, 3), R_ref (T, 3, 3) and q (T, 3).

    Args:
        joint: the joint; only its axis acts.
        R_ref: (3, 3) the part's orientation at state 0.
        q: (T,) states.
        R_world_part: (T, 3, 3) measured orientations.
    """
    turned, _ = joint.displacement(q)
    R_world_joint = joint.R_world_joint
    R_motion = R_world_joint @ turned @ R_world_joint.T
    A = np.swapaxes(R_motion, 1, 2) @ R_world_part
    e = log_so3(R_ref.T @ A)
    Jr_inv = right_jacobian_inverse(e)
    A_T, measured_T = np.swapaxes(A, 1, 2), np.swapaxes(R_world_part, 1, 2)
    J_w = Jr_inv @ (A_T - measured_T) @ R_world_joint
    J_ref = -np.swapaxes(Jr_inv, 1, 2)  # Jl^-1(e) = Jr^-1(e)^T
    axis_world = R_world_joint @ joint.unit_twist[:3]
    J_q = -np.einsum("tij,tjk,k->ti", Jr_inv, A_T, axis_world)
    return e, J_w, J_ref, J_q


def orientation_track_factor(
    kind: JointKind,
    joint_key: int,
    reference_key: int,
    state_keys: Sequence[int | None],
    R_world_part: Array,
    sigma_rad: float,
    dof: float,
) -> gtsam.CustomFactor:
    """The factor over T_world_joint, R_ref and the states.

    Args:
        kind: joint kind.
        joint_key: key of T_world_joint (Pose3).
        reference_key: key of R_ref (Rot3).
        state_keys: one a frame, key of q_t (double), or None where q_t is fixed at zero.
        R_world_part: (T, 3, 3) measured orientations.
        sigma_rad: scale of the Student-t noise, each axis.
        dof: its degrees of freedom.

    Raises:
        ValueError: shapes that do not match, a sigma that is not positive, an unknown kind.
    """
    kind = JointKind(kind)
    if R_world_part.shape != (len(state_keys), 3, 3):
        raise ValueError(f"orientations {R_world_part.shape}, expected {(len(state_keys), 3, 3)}")
    if not sigma_rad > 0:
        raise ValueError(f"sigma_rad is {sigma_rad}, expected > 0")
    free = [t for t, key in enumerate(state_keys) if key is not None]
    keys = [key for key in state_keys if key is not None]
    d = 9 + len(free)

    def residual(values: gtsam.Values, want_jacobians: bool) -> tuple[Array, list[Array] | None]:
        joint = Joint(kind, values.atPose3(joint_key).matrix(), 0.0)  # a pitch turns nothing
        R_ref = values.atRot3(reference_key).matrix()
        q = np.zeros(len(state_keys))
        q[free] = [values.atDouble(key) for key in keys]
        e, J_w, J_ref, J_q = orientation_residual(joint, R_ref, q, R_world_part)
        d2 = (e * e).sum(axis=1) / sigma_rad**2
        twice_cost = float(twice_negative_log_kernel(d2, dof, 3).sum())
        if not want_jacobians:
            out = np.zeros(d + 1)
            out[-1] = np.sqrt(twice_cost)
            return out, None
        root = np.sqrt(weight(d2, dof, 3))[:, None] / sigma_rad
        J = np.zeros((e.shape[0], 3, d))
        J[:, :, :3], J[:, :, 6:9] = J_w, J_ref
        J[free, :, 9 + np.arange(len(free))] = J_q[free]
        rows = (J * root[..., None]).reshape(-1, d)
        A, out = square_root_rows(rows.T @ rows, rows.T @ (e * root).ravel(), twice_cost)
        return out, [A[:, :6], A[:, 6:9], *(A[:, 9 + k : 10 + k] for k in range(len(free)))]

    dims = {joint_key: 6, reference_key: 3, **dict.fromkeys(keys, 1)}
    return make_factor(residual, dims, gtsam.noiseModel.Unit.Create(d + 1))
