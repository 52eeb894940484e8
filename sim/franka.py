"""The Franka of the simulated world. Fits `akm_fg.interfaces.Arm` by shape."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import gtsam
import numpy as np

from akm_fg.errors import GraspFailed, MotionInfeasible
from akm_fg.records import FloatArray, TimedPath
from sim.bullet import p
from sim.gripper import GripperConfig, SimGripper
from sim.impedance import ImpedanceConfig, joint_torques
from sim.kinematics import N_ARM, Q_HOME, TAU_MAX, pose_error
from sim.pulling import Pull, PullConfig
from sim.reaching import (
    ReachConfig,
    choose_grasp_configuration,
    joint_motion,
    line_motion,
    standoff,
)
from sim.tracking import PathTracker, TrackConfig, path_is_reachable
from sim.world import SimWorld


@dataclass(frozen=True, slots=True)
class FrankaConfig:
    """All settings of the arm."""

    reach: ReachConfig = field(default_factory=ReachConfig)
    impedance: ImpedanceConfig = field(default_factory=ImpedanceConfig)
    pull: PullConfig = field(default_factory=PullConfig)
    track: TrackConfig = field(default_factory=TrackConfig)
    gripper: GripperConfig = field(default_factory=GripperConfig)
    approach_m_s: float = 0.08  # straight, before contact
    arrival_m: float = 0.008  # farther than this from the grasp pose: something was in the way
    close_s: float = 1.2  # 40 mm at 50 mm/s, and time to squeeze
    joint_kp: float = 400.0  # 1/s^2, of free motion
    joint_kd: float = 40.0  # 1/s


class SimFranka:
    """Torque-controlled arm with a friction gripper. Motions execute while iterated.

    It knows its own joints, fingers and geometry, and nothing of the object.
    """

    def __init__(self, world: SimWorld, config: FrankaConfig | None = None) -> None:
        self.config = config or FrankaConfig()
        self._world = world
        self._kinematics = world.kinematics
        self._joints = list(range(N_ARM))
        self.gripper = SimGripper(world, self.config.gripper)
        self._q_rest = Q_HOME.copy()
        self._q_hold = Q_HOME.copy()
        self._dt = world.config.step_s

    def measured_joints(self) -> tuple[FloatArray, FloatArray]:
        """Joint angles (7,) rad and speeds (7,) rad/s."""
        states = p.getJointStates(
            self._world.robot_id, self._joints, physicsClientId=self._world.client
        )
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def T_world_gripper(self) -> gtsam.Pose3:
        """The measured gripper pose (forward kinematics of the measured joints)."""
        return self._kinematics.T_world_gripper(self.measured_joints()[0])

    def holding(self) -> bool:
        """Whether something is between the closed fingers."""
        return self.gripper.closed_on_something()

    def grasp(self, T_world_grasp: gtsam.Pose3, tick_s: float) -> Iterator[None]:
        """Let go, move to the pre-grasp, approach along the gripper's z, close the fingers.

        Raises:
            MotionInfeasible: the pose cannot be reached.
            GraspFailed: the approach was blocked, or the fingers met with nothing between them.
        """
        choice = choose_grasp_configuration(self._kinematics, T_world_grasp, self.config.reach)
        if choice is None:
            where = np.round(T_world_grasp.translation(), 3)
            raise MotionInfeasible(f"the grasp at {where} m is out of the arm's reach")
        yield from self._ticks(self._release(), tick_s)
        yield from self._ticks(self._joint_move(choice.q_pregrasp), tick_s)
        yield from self._ticks(
            self._straight(T_world_grasp, self.config.reach.standoff_m, 0.0), tick_s
        )
        off_m = float(
            np.linalg.norm(self.T_world_gripper().translation() - T_world_grasp.translation())
        )
        if off_m > self.config.arrival_m:
            raise GraspFailed(f"the approach was blocked {1e3 * off_m:.0f} mm before the grasp")
        yield from self._ticks(self._close(T_world_grasp), tick_s)
        if not self.holding():
            raise GraspFailed("the fingers met with nothing between them")

    def pull(self, direction_world: FloatArray, distance_m: float, tick_s: float) -> Iterator[None]:
        """Pull gently, starting along a unit vector, and follow where the part lets the hand go.

        Ends after `distance_m` of travelled path, or when the part does not give.
        """
        yield from self._ticks(self._pull(direction_world, distance_m), tick_s)

    def follow(self, path: TimedPath, tick_s: float) -> Iterator[None]:
        """Follow a timed path compliantly, and wait until the arm has come to rest.

        Raises:
            MotionInfeasible: a pose of the path cannot be reached.
        """
        q = self.measured_joints()[0]
        if not path_is_reachable(self._kinematics, path, q):
            raise MotionInfeasible("a pose of the path is out of the arm's reach")
        yield from self._ticks(self._track(path), tick_s)

    def _ticks(self, motion: Iterator[FloatArray], tick_s: float) -> Iterator[None]:
        """Applies a motion's torques step by step; hands back control every `tick_s`."""
        due = self._world.time_s + tick_s
        for tau in motion:
            p.setJointMotorControlArray(
                self._world.robot_id,
                self._joints,
                p.TORQUE_CONTROL,
                forces=tau.tolist(),
                physicsClientId=self._world.client,
            )
            self._world.step()
            if self._world.time_s >= due - 0.5 * self._dt:
                due += tick_s
                yield None

    def _state(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """q, dq, T_world_gripper (4, 4), J_gripper_q (6, 7), torques against gravity."""
        q, dq = self.measured_joints()
        fingers = self.gripper.opening_m() / 2.0
        gravity = self._kinematics.gravity(q, fingers)
        T, J = self._kinematics.update(q, fingers)
        return q, dq, T, J, gravity

    def _cartesian(self, T_wanted: FloatArray, speed: FloatArray) -> FloatArray:
        """Torques of the stiff Cartesian impedance towards a pose moving at `speed` (6,)."""
        c = self.config.impedance
        q, dq, T, J, gravity = self._state()
        error, twist = pose_error(T_wanted, T), J @ dq
        force = c.stiffness_n_m * error[:3] + c.damping_n_s_m * (speed[:3] - twist[:3])
        moment = c.stiffness_rot * error[3:] + c.damping_rot * (speed[3:] - twist[3:])
        return joint_torques(np.r_[force, moment], J, q, dq, self._q_rest, gravity, c)

    def _joint_move(self, q_to: FloatArray) -> Iterator[FloatArray]:
        q_from, _ = self.measured_joints()
        kp, kd = self.config.joint_kp, self.config.joint_kd
        for q_ref, dq_ref, ddq_ref in joint_motion(q_from, q_to, self._dt, self.config.reach):
            q, dq = self.measured_joints()
            ddq = ddq_ref + kp * (q_ref - q) + kd * (dq_ref - dq)
            fingers = self.gripper.opening_m() / 2.0
            tau = self._kinematics.inverse_dynamics(q, dq, ddq, fingers)
            yield np.clip(tau, -TAU_MAX, TAU_MAX)
        self._q_rest = q_to.copy()

    def _straight(
        self, T_world_goal: gtsam.Pose3, from_m: float, to_m: float
    ) -> Iterator[FloatArray]:
        """Along the goal's z, from `from_m` behind it to `to_m` behind it."""
        length = abs(from_m - to_m)
        sign = 1.0 if from_m > to_m else -1.0
        for s in line_motion(length, self._dt, self.config.approach_m_s):
            wanted = standoff(T_world_goal, from_m - sign * s).matrix()
            yield self._cartesian(wanted, np.zeros(6))
        for _ in range(round(0.3 / self._dt)):
            yield self._cartesian(standoff(T_world_goal, to_m).matrix(), np.zeros(6))

    def _close(self, T_world_grasp: gtsam.Pose3) -> Iterator[FloatArray]:
        """Close, with the hand soft sideways so that an off-centre bar moves it, not the part."""
        self.gripper.close()
        wanted = T_world_grasp.matrix()
        for _ in range(round(self.config.close_s / self._dt)):
            yield self._cartesian(wanted, np.zeros(6))
        self._q_rest = self.measured_joints()[0]

    def _release(self) -> Iterator[FloatArray]:
        was_closed = self.gripper.squeezing
        self.gripper.open()
        if not was_closed:
            return
        here = self.T_world_gripper()
        for _ in range(round(0.9 / self._dt)):
            yield self._cartesian(here.matrix(), np.zeros(6))
        yield from self._straight(here, 0.0, self.config.reach.standoff_m)

    def _pull(self, direction_world: FloatArray, distance_m: float) -> Iterator[FloatArray]:
        T_start = self._state()[2].copy()
        pull = Pull(direction_world, distance_m, T_start, self.config.pull)
        while not pull.finished:
            q, dq, T, J, gravity = self._state()
            wrench = pull.wrench(T, J @ dq, self._dt)
            yield joint_torques(wrench, J, q, dq, self._q_rest, gravity, self.config.impedance)

    def _track(self, path: TimedPath) -> Iterator[FloatArray]:
        tracker = PathTracker(path, self.config.track)
        c = self.config.impedance
        while not tracker.finished:
            q, dq, T, J, gravity = self._state()
            wrench = tracker.wrench(T, J @ dq, self._dt)
            yield joint_torques(wrench, J, q, dq, self._q_rest, gravity, c)
