"""Gauge factor: fixes the directions of T_world_joint that no measurement can fix.

Turning the joint frame about its z axis and sliding it along z change nothing; for a prismatic
joint no translation does. The factor puts the origin at the point of the axis nearest to a given
centroid of the moving points (for a prismatic joint: at the centroid) and keeps the heading of
the x axis near that of a given frame. It adds no information on the joint itself.

Error (revolute, helical): [ Log(R_ref^T R)_z, (T_world_joint^-1 c)_z ];
prismatic: [ Log(R_ref^T R)_z, T_world_joint^-1 c ]. Radians and metres, tangent order of GTSAM.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.adapter import make_factor
from factors.joint import TANGENT, JointKind

Array = NDArray[np.float64]

# Far below every posterior width that matters, far above what makes the system ill-conditioned.
SIGMA = 1e-5


def gauge_factor(
    kind: JointKind, joint_key: int, R_world_ref: gtsam.Rot3, centroid_world: Array
) -> gtsam.CustomFactor:
    """The gauge factor of one joint.

    Args:
        kind: joint kind.
        joint_key: key of T_world_joint (Pose3).
        R_world_ref: the heading to keep.
        centroid_world: (3,) centroid of the moving points at state zero.

    Raises:
        ValueError: an unknown kind or a centroid that is not three finite numbers.
    """
    kind = JointKind(kind)
    centroid = np.asarray(centroid_world, dtype=float)
    if centroid.shape != (3,) or not np.isfinite(centroid).all():
        raise ValueError(f"centroid {centroid}, expected three finite numbers")
    rows = [TANGENT.index(name) - 3 for name in kind.gauge if name != "wz"]

    def residual(values: gtsam.Values, want_jacobians: bool) -> tuple[Array, list[Array] | None]:
        T = values.atPose3(joint_key)
        turn = gtsam.Rot3.Logmap(R_world_ref.between(T.rotation()))
        J_c_pose = np.zeros((3, 6), order="F")
        J_c_point = np.zeros((3, 3), order="F")
        c_joint = T.transformTo(centroid, J_c_pose, J_c_point)
        e = np.concatenate([turn[2:], c_joint[rows]])
        if not want_jacobians:
            return e, None
        J_turn = np.zeros((1, 6))
        J_turn[0, :3] = gtsam.Rot3.LogmapDerivative(turn)[2]
        return e, [np.vstack([J_turn, J_c_pose[rows]])]

    noise = gtsam.noiseModel.Isotropic.Sigma(1 + len(rows), SIGMA)
    return make_factor(residual, {joint_key: 6}, noise)
