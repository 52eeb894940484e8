"""A posterior that holds what is not known of the camera.

Errors of a calibration are the same in all frames: no residual shows them, and no number of frames
averages them out. To first order they move the joint as they move what the camera saw of it. With
T_cam_joint the joint in the camera, a axis and o origin there:

    the camera's place   T_world_cam Exp(eta) T_cam_joint = T_world_joint Exp(Ad(T_joint_cam) eta);
    depth times 1 + s    scales all points about the camera: o moves by s o, a stays;
    depth plus b         moves o along its ray by b o / o_z;
    focal length (1 + f) shrinks what is seen across: o moves by -f (o_x, o_y, 0), and a by
                         -f (a_x, a_y, 0), less what is along a.

A drawer's states are lengths: they scale with depth, and with what of the axis is seen across. How
a focal length bends angles is left out: at most f / 2 radians, a twentieth of a degree for 0.2 %.
"""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from akm_fg.posterior import ArticulationPosterior, JointPosterior, KindPosterior, StatePosterior
from akm_fg.records import CalibrationErrors, FloatArray


def calibrated(
    posterior: ArticulationPosterior, errors: CalibrationErrors, T_world_cam: gtsam.Pose3
) -> ArticulationPosterior:
    """The posterior with the errors of the calibration in its covariances.

    Args:
        posterior: of a recording, whose camera was taken for perfect.
        errors: of its camera.
        T_world_cam: where that was taken to stand.
    """
    alternatives = {
        name: _with_errors(kind, errors, T_world_cam)
        for name, kind in posterior.alternatives.items()
    }
    return replace(posterior, alternatives=alternatives)


def _with_errors(
    kind: KindPosterior, errors: CalibrationErrors, T_world_cam: gtsam.Pose3
) -> KindPosterior:
    if kind.joint is None or kind.states is None:
        return kind
    T_cam_joint = T_world_cam.inverse().matrix() @ kind.joint.T_world_joint
    cov = kind.joint.cov + joint_errors(T_cam_joint, errors, kind.joint)
    joint = replace(kind.joint, cov=(cov + cov.T) / 2)
    return replace(kind, joint=joint, states=_scaled(kind.states, T_cam_joint, errors))


def joint_errors(
    T_cam_joint: FloatArray, errors: CalibrationErrors, joint: JointPosterior
) -> FloatArray:
    """Covariance (6, 6) that the errors add in the tangent of T_world_joint; zero along the gauge.

    Args:
        T_cam_joint: (4, 4).
        errors: of the camera.
        joint: whose observable directions count.
    """
    adjoint = gtsam.Pose3(T_cam_joint).inverse().AdjointMap()
    cov = adjoint @ errors.cov_world_cam @ adjoint.T
    R, o, a = T_cam_joint[:3, :3], T_cam_joint[:3, 3], T_cam_joint[:3, 2]
    across = np.array([1.0, 1.0, 0.0])
    bent = -(a * across) + a * float(a @ (a * across))
    moved = (
        (errors.depth_scale_sd, np.zeros(3), o),
        (errors.depth_bias_sd_m, np.zeros(3), o / max(float(o[2]), 1e-6)),
        (errors.focal_sd, np.cross(a, bent), -o * across),
    )
    for sd, turn, shift in moved:
        xi = np.concatenate([R.T @ turn, R.T @ shift])
        cov = cov + sd**2 * np.outer(xi, xi)
    seen = np.zeros(6)
    seen[list(joint.kind.observable)] = 1.0
    return np.asarray(cov * np.outer(seen, seen))


def _scaled(
    states: StatePosterior, T_cam_joint: FloatArray, errors: CalibrationErrors
) -> StatePosterior:
    """Lengths with the errors of their scale; angles as they are."""
    if states.unit == "rad":
        return states
    across = float((T_cam_joint[:2, 2] ** 2).sum())
    relative = np.hypot(errors.depth_scale_sd, errors.focal_sd * across)
    return replace(states, sd=np.hypot(states.sd, relative * states.mean))
