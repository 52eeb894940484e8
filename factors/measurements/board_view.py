"""Board-view factor: the corners of a calibration board, seen in one image.

Claim: the N corners of a board that were found in one image lie where the camera projects them.
Frames: `mount` carries the camera, `holder` carries the board; the robot knows T_mount_holder.

    fixed camera, board in the gripper (eye-to-hand):   mount = world,   holder = gripper
    camera in the gripper, fixed board (eye-in-hand):   mount = gripper, holder = world

Variables: the intrinsics K (Cal3DS2: fx, fy, skew, cx, cy, k1, k2, p1, p2), T_mount_cam,
T_mount_holder (Pose3, latent: the robot's reading of it is a prior of its own) and
T_holder_board. Error per corner (2,), pixels, pixel centres at integers:

    e = project(K, p_cam) - uv,    p_cam = T_mount_cam^-1 T_mount_holder T_holder_board p_board

under a Student-t kernel per corner, so that a corner found in the wrong place costs itself alone.
With n = p_cam / z, r2 = |n|^2 and radial gain g = 1 + k1 r2 + k2 r2^2 (Brown, Close-range camera
calibration, 1971; the model of OpenCV and of GTSAM's Cal3DS2)

    x_d = g x + 2 p1 x y + p2 (r2 + 2 x^2),   y_d = g y + 2 p2 x y + p1 (r2 + 2 y^2),
    uv = (fx x_d + skew y_d + cx, fy y_d + cy).

For right increments, with R_c_a the rotation from frame a to the camera's (Lynch and Park, Modern
Robotics, 2017, sec. 3.3),

    d p_cam / d xi_cam = [ [p_cam]x | -I ],   d p_cam / d xi_board = R_c_board [ -[p_board]x | I ],
    d p_cam / d xi_holder = R_c_holder [ -[p_holder]x | I ].
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.adapter import make_factor
from factors.joint import skew
from factors.student_t import twice_negative_log_kernel, weight

Array = NDArray[np.float64]

INTRINSICS = ("fx", "fy", "skew", "cx", "cy", "k1", "k2", "p1", "p2")  # order of Cal3DS2
LEAST_DEPTH_M = 1e-3  # what lies behind the camera is projected from here: far from where it was


def project_corners(intrinsics: Array, p_cam: Array) -> tuple[Array, Array, Array]:
    """Pixels (N, 2) and their Jacobians by the intrinsics (N, 2, 9) and by p_cam (N, 2, 3).

    Args:
        intrinsics: (9,) in the order of `INTRINSICS`.
        p_cam: (N, 3) metres, camera frame.
    """
    fx, fy, s, cx, cy, k1, k2, p1, p2 = intrinsics
    z = np.maximum(p_cam[:, 2], LEAST_DEPTH_M)
    x, y = p_cam[:, 0] / z, p_cam[:, 1] / z
    r2 = x * x + y * y
    gain, slope = 1.0 + k1 * r2 + k2 * r2**2, k1 + 2.0 * k2 * r2
    x_d = gain * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    y_d = gain * y + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)
    uv = np.stack([fx * x_d + s * y_d + cx, fy * y_d + cy], axis=-1)
    zero, one = np.zeros_like(x), np.ones_like(x)
    scale = np.array([[fx, s], [0.0, fy]])
    J_lens = np.array(  # of (x_d, y_d) by (k1, k2, p1, p2)
        [
            [r2 * x, r2**2 * x, 2.0 * x * y, r2 + 2.0 * x * x],
            [r2 * y, r2**2 * y, r2 + 2.0 * y * y, 2.0 * x * y],
        ]
    ).transpose(2, 0, 1)
    J_matrix = np.array([[x_d, zero, y_d, one, zero], [zero, y_d, zero, zero, one]])
    J_uv_K = np.concatenate([J_matrix.transpose(2, 0, 1), scale @ J_lens], axis=2)
    xx = gain + 2.0 * slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    yy = gain + 2.0 * slope * y * y + 2.0 * p2 * x + 6.0 * p1 * y
    xy = 2.0 * slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    J_n = np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1)
    ahead = p_cam[:, 2] > LEAST_DEPTH_M
    J_n_p = np.array([[one, zero, -x * ahead], [zero, one, -y * ahead]]).transpose(2, 0, 1)
    return uv, J_uv_K, scale @ J_n @ (J_n_p / z[:, None, None])


def board_view_residual(
    intrinsics: Array,
    T_mount_cam: Array,
    T_mount_holder: Array,
    T_holder_board: Array,
    p_board: Array,
    uv: Array,
) -> tuple[Array, Array]:
    """Errors (N, 2) in pixels and Jacobians (N, 2, 27) by (K, xi_cam, xi_holder, xi_board).

    Args:
        intrinsics: (9,) in the order of `INTRINSICS`.
        T_mount_cam: (4, 4).
        T_mount_holder: (4, 4).
        T_holder_board: (4, 4).
        p_board: (N, 3) corners, metres.
        uv: (N, 2) where they were found, pixels.
    """
    R_cam_mount = T_mount_cam[:3, :3].T
    R_cam_holder = R_cam_mount @ T_mount_holder[:3, :3]
    p_holder = p_board @ T_holder_board[:3, :3].T + T_holder_board[:3, 3]
    p_mount = p_holder @ T_mount_holder[:3, :3].T + T_mount_holder[:3, 3]
    p_cam = (p_mount - T_mount_cam[:3, 3]) @ R_cam_mount.T
    predicted, J_uv_K, J_uv_p = project_corners(intrinsics, p_cam)
    eye = np.tile(np.eye(3), (len(p_board), 1, 1))
    J_p_cam = np.concatenate([skew(p_cam), -eye], axis=2)
    J_p_holder = R_cam_holder @ np.concatenate([-skew(p_holder), eye], axis=2)
    R_cam_board = R_cam_holder @ T_holder_board[:3, :3]
    J_p_board = R_cam_board @ np.concatenate([-skew(p_board), eye], axis=2)
    J_poses = J_uv_p @ np.concatenate([J_p_cam, J_p_holder, J_p_board], axis=2)
    return predicted - uv, np.concatenate([J_uv_K, J_poses], axis=2)


def board_view_factor(
    intrinsics_key: int,
    cam_key: int,
    holder_key: int,
    board_key: int,
    p_board: Array,
    uv: Array,
    sigma_px: float,
    dof: float,
    count_as_one: float = 1.0,
) -> gtsam.CustomFactor:
    """The factor of one image over K, T_mount_cam, T_mount_holder and T_holder_board.

    Args:
        intrinsics_key: key of K (Cal3DS2).
        cam_key: key of T_mount_cam (Pose3).
        holder_key: key of T_mount_holder (Pose3) of this image.
        board_key: key of T_holder_board (Pose3).
        p_board: (N, 3) corners, metres, board frame.
        uv: (N, 2) where they were found, pixels.
        sigma_px: scale of the Student-t noise, each coordinate.
        dof: its degrees of freedom.
        count_as_one: corners that count as one; divides the cost.

    Raises:
        ValueError: no corners, shapes that do not match, numbers that are not finite, noise
            that is not positive.
    """
    _check(p_board, uv)
    for name, number in (("sigma_px", sigma_px), ("dof", dof), ("count_as_one", count_as_one)):
        if not number > 0:
            raise ValueError(f"{name} is {number}, expected > 0")
    blocks = {intrinsics_key: 9, cam_key: 6, holder_key: 6, board_key: 6}
    d = sum(blocks.values())

    def residual(values: gtsam.Values, want_jacobians: bool) -> tuple[Array, list[Array] | None]:
        e, J = board_view_residual(
            values.atCal3DS2(intrinsics_key).vector(),
            values.atPose3(cam_key).matrix(),
            values.atPose3(holder_key).matrix(),
            values.atPose3(board_key).matrix(),
            p_board,
            uv,
        )
        d2 = (e * e).sum(axis=1) / sigma_px**2
        twice_cost = float(twice_negative_log_kernel(d2, dof, 2).sum())
        if not want_jacobians:
            out = np.zeros(d + 1)
            out[-1] = np.sqrt(twice_cost)
            return out, None
        root = np.sqrt(weight(d2, dof, 2))[:, None] / sigma_px
        rows = (J * root[..., None]).reshape(-1, d)
        A, out = _fewest_rows(rows, (e * root).ravel(), twice_cost)
        return out, [A[:, :9], A[:, 9:15], A[:, 15:21], A[:, 21:]]

    noise = gtsam.noiseModel.Isotropic.Sigma(d + 1, np.sqrt(count_as_one))
    return make_factor(residual, blocks, noise)


def _fewest_rows(rows: Array, e: Array, twice_cost: float) -> tuple[Array, Array]:
    """`factors.adapter.square_root_rows` by QR of the rows themselves.

    A pixel answers to a metre a million times as much as to k2; normal equations would square
    that and lose what one view says of the lens.
    """
    d = rows.shape[1]
    R = np.linalg.qr(np.column_stack([rows, e]), mode="r")[:d]
    out = np.zeros((d + 1, d + 1))
    out[: len(R)] = R
    out[d, d] = max(twice_cost - float(out[:d, d] @ out[:d, d]), 0.0) ** 0.5
    return out[:, :d], out[:, d]


def _check(p_board: Array, uv: Array) -> None:
    n = len(p_board)
    if n == 0:
        raise ValueError("a view without corners, expected at least one")
    if p_board.shape != (n, 3) or uv.shape != (n, 2):
        raise ValueError(f"corners {p_board.shape} and pixels {uv.shape}, expected (N, 3), (N, 2)")
    if not (np.isfinite(p_board).all() and np.isfinite(uv).all()):
        raise ValueError("corners or pixels are not all finite")
