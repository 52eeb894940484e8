"""Where a joint puts points and poses of its part, and how sure that is.

A pose T_ref of the part at state zero is at M(q) T_ref. The joint's frame, its pitch and the state
are not known exactly; `factors.joint` gives the twist d of M Exp(d) that they make, to first order:

    d = J_xi xi + J_q dq + J_pitch dpitch,   M Exp(d) T_ref = (M T_ref) Exp(Ad(T_ref^-1) d),

so the covariance of a pose is Ad cov_d Ad^T, and that of a point x is J cov_d J^T with
J = R_M [-[x]x | I]. Moving from a state q_0 by dq is the motion of dq (screws of one axis commute):
what was seen at q_0 is predicted for q by `predict(q - q_0)`. Frame, pitch and state are taken as
independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.posterior import JointPosterior
from akm_fg.records import FloatArray
from factors.joint import skew


@dataclass(frozen=True, slots=True)
class PointPrediction:
    """N points of a part at a state."""

    p_world: FloatArray  # (N, 3) metres
    cov_world: FloatArray  # (N, 3, 3) m^2

    @property
    def sd_m(self) -> FloatArray:
        """(N,) standard deviation along each point's widest direction."""
        return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(self.cov_world)[:, -1], 0.0)))


@dataclass(frozen=True, slots=True)
class PosePrediction:
    """A pose on a part at a state; the true one is T_world_pose Exp(xi), xi ~ N(0, cov)."""

    T_world_pose: FloatArray  # (4, 4)
    cov: FloatArray  # (6, 6) GTSAM order, rotation first, increment on the right

    @property
    def cov_world(self) -> FloatArray:
        """(3, 3) of the position, world axes, m^2."""
        R = self.T_world_pose[:3, :3]
        return R @ self.cov[3:, 3:] @ R.T


def predict_points(
    joint: JointPosterior, q: float, p_world: FloatArray, q_sd: float = 0.0
) -> PointPrediction:
    """Where points of the part are at a state.

    Args:
        joint: of the part.
        q: the state, from the one in which the points were seen; radians or metres.
        p_world: (N, 3), or (3,), the points where they were seen, exactly.
        q_sd: standard deviation of the state.

    Raises:
        ValueError: points of another shape, or a state that is no number.
    """
    x = np.atleast_2d(np.asarray(p_world, dtype=np.float64))
    if x.ndim != 2 or x.shape[1] != 3:
        raise ValueError(f"points {x.shape}, expected (N, 3)")
    cov_twist = _cov_of_twist(joint, q, q_sd)
    (R,), (t,) = joint.joint.motion(np.array([q]))
    J = np.concatenate([-skew(x), np.broadcast_to(np.eye(3), (len(x), 3, 3))], axis=2)
    J = R @ J
    return PointPrediction(x @ R.T + t, J @ cov_twist @ np.swapaxes(J, 1, 2))


def predict_pose(
    joint: JointPosterior,
    q: float,
    T_world_seen: gtsam.Pose3 | FloatArray,
    q_sd: float = 0.0,
    cov_seen: FloatArray | None = None,
) -> PosePrediction:
    """Where a pose on the part is at a state: a handle's frame, or a hand that holds it.

    Args:
        joint: of the part.
        q: the state, from the one in which the pose was seen; radians or metres.
        T_world_seen: the pose where it was seen, a `Pose3` or (4, 4).
        q_sd: standard deviation of the state.
        cov_seen: (6, 6) of that pose, increment on the right; None: it is exact.

    Raises:
        ValueError: a state that is no number.
    """
    seen = T_world_seen if isinstance(T_world_seen, gtsam.Pose3) else gtsam.Pose3(T_world_seen)
    cov_twist = _cov_of_twist(joint, q, q_sd)
    (R,), (t,) = joint.joint.motion(np.array([q]))
    adjoint = seen.inverse().AdjointMap()
    cov = adjoint @ cov_twist @ adjoint.T
    if cov_seen is not None:
        cov = cov + cov_seen  # a right increment of the pose stays one wherever it is moved
    pose = gtsam.Pose3(gtsam.Rot3(R), t) * seen
    return PosePrediction(pose.matrix(), np.asarray(cov))


def _cov_of_twist(joint: JointPosterior, q: float, q_sd: float) -> FloatArray:
    """(6, 6) of the twist by which the motion to a state is off."""
    if not (np.isfinite(q) and np.isfinite(q_sd) and q_sd >= 0):
        raise ValueError(f"state {q} with sd {q_sd}, expected finite numbers, the sd not below 0")
    by_xi, by_q, by_pitch = (each[0] for each in joint.joint.motion_jacobians(np.array([q])))
    cov = by_xi @ joint.cov @ by_xi.T + q_sd**2 * np.outer(by_q, by_q)
    pitch_sd = joint.pitch_sd_m_per_rad or 0.0
    return np.asarray(cov + pitch_sd**2 * np.outer(by_pitch, by_pitch))
