"""Grasp-pose factor (proprioception): while the gripper holds, its pose is rigid in the part.

Claim: over the T frames of one hold, the gripper's pose follows the joint,

    T_world_gripper_t = P_t = T_world_joint Exp(q_t S) T_joint_grasp.

Variables: T_world_joint (Pose3), the pitch of a helical joint (double, metres per radian), one
state a frame (double, or fixed at zero) and T_joint_grasp (Pose3, latent): the gripper's pose in
the joint frame at state zero. Error per frame (6,), radians and metres, on the tangent of the
measured pose M_t with rotation and translation apart, because that is how hand-eye calibration,
kinematics and play in the grasp err:

    e_t = [ Log(R_M^T R_P),  R_M^T (t_P - t_M) ].

With eta the right increment of P_t, d e / d eta = B = diag(Jr^-1(e_rot), R_M^T R_P), Jr the right
Jacobian of SO(3), and (Lynch and Park, Modern Robotics, 2017, sec. 3.3)

    d eta / d xi_joint = Ad(T_joint_grasp^-1) Ad(Exp(-q S)),    d eta / d xi_grasp = I,
    d eta / d q = Ad(T_joint_grasp^-1) S,    d eta / d pitch = q Ad(T_joint_grasp^-1) e_vz.

Slip. A Student-t kernel on the whitened 6-vector of each frame lets single frames go (a jerk, a
slip that springs back). A *lasting* slip, where the hand slides and holds again, ends the hold:
each hold is one factor with its own T_joint_grasp, sharing joint and states with the others
through their keys; frames in which the hand slides belong to no hold. `hold_starts` finds where
to split. That was preferred to a random walk of the grasp, whose 6 T unknowns would also follow
the joint's own motion. Along the motion, slip cannot be told from the state by proprioception:
that takes the camera.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.adapter import make_factor, square_root_rows
from factors.joint import Joint, JointKind, skew
from factors.joint_variables import JointVariables
from factors.measurements.orientation_track import log_so3, right_jacobian_inverse
from factors.student_t import log_normaliser, twice_negative_log_kernel, weight

Array = NDArray[np.float64]


def grasp_pose_residual(
    joint: Joint, q: Array, T_joint_grasp: Array, T_world_gripper: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Errors (T, 6) and Jacobians by xi_joint, xi_grasp (T, 6, 6 each), q and pitch (T, 6 each).

    Args:
        joint: the joint.
        q: (T,) states.
        T_joint_grasp: (4, 4) the gripper in the joint frame at state zero.
        T_world_gripper: (T, 4, 4) measured.
    """
    rotations, translations = joint.displacement(q)
    R_grasp, t_grasp = T_joint_grasp[:3, :3], T_joint_grasp[:3, 3]
    R_predicted = joint.R_world_joint @ rotations @ R_grasp
    moved = rotations @ t_grasp + translations
    t_predicted = moved @ joint.R_world_joint.T + joint.origin
    R_measured_T = np.swapaxes(T_world_gripper[:, :3, :3], 1, 2)
    turn = R_measured_T @ R_predicted
    e_rot = log_so3(turn)
    e_trans = np.einsum("tij,tj->ti", R_measured_T, t_predicted - T_world_gripper[:, :3, 3])
    J_grasp = np.zeros((q.size, 6, 6))
    J_grasp[:, :3, :3], J_grasp[:, 3:, 3:] = right_jacobian_inverse(e_rot), turn
    to_grasp = np.zeros((6, 6))  # Ad(T_joint_grasp^-1)
    to_grasp[:3, :3] = to_grasp[3:, 3:] = R_grasp.T
    to_grasp[3:, :3] = -R_grasp.T @ skew(t_grasp)
    J_twist = J_grasp @ to_grasp
    J_joint = J_twist @ joint.adjoint_of_return(q)
    J_pitch = q[:, None] * J_twist[:, :, 5]
    return np.hstack([e_rot, e_trans]), J_joint, J_grasp, J_twist @ joint.unit_twist, J_pitch


def grasps_in_joint(joint: Joint, q: Array, T_world_gripper: Array) -> Array:
    """What each frame alone says T_joint_grasp is, (T, 4, 4): Exp(-q S) T_world_joint^-1 M_t.

    `typical_grasp` of them starts a hold; where they change for good, the hand has slipped.

    Args:
        joint: the joint.
        q: (T,) states.
        T_world_gripper: (T, 4, 4) measured.
    """
    rotations, translations = joint.displacement(q)
    back = np.swapaxes(rotations, 1, 2) @ joint.R_world_joint.T
    offset = joint.origin + translations @ joint.R_world_joint.T
    out = np.tile(np.eye(4), (q.size, 1, 1))
    out[:, :3, :3] = back @ T_world_gripper[:, :3, :3]
    out[:, :3, 3] = np.einsum("tij,tj->ti", back, T_world_gripper[:, :3, 3] - offset)
    return out


def typical_grasp(T_joint_grasp: Array, sigma_rot_rad: float, sigma_trans_m: float) -> Array:
    """The grasp (4, 4) among (T, 4, 4) with the least summed whitened distance to the others."""
    R, t = T_joint_grasp[:, :3, :3].reshape(-1, 9), T_joint_grasp[:, :3, 3]
    # The Frobenius distance of rotations is sqrt(2) times their small angle.
    turn2 = ((R[:, None] - R) ** 2).sum(axis=2) / (2 * sigma_rot_rad**2)
    slide2 = ((t[:, None] - t) ** 2).sum(axis=2) / sigma_trans_m**2
    typical: Array = T_joint_grasp[np.argmin(np.sqrt(turn2 + slide2).sum(axis=1))]
    return typical


def hold_starts(
    T_joint_grasp: Array,
    sigma_rot_rad: float,
    sigma_trans_m: float,
    dof: float,
    shortest: int = 5,
) -> NDArray[np.int_]:
    """First frames of the holds into which lasting slips split the grasps; always starts with 0.

    Optimal partitioning (Jackson et al., An algorithm for optimal partitioning of data on an
    interval, 2005) of the factor's own cost about each hold's median grasp; a hold more must pay
    for its six numbers and its place by the Bayesian information criterion.

    Args:
        T_joint_grasp: (T, 4, 4), from `grasps_in_joint` with the states seen by the camera.
        sigma_rot_rad: scale of their noise, that of the states included.
        sigma_trans_m: likewise.
        dof: degrees of freedom of the Student-t noise.
        shortest: frames of the shortest hold; what lasts less is an outlier.
    """
    typical, T = typical_grasp(T_joint_grasp, sigma_rot_rad, sigma_trans_m), len(T_joint_grasp)
    turn = log_so3(typical[:3, :3].T @ T_joint_grasp[:, :3, :3]) / sigma_rot_rad
    slide = (T_joint_grasp[:, :3, 3] - typical[:3, 3]) @ typical[:3, :3] / sigma_trans_m
    y = np.hstack([turn, slide])
    penalty = 7 * math.log(T)
    best, previous = np.full(T + 1, math.inf), np.zeros(T + 1, dtype=int)
    best[0] = 0.0
    for end in range(min(shortest, T), T + 1):
        for start in [0, *range(shortest, end - shortest + 1)]:
            hold = y[start:end]
            d2 = ((hold - np.median(hold, axis=0)) ** 2).sum(axis=1)
            cost = best[start] + penalty + twice_negative_log_kernel(d2, dof, 6).sum()
            if cost < best[end]:
                best[end], previous[end] = cost, start
    starts = [previous[T]]
    while starts[-1] > 0:
        starts.append(previous[starts[-1]])
    return np.array(starts[::-1])


def grasp_log_normaliser(
    frames: int, sigma_rot_rad: float, sigma_trans_m: float, dof: float
) -> float:
    """Log likelihood of the factor at zero error; half its squared error comes off that."""
    one = log_normaliser(dof, 6) - 3 * math.log(sigma_rot_rad) - 3 * math.log(sigma_trans_m)
    return frames * one


def grasp_pose_factor(
    kind: JointKind,
    joint_key: int,
    grasp_key: int,
    state_keys: Sequence[int | None],
    T_world_gripper: Array,
    sigma_rot_rad: float,
    sigma_trans_m: float,
    dof: float,
    pitch_key: int | None = None,
    count_as_one: float = 1.0,
) -> gtsam.CustomFactor:
    """The factor of one hold over T_world_joint, T_joint_grasp, the states and the pitch.

    With a prismatic joint and every state fixed it says that nothing moved.

    Args:
        kind: joint kind.
        joint_key: key of T_world_joint (Pose3).
        grasp_key: key of T_joint_grasp (Pose3) of this hold.
        state_keys: one a frame, key of q_t (double), or None where q_t is fixed at zero.
        T_world_gripper: (T, 4, 4) measured poses of the gripper.
        sigma_rot_rad: scale of the Student-t noise, each axis of rotation.
        sigma_trans_m: scale of the Student-t noise, each axis of translation.
        dof: its degrees of freedom.
        pitch_key: key of the pitch (double), metres per radian; helical joints only.
        count_as_one: frames that count as one because they err together; divides the cost.

    Raises:
        ValueError: an unknown kind, a pitch missing or out of place, poses that do not match the
            frames or are no poses, sigmas, dof or a count that are not positive.
    """
    variables = JointVariables(kind, joint_key, tuple(state_keys), pitch_key)
    _check(len(state_keys), T_world_gripper)
    _check_noise(sigma_rot_rad, sigma_trans_m, dof)
    if not count_as_one > 0:
        raise ValueError(f"count_as_one is {count_as_one}, expected > 0")
    free, (_, *others) = variables.free, variables.dims
    sigmas = np.repeat([sigma_rot_rad, sigma_trans_m], 3)
    d = 12 + len(others)

    def residual(values: gtsam.Values, want_jacobians: bool) -> tuple[Array, list[Array] | None]:
        joint, q = variables.read(values)
        grasp = values.atPose3(grasp_key).matrix()
        e, *blocks = grasp_pose_residual(joint, q, grasp, T_world_gripper)
        e = e / sigmas
        if not want_jacobians:
            rows = np.zeros(d + 1)
            rows[-1] = np.sqrt(_twice_cost(e, dof))
            return rows, None
        A, rows = _robust_rows(e, _stacked(blocks, free, d) / sigmas[:, None], dof)
        edges = [0, 6, *range(12, d + 1)]
        return rows, [A[:, a:b] for a, b in pairwise(edges)]

    dims = {joint_key: 6, grasp_key: 6, **dict.fromkeys(others, 1)}
    noise = gtsam.noiseModel.Isotropic.Sigma(d + 1, math.sqrt(count_as_one))
    return make_factor(residual, dims, noise)


def _stacked(blocks: list[Array], free: list[int], d: int) -> Array:
    """Jacobians (T, 6, d) by (xi_joint, xi_grasp, free states, pitch where there is one)."""
    J_joint, J_grasp, J_q, J_pitch = blocks
    J = np.zeros((J_q.shape[0], 6, d))
    J[:, :, :6], J[:, :, 6:12] = J_joint, J_grasp
    J[free, :, 12 + np.arange(len(free))] = J_q[free]
    if d > 12 + len(free):
        J[:, :, -1] = J_pitch
    return J


def _robust_rows(e: Array, J: Array, dof: float) -> tuple[Array, Array]:
    """The fewest rows (A, e) of whitened frames e (T, 6), J (T, 6, d) under the Student-t."""
    d2 = (e * e).sum(axis=1)
    root = np.sqrt(weight(d2, dof, 6))[:, None]
    rows = (J * root[..., None]).reshape(-1, J.shape[2])
    return square_root_rows(rows.T @ rows, rows.T @ (e * root).ravel(), _twice_cost(e, dof))


def _twice_cost(e: Array, dof: float) -> float:
    return float(twice_negative_log_kernel((e * e).sum(axis=1), dof, 6).sum())


def _check(frames: int, T_world_gripper: Array) -> None:
    if T_world_gripper.shape != (frames, 4, 4):
        raise ValueError(f"gripper poses {T_world_gripper.shape}, expected {(frames, 4, 4)}")
    R = T_world_gripper[:, :3, :3]
    handed = np.einsum("ti,ti->t", np.cross(R[:, :, 0], R[:, :, 1]), R[:, :, 2])
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    # Comparisons with NaN are false, so that NaN is no pose either.
    proper = (off < 1e-4) & (handed > 0) & np.isfinite(T_world_gripper).all(axis=(1, 2))
    bad = np.flatnonzero(~proper)
    if bad.size:
        raise ValueError(f"gripper poses of frames {bad.tolist()} are not rigid transforms")


def _check_noise(sigma_rot_rad: float, sigma_trans_m: float, dof: float) -> None:
    for name, number in (
        ("sigma_rot_rad", sigma_rot_rad),
        ("sigma_trans_m", sigma_trans_m),
        ("dof", dof),
    ):
        if not number > 0:
            raise ValueError(f"{name} is {number}, expected > 0")
