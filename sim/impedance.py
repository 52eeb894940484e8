"""Cartesian impedance by joint torques: the law alone, no simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.records import FloatArray
from sim.kinematics import N_ARM, Q_MAX, Q_MIN, TAU_MAX


@dataclass(frozen=True, slots=True)
class ImpedanceConfig:
    """Stiffness and damping of the hand, and the null space behind it."""

    stiffness_n_m: float = 900.0  # Franka's own examples use 200 to 2000
    damping_n_s_m: float = 110.0  # near critical for the hand's 3 to 4 kg
    stiffness_rot: float = 40.0  # N m/rad
    damping_rot: float = 8.0  # N m s/rad; the URDF's links carry 0.1 kg m^2 each
    null_stiffness: float = 4.0  # N m/rad, towards the rest posture
    null_damping: float = 3.0  # N m s/rad
    joint_damping: float = 0.5  # N m s/rad, everywhere
    limit_zone_rad: float = 0.06  # a soft spring begins this far inside the limits
    limit_stiffness: float = 150.0  # N m/rad in that zone


def joint_torques(
    wrench: FloatArray,
    J_gripper_q: FloatArray,
    q: FloatArray,
    dq: FloatArray,
    q_rest: FloatArray,
    gravity: FloatArray,
    config: ImpedanceConfig,
) -> FloatArray:
    """Torques (7,) that exert a wrench at the gripper, within Franka's limits.

    Args:
        wrench: (6,) force [N], then moment [N m], world axes, at the gripper point.
        J_gripper_q: (6, 7), linear then angular, world axes.
        q: (7,) rad.
        dq: (7,) rad/s.
        q_rest: (7,) posture that the null space leans to, rad.
        gravity: (7,) torques against gravity, N m.
        config: gains.
    """
    null = config.null_stiffness * (q_rest - q) - config.null_damping * dq
    JJt = J_gripper_q @ J_gripper_q.T + 1e-6 * np.eye(6)
    null -= J_gripper_q.T @ np.linalg.solve(JJt, J_gripper_q @ null)
    zone = config.limit_zone_rad
    limits = config.limit_stiffness * (
        np.maximum(Q_MIN + zone - q, 0.0) - np.maximum(q - (Q_MAX - zone), 0.0)
    )
    tau = J_gripper_q.T @ wrench + null + limits + gravity - config.joint_damping * dq
    assert tau.shape == (N_ARM,)
    return np.clip(tau, -TAU_MAX, TAU_MAX)


def bounded(vector: FloatArray, length: float) -> FloatArray:
    """The vector, shortened to `length` where it is longer."""
    norm = float(np.linalg.norm(vector))
    return vector if norm <= length else vector * (length / norm)
