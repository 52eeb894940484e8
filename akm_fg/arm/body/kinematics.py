"""Kinematics and dynamics of the Franka, from its description (`akm_fg.arm.body.description`).

The gripper frame is a frame of the URDF between the fingertips, z forward, y along the finger
opening: `panda_grasptarget` by default. World is the robot's base.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import pink
import pinocchio as pin
from pink.limits import ConfigurationLimit
from pink.tasks import FrameTask, PostureTask

from akm_fg.arm.body.description import ArmDescription, franka_description
from akm_fg.arm.body.model import FINGER_JOINTS, N_ARM, read_model
from akm_fg.records import FloatArray

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
    """Differential inverse kinematics: a quadratic programme a step, solved by pink and daqp."""

    tolerance_m: float = 2e-5  # well below 0.1 mm
    tolerance_rad: float = 1e-4
    iterations: int = 80
    patience: int = 12  # iterations without a tenth less error: stuck at the limits
    frame_damping: float = 1e-2  # Levenberg-Marquardt, times the squared error
    posture_cost: float = 1e-3  # of leaving mid-range, 1/rad, against 1/m and 1/rad of the hand
    step_max_rad: float = 0.3  # keeps far starts from flipping
    margin_rad: float = 0.01  # kept from the soft limits


class FrankaKinematics:
    """Forward kinematics, Jacobian, gravity and inverse kinematics of the arm."""

    def __init__(
        self, ik: IkConfig | None = None, description: ArmDescription | None = None
    ) -> None:
        """Reads the arm's description; without one, the Franka of the installed PyBullet's data.

        Raises:
            MissingDependency: no description is given, and none is installed.
            InputError: the description cannot be read.
        """
        description = description or franka_description()
        self._model = read_model(description)
        self._data = self._model.createData()
        self._frame = self._model.getFrameId(description.gripper_frame)
        self._q = np.zeros(self._model.nq)
        self._v = np.zeros(self._model.nv)
        self._ik = _InverseKinematics(self._model, description.gripper_frame, ik or IkConfig())

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
        return gtsam.Pose3(self.update(q)[0])

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
        """Joint angles (7,) within the soft limits that reach the pose to 0.1 mm, or None.

        The hand comes first; what freedom is left leans to mid-range.
        """
        return self._ik.solve(T_world_gripper.matrix(), q_start)

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


class _InverseKinematics:
    """The arm alone (fingers locked), a task for the hand and a faint one for the posture."""

    def __init__(self, model: pin.Model, gripper_frame: str, config: IkConfig) -> None:
        fingers = [model.getJointId(joint) for joint in FINGER_JOINTS]
        arm = pin.buildReducedModel(model, fingers, np.zeros(model.nq))
        arm.lowerPositionLimit = Q_MIN + config.margin_rad
        arm.upperPositionLimit = Q_MAX - config.margin_rad
        self._config = config
        self._lower, self._upper = arm.lowerPositionLimit, arm.upperPositionLimit
        self._limits = [ConfigurationLimit(arm, config_limit_gain=1.0)]
        self._hand = FrameTask(gripper_frame, 1.0, 1.0, lm_damping=config.frame_damping)
        self._posture = PostureTask(cost=config.posture_cost)
        self._posture.set_target((Q_MIN + Q_MAX) / 2.0)
        self._state = pink.Configuration(arm, arm.createData(), self._lower)

    def solve(self, target: FloatArray, q_start: FloatArray) -> FloatArray | None:
        """Joint angles (7,) at which the hand is at `target` (4, 4), or None."""
        config, state = self._config, self._state
        self._hand.set_target(pin.SE3(target))
        state.update(np.clip(q_start, self._lower, self._upper))
        least, since = np.inf, 0
        for _ in range(config.iterations):
            error = self._hand.compute_error(state)
            off_m, off_rad = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
            if off_m < config.tolerance_m and off_rad < config.tolerance_rad:
                return state.q.copy()
            off = float(np.hypot(off_m, off_rad))
            least, since = (off, 0) if off < 0.9 * least else (least, since + 1)
            if since > config.patience:
                return None
            # The pull to mid-range fades with the error, so that the last steps converge.
            self._posture.cost = config.posture_cost * min(1.0, 20.0 * off)
            state.integrate_inplace(self._step(), 1.0)
        return None

    def _step(self) -> FloatArray:
        """Change (7,) of the joint angles, rad, that stays inside the limits."""
        step: FloatArray = pink.solve_ik(
            self._state,
            [self._hand, self._posture],
            dt=1.0,
            solver="daqp",
            damping=1e-8,
            limits=self._limits,
            safety_break=False,  # limits hold by construction, to rounding
        )
        return step * min(1.0, self._config.step_max_rad / max(float(np.abs(step).max()), 1e-12))


def pose_error(target: FloatArray, T: FloatArray) -> FloatArray:
    """What moves T (4, 4) to target: translation [m], then rotation vector [rad], world axes."""
    return np.concatenate([target[:3, 3] - T[:3, 3], rotation_vector(target[:3, :3] @ T[:3, :3].T)])


def rotation_vector(R: FloatArray) -> FloatArray:
    """The logarithm (3,) of a rotation matrix, rad."""
    return pin.log3(R)


def limit_margin_rad(q: FloatArray) -> float:
    """Smallest distance of any joint to its soft limit, rad; negative outside."""
    return float(np.minimum(q - Q_MIN, Q_MAX - q).min())
