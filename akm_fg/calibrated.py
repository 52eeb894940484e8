"""A posterior that holds what is not known of the camera.

Errors of a calibration are the same in all frames: no residual shows them, and no number of frames
averages them out. To first order they move the joint as they move what the camera saw of it. With
T_cam_joint the joint in the camera, a axis and o origin there:

    the camera's place   T_world_cam Exp(eta) T_cam_joint = T_world_joint Exp(Ad(T_joint_cam) eta);
    depth times 1 + s    scales all points about the camera: o moves by s o, a stays;
    depth plus b         moves o along its ray by b o / o_z;
    intrinsics           shares f, g of the focal lengths, and c, d of the principal point in them,
                         move a point p by G p = -(f p_x + c p_z, g p_y + d p_z, 0): o moves by
                         G o, and a by G a, less what is along a.

A drawer's states are lengths: they scale with depth, and with what of the axis is seen across. How
a focal length bends angles is left out: at most f / 2 radians, a twentieth of a degree for 0.2 %.
"""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from akm_fg.posterior import ArticulationPosterior, JointPosterior, KindPosterior, StatePosterior
from akm_fg.records import CalibrationErrors, FloatArray, PinholeCamera


def calibrated(
    posterior: ArticulationPosterior,
    errors: CalibrationErrors,
    T_world_cam: gtsam.Pose3,
    camera: PinholeCamera,
) -> ArticulationPosterior:
    """The posterior with the errors of the calibration in its covariances.

    Args:
        posterior: of a recording, whose camera was taken for perfect.
        errors: of its camera.
        T_world_cam: where that was taken to stand.
        camera: what it was taken for.
    """
    alternatives = {
        name: _with_errors(kind, errors, T_world_cam, camera)
        for name, kind in posterior.alternatives.items()
    }
    return replace(posterior, alternatives=alternatives)


def _with_errors(
    kind: KindPosterior,
    errors: CalibrationErrors,
    T_world_cam: gtsam.Pose3,
    camera: PinholeCamera,
) -> KindPosterior:
    if kind.joint is None or kind.states is None:
        return kind
    T_cam_joint = T_world_cam.inverse().matrix() @ kind.joint.T_world_joint
    cov = kind.joint.cov + joint_errors(T_cam_joint, errors, kind.joint, camera)
    joint = replace(kind.joint, cov=(cov + cov.T) / 2)
    return replace(kind, joint=joint, states=_scaled(kind.states, T_cam_joint, errors, camera))


# How a point moves with each of fx, fy, cx, cy, as shares of the focal lengths.
LENS = -np.array(
    [
        [[1, 0, 0], [0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 1, 0], [0, 0, 0]],
        [[0, 0, 1], [0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 0, 1], [0, 0, 0]],
    ],
    dtype=float,
)


def _lens_cov(errors: CalibrationErrors, camera: PinholeCamera) -> FloatArray:
    """Covariance (4, 4) of the intrinsics' errors as shares of the focal lengths."""
    cov = np.zeros((4, 4))
    cov[:2, :2] = errors.focal_sd**2
    if errors.cov_intrinsics is not None:
        focal_px = np.array([camera.fx, camera.fy, camera.fx, camera.fy])
        cov += errors.cov_intrinsics / np.outer(focal_px, focal_px)
    return cov


def joint_errors(
    T_cam_joint: FloatArray,
    errors: CalibrationErrors,
    joint: JointPosterior,
    camera: PinholeCamera,
) -> FloatArray:
    """Covariance (6, 6) that the errors add in the tangent of T_world_joint; zero along the gauge.

    Args:
        T_cam_joint: (4, 4).
        errors: of the camera.
        joint: whose observable directions count.
        camera: whose intrinsics those are that are not known exactly.
    """
    adjoint = gtsam.Pose3(T_cam_joint).inverse().AdjointMap()
    cov = adjoint @ errors.cov_world_cam @ adjoint.T
    R, o, a = T_cam_joint[:3, :3], T_cam_joint[:3, 3], T_cam_joint[:3, 2]
    for sd, shift in (
        (errors.depth_scale_sd, o),
        (errors.depth_bias_sd_m, o / max(float(o[2]), 1e-6)),
    ):
        xi = np.concatenate([np.zeros(3), R.T @ shift])
        cov = cov + sd**2 * np.outer(xi, xi)
    bent = LENS @ a - np.outer(LENS @ a @ a, a)
    J_joint_lens = np.vstack([R.T @ np.cross(a, bent).T, R.T @ (LENS @ o).T])
    cov = cov + J_joint_lens @ _lens_cov(errors, camera) @ J_joint_lens.T
    seen = np.zeros(6)
    seen[list(joint.kind.observable)] = 1.0
    return np.asarray(cov * np.outer(seen, seen))


def _scaled(
    states: StatePosterior,
    T_cam_joint: FloatArray,
    errors: CalibrationErrors,
    camera: PinholeCamera,
) -> StatePosterior:
    """Lengths with the errors of their scale; angles as they are."""
    if states.unit == "rad":
        return states
    relative = length_error(T_cam_joint, errors, camera)
    return replace(states, sd=np.hypot(states.sd, relative * states.mean))


def length_error(
    T_cam_joint: FloatArray, errors: CalibrationErrors, camera: PinholeCamera
) -> float:
    """Relative standard deviation of lengths along a joint's axis, as the camera sees them."""
    a = T_cam_joint[:3, 2]
    J_length_lens = LENS @ a @ a  # relative
    lens = float(J_length_lens @ _lens_cov(errors, camera) @ J_length_lens)
    return float(np.sqrt(errors.depth_scale_sd**2 + lens))
