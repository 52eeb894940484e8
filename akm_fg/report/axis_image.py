"""A joint axis and its uncertainty, projected into an image.

The true line is T_world_line * Exp(xi) applied to the z axis, xi ~ N(0, cov) in GTSAM order
(wx, wy, wz [rad], vx, vy, vz [m], increment on the right). The point s metres along the axis
moves by -[s e_z]x w + v in the joint's frame (first order), which the camera's Jacobian takes to
pixels. Across the projected line this gives the standard deviation of the line itself at that
place; along it the point only slides on the line and nothing is seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.posterior import JointPosterior, normal_bound
from akm_fg.records import FloatArray, PinholeCamera

ELLIPSE_SIGMAS = float(np.sqrt(-2 * np.log(0.05)))  # chi-square, two degrees of freedom, 95 %
_MIN_DEPTH_M = 0.05  # nearer points project wildly
_MAX_IMAGES = 3.0  # points farther outside than this many image sizes are not drawn


@dataclass(frozen=True, slots=True)
class AxisInImage:
    """S points along a projected axis; rows that the camera cannot show are left out."""

    along_m: FloatArray  # (S,) place on the axis, from its origin
    uv: FloatArray  # (S, 2) pixels
    normal: FloatArray  # (S, 2) unit, across the line; NaN where the camera looks along the axis
    half_width_px: FloatArray  # (S,) 95 % of true lines pass within this of `uv`
    cov_uv_px2: FloatArray  # (S, 2, 2) of the point itself

    def band(self) -> FloatArray:
        """Outline (2 S, 2) of the 95 % band."""
        across = self.half_width_px[:, None] * self.normal
        return np.concatenate([self.uv + across, (self.uv - across)[::-1]])

    def ellipse(self, along_m: float, n: int = 64) -> FloatArray:
        """Outline (n, 2) of the 95 % region of the point nearest to this place."""
        i = int(np.argmin(np.abs(self.along_m - along_m)))
        variance, directions = np.linalg.eigh(self.cov_uv_px2[i])
        turn = np.linspace(0, 2 * np.pi, n, endpoint=False)
        circle = np.stack([np.cos(turn), np.sin(turn)])
        radii = ELLIPSE_SIGMAS * np.sqrt(np.maximum(variance, 0.0))
        return self.uv[i] + (directions @ (radii[:, None] * circle)).T


def project_axis(
    T_world_line: FloatArray,
    cov: FloatArray,
    camera: PinholeCamera,
    T_world_cam: gtsam.Pose3,
    along_m: FloatArray,
) -> AxisInImage:
    """Project points of an axis with their covariance.

    Args:
        T_world_line: (4, 4), z along the axis.
        cov: (6, 6) of its tangent.
        camera: intrinsics.
        T_world_cam: camera pose.
        along_m: (S,) places on the axis.
    """
    T_cam_line = np.linalg.inv(T_world_cam.matrix()) @ T_world_line
    R, t = T_cam_line[:3, :3], T_cam_line[:3, 3]
    p_cam = t + along_m[:, None] * R[:, 2]
    uv = camera.project(p_cam)
    size = np.array([camera.width, camera.height])
    shown = p_cam[:, 2] > _MIN_DEPTH_M
    shown &= (np.abs(np.nan_to_num(uv, nan=np.inf) - size / 2) < _MAX_IMAGES * size).all(axis=1)
    p_cam, uv, along_m = p_cam[shown], uv[shown], along_m[shown]
    J_uv_cam = _camera_jacobian(camera, p_cam)
    J_line_xi = np.zeros((len(along_m), 3, 6))
    J_line_xi[:, 0, 1] = along_m  # -[s e_z]x
    J_line_xi[:, 1, 0] = -along_m
    J_line_xi[:, :, 3:] = np.eye(3)
    J_uv_xi = J_uv_cam @ R @ J_line_xi
    cov_uv = J_uv_xi @ cov @ J_uv_xi.transpose(0, 2, 1)
    direction = J_uv_cam @ R[:, 2]
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.divide(direction, length, out=np.full_like(direction, np.nan), where=length > 1)
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    variance = np.einsum("si,sij,sj->s", normal, cov_uv, normal)
    half = normal_bound() * np.sqrt(np.maximum(variance, 0.0))
    return AxisInImage(along_m, uv, normal, half, cov_uv)


def _camera_jacobian(camera: PinholeCamera, p_cam: FloatArray) -> FloatArray:
    """(S, 2, 3) d uv / d p_cam."""
    x, y, z = p_cam.T
    J = np.zeros((len(p_cam), 2, 3))
    J[:, 0, 0], J[:, 0, 2] = camera.fx / z, -camera.fx * x / z**2
    J[:, 1, 1], J[:, 1, 2] = camera.fy / z, -camera.fy * y / z**2
    return J


def axis_of_joint(
    joint: JointPosterior,
    state: float,
    camera: PinholeCamera,
    T_world_cam: gtsam.Pose3,
    reach_m: float,
    n: int = 101,
) -> AxisInImage:
    """The part of a joint's axis that is drawn.

    Revolute: the line, `reach_m` to either side of the pivot. Prismatic: a direction has no place,
    so an arrow of length `reach_m` from the middle of the part's points (the gauge), moved by the
    state; only the direction is uncertain, so the band opens from a point.
    """
    T, cov = joint.T_world_joint.copy(), joint.cov.copy()
    if not joint.turns:
        T[:3, 3] += (state if np.isfinite(state) else 0.0) * joint.axis
        cov[3:], cov[:, 3:] = 0.0, 0.0
    start = -reach_m if joint.turns else 0.0
    return project_axis(T, cov, camera, T_world_cam, np.linspace(start, reach_m, n))
