"""Kinematics and dynamics of the Franka, from the same URDF that the simulator loads.

The gripper frame is the URDF's `panda_grasptarget`: between the fingertips, z forward, y along
the finger opening. World is the robot's base.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import pinocchio as pin

from akm_fg.records import FloatArray
from sim.bullet import PANDA_URDF, pose_from_matrix

N_ARM = 7

# The soft limits of the URDF's <safety_controller>, rad; the URDF's <limit>s are wider than the
# real robot's.
Q_MIN = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
Q_MAX = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
# Franka's published limits (Franka Control Interface documentation, "Robot and interface
# specifications", Panda): rad/s, rad/s^2, rad/s^3, N m.
DQ_MAX = np.array([2.1750, 2.1750, 2.1750, 2.1750, 2.6100, 2.6100, 2.6100])
DDQ_MAX = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
DDDQ_MAX = np.array([7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0])
TAU_MAX = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])
Q_HOME = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])


@dataclass(frozen=True, slots=True)
class IkConfig:
    """Damped least squares."""

    tolerance_m: float = 2e-5  # well below 0.1 mm
    tolerance_rad: float = 1e-4
    iterations: int = 80
    damping: float = 1e-3  # of J J^T, (m/rad)^2
    step_max_rad: float = 0.3  # keeps far starts from flipping
    centring: float = 0.02  # share of the way to mid-range per iteration, in the null space
    margin_rad: float = 0.01  # kept from the soft limits


class FrankaKinematics:
    """Forward kinematics, Jacobian, gravity and inverse kinematics of the arm."""

    def __init__(self, ik: IkConfig | None = None) -> None:
        self._model = pin.buildModelFromUrdf(str(PANDA_URDF))
        self._data = self._model.createData()
        self._frame = self._model.getFrameId("panda_grasptarget")
        self._q = np.zeros(self._model.nq)
        self._v = np.zeros(self._model.nv)
        self._ik = ik or IkConfig()

    def update(self, q: FloatArray, fingers_m: float = 0.02) -> tuple[FloatArray, FloatArray]:
        """T_world_gripper as (4, 4) and J_gripper_q (6, 7) at joint angles (7,).

        The Jacobian's rows are linear velocity [m/s], then angular [rad/s], both in world axes.
        """
        self._q[:N_ARM] = q
        self._q[N_ARM:] = fingers_m
        pin.computeJointJacobians(self._model, self._data, self._q)
        placement = pin.updateFramePlacement(self._model, self._data, self._frame)
        J = pin.getFrameJacobian(
            self._model, self._data, self._frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return placement.homogeneous, J[:, :N_ARM]

    def T_world_gripper(self, q: FloatArray) -> gtsam.Pose3:
        """The gripper pose at joint angles (7,)."""
        return pose_from_matrix(self.update(q)[0])

    def gravity(self, q: FloatArray, fingers_m: float) -> FloatArray:
        """Joint torques (7,) N m that hold the arm and hand against gravity."""
        self._q[:N_ARM] = q
        self._q[N_ARM:] = fingers_m
        return pin.computeGeneralizedGravity(self._model, self._data, self._q)[:N_ARM]

    def inverse_dynamics(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray, fingers_m: float
    ) -> FloatArray:
        """Joint torques (7,) N m for accelerations (7,) rad/s^2."""
        self._q[:N_ARM], self._q[N_ARM:] = q, fingers_m
        self._v[:N_ARM] = dq
        a = np.zeros(self._model.nv)
        a[:N_ARM] = ddq
        return pin.rnea(self._model, self._data, self._q, self._v, a)[:N_ARM]

    def solve(self, T_world_gripper: gtsam.Pose3, q_start: FloatArray) -> FloatArray | None:
        """Joint angles (7,) within the soft limits that reach the pose, or None.

        Damped least squares with a pull to mid-range in the null space, clamped to the limits.
        """
        ik = self._ik
        lo, hi = Q_MIN + ik.margin_rad, Q_MAX - ik.margin_rad
        middle = (Q_MIN + Q_MAX) / 2.0
        q = np.clip(q_start, lo, hi)
        target = T_world_gripper.matrix()
        for _ in range(ik.iterations):
            T, J = self.update(q)
            error = pose_error(target, T)
            small = np.linalg.norm(error[:3]) < ik.tolerance_m
            if small and np.linalg.norm(error[3:]) < ik.tolerance_rad:
                return q
            JJt = J @ J.T + ik.damping**2 * np.eye(6)
            step = J.T @ np.linalg.solve(JJt, error)
            # The centring pull fades with the error, so that the last steps converge.
            pull = ik.centring * min(1.0, 20.0 * float(np.linalg.norm(error))) * (middle - q)
            step += pull - J.T @ np.linalg.solve(JJt, J @ pull)
            step *= min(1.0, ik.step_max_rad / max(float(np.abs(step).max()), 1e-12))
            q = np.clip(q + step, lo, hi)
        return None

    def chain(
        self, poses: list[gtsam.Pose3], q_start: FloatArray, jump_max_rad: float = 0.4
    ) -> list[FloatArray] | None:
        """Joint angles for each pose, each started from the one before, or None.

        None too where neighbours differ by more than `jump_max_rad` in a joint (a flip).
        """
        result: list[FloatArray] = []
        q = q_start
        for pose in poses:
            q_next = self.solve(pose, q)
            if q_next is None or float(np.abs(q_next - q).max()) > jump_max_rad:
                return None
            result.append(q_next)
            q = q_next
        return result


def pose_error(target: FloatArray, T: FloatArray) -> FloatArray:
    """What moves T (4, 4) to target: translation [m], then rotation vector [rad], world axes."""
    return np.concatenate([target[:3, 3] - T[:3, 3], rotation_vector(target[:3, :3] @ T[:3, :3].T)])


def rotation_vector(R: FloatArray) -> FloatArray:
    """The logarithm (3,) of a rotation matrix, rad."""
    return pin.log3(R)


def limit_margin_rad(q: FloatArray) -> float:
    """Smallest distance of any joint to its soft limit, rad; negative outside."""
    return float(np.minimum(q - Q_MIN, Q_MAX - q).min())
