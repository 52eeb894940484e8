"""Hinge-distance prior: how far a hinge usually is from the middle of what it moves.

The distance rho between the joint axis and the centroid of the moving points is log-normal. It
keeps the pivot from running to infinity on a drawer's data and gives the revolute kind the proper
prior that an evidence needs. Error (1,), dimensionless:

    e = log(rho / median) / sigma,    rho = | (T_world_joint^-1 c)_xy |.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.adapter import make_factor
from factors.joint import skew

Array = NDArray[np.float64]


def hinge_distance_residual(
    T_world_joint: Array, centroid_world: Array, median_m: float, sigma_log: float
) -> tuple[float, Array]:
    """The error and its Jacobian (6,) by a right increment of T_world_joint (4, 4)."""
    c = T_world_joint[:3, :3].T @ (centroid_world - T_world_joint[:3, 3])
    rho2 = max(float(c[0] ** 2 + c[1] ** 2), 1e-12)
    J_c = np.hstack([skew(c), -np.eye(3)])
    J = (c[0] * J_c[0] + c[1] * J_c[1]) / (rho2 * sigma_log)
    return (0.5 * np.log(rho2) - np.log(median_m)) / sigma_log, J


def hinge_distance_factor(
    joint_key: int, centroid_world: Array, median_m: float, sigma_log: float
) -> gtsam.CustomFactor:
    """The factor over T_world_joint (Pose3).

    Args:
        joint_key: key of T_world_joint.
        centroid_world: (3,) centroid of the moving points, any state.
        median_m: median of the distance.
        sigma_log: standard deviation of its logarithm.

    Raises:
        ValueError: a median or sigma that is not positive.
    """
    if not (median_m > 0 and sigma_log > 0):
        raise ValueError(f"median_m {median_m} and sigma_log {sigma_log}, expected > 0")
    centroid = np.asarray(centroid_world, dtype=float)

    def residual(values: gtsam.Values, want_jacobians: bool) -> tuple[Array, list[Array] | None]:
        T = values.atPose3(joint_key).matrix()
        e, J = hinge_distance_residual(T, centroid, median_m, sigma_log)
        return np.array([e]), [J[None]] if want_jacobians else None

    return make_factor(residual, {joint_key: 6}, gtsam.noiseModel.Unit.Create(1))
