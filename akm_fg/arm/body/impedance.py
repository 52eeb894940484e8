"""Joint and Cartesian impedance by joint torques: the laws alone, no simulator.

`balance` is in both the torque that the arm needs to move as it does with no force on it: gravity,
Coriolis, and inertia where a reference acceleration is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from akm_fg.arm.body.kinematics import Q_MAX, Q_MIN
from akm_fg.arm.body.model import N_ARM
from akm_fg.records import FloatArray

REGULAR = 1e-6 * np.eye(6)  # of J J^T, so that a singular arm has a null space too


PerJoint = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class JointImpedanceConfig:
    """Stiffness and damping of each joint, as in Franka's own joint impedance example."""

    stiffness: PerJoint = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)  # N m/rad
    damping: PerJoint = (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0)  # N m s/rad


@dataclass(frozen=True, slots=True)
class ImpedanceConfig:
    """Stiffness and damping of the hand, and the null space behind it."""

    stiffness_n_m: float = 900.0  # Franka's own examples use 200 to 2000
    sideways_n_m: float = 300.0  # along the fingers' opening while they close
    damping_n_s_m: float = 110.0  # near critical for the hand's 3 to 4 kg
    stiffness_rot: float = 40.0  # N m/rad
    damping_rot: float = 8.0  # N m s/rad; the URDF's links carry 0.1 kg m^2 each
    null_stiffness: float = 4.0  # N m/rad, towards the rest posture
    null_damping: float = 3.0  # N m s/rad
    joint_damping: float = 0.5  # N m s/rad, everywhere
    limit_zone_rad: float = 0.06  # a soft spring begins this far inside the limits, or at rest
    limit_stiffness: float = 150.0  # N m/rad in that zone


def joint_impedance(
    q_ref: FloatArray,
    dq_ref: FloatArray,
    q: FloatArray,
    dq: FloatArray,
    balance: FloatArray,
    config: JointImpedanceConfig,
) -> FloatArray:
    """Torques (7,) N m of springs and dampers between the joints and their references, all (7,)."""
    stiffness, damping = np.array(config.stiffness), np.array(config.damping)
    return stiffness * (q_ref - q) + damping * (dq_ref - dq) + balance


def cartesian_torques(
    wrench: FloatArray,
    J_gripper_q: FloatArray,
    q: FloatArray,
    dq: FloatArray,
    q_rest: FloatArray,
    balance: FloatArray,
    config: ImpedanceConfig,
) -> FloatArray:
    """Torques (7,) N m that exert a wrench at the gripper.

    Args:
        wrench: (6,) force [N], then moment [N m], world axes, at the gripper point.
        J_gripper_q: (6, 7), linear then angular, world axes.
        q: (7,) rad.
        dq: (7,) rad/s.
        q_rest: (7,) posture that the null space leans to, rad. Where it is near a joint limit the
            spring there begins at it: nothing pushes an arm that has just come to rest.
        balance: (7,) torques against gravity and Coriolis forces, N m.
        config: gains.
    """
    lean = config.null_stiffness * (q_rest - q) - config.null_damping * dq
    JJt = J_gripper_q @ J_gripper_q.T + REGULAR
    # What the posture would exert at the hand is taken out: J^T (wrench - (J J^T)^-1 J lean).
    behind = dposv(JJt, J_gripper_q @ lean)[1]  # numpy's solver takes four times as long
    tau = J_gripper_q.T @ (wrench - behind) + lean + balance - config.joint_damping * dq
    low = np.minimum(Q_MIN + config.limit_zone_rad, q_rest)
    high = np.maximum(Q_MAX - config.limit_zone_rad, q_rest)
    tau += config.limit_stiffness * (np.maximum(low - q, 0.0) - np.maximum(q - high, 0.0))
    assert tau.shape == (N_ARM,)
    return tau


def bounded(vector: FloatArray, length: float) -> FloatArray:
    """The vector, shortened to `length` where it is longer."""
    norm = float(np.sqrt(vector @ vector))
    return vector if norm <= length else vector * (length / norm)
