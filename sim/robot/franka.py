"""The Franka of the simulated world. Fits `akm_fg.interfaces.Arm` by shape."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence

import gtsam
import numpy as np

from akm_fg.arm.body.collision import Obstacle
from akm_fg.arm.body.impedance import REGULAR, cartesian_torques, joint_impedance
from akm_fg.arm.body.kinematics import Q_HOME, pose_error
from akm_fg.arm.body.limits import MotionRecorder
from akm_fg.arm.body.model import N_ARM
from akm_fg.arm.body.silhouette import ArmSilhouette
from akm_fg.arm.motion.aside import aside
from akm_fg.arm.motion.free_motion import RrtConnectPlanner, timed_motion, way_out
from akm_fg.arm.motion.joint_path import JointMotion, joint_motion
from akm_fg.arm.motion.pulling import Pull
from akm_fg.arm.motion.reaching import (
    GraspConfiguration,
    GraspOptions,
    clear_options,
    followed,
    line_motion,
    looked_along,
    standoff,
)
from akm_fg.arm.motion.reference import pose_reference, within_joint_limits
from akm_fg.arm.motion.surroundings import KnownScene, Surroundings
from akm_fg.arm.motion.tracking import PathTracker
from akm_fg.errors import GraspFailed, MotionInfeasible
from akm_fg.records import FloatArray, HandPath, RgbdFrame
from sim.robot.drive import ArmDrive
from sim.robot.franka_config import FrankaConfig
from sim.robot.gripper import SimGripper
from sim.world import SimWorld


class SimFranka:
    """Torque-controlled arm with a friction gripper. Motions execute while iterated.

    It knows its own joints, fingers and geometry, and nothing of the object. Its encoders are off
    by `joint_offsets_rad` (7,), which it does not know.
    """

    def __init__(
        self,
        world: SimWorld,
        config: FrankaConfig | None = None,
        joint_offsets_rad: FloatArray | None = None,
    ) -> None:
        self.config = config or FrankaConfig()
        self._kinematics = world.kinematics
        self.gripper = SimGripper(world, self.config.gripper)
        self._drive = ArmDrive(world, self.gripper, joint_offsets_rad)
        self._q_rest = Q_HOME.copy()
        self._tracker: PathTracker | None = None  # of a path that is being followed
        self._wrench = np.zeros(6)  # that the last compliant motion asked for, world axes
        self._silhouette: ArmSilhouette | None = None  # its meshes are read when it is asked for
        self._eye_world: FloatArray | None = None  # of the camera that took what was seen
        self._scene = KnownScene(world.placement.floor_m, self.config.around, world.arm_description)

    def see(self, frame: RgbdFrame) -> None:
        """Keep clear, from now on, of what this frame shows and of what it cannot show behind it.

        The frame is of this moment, the robot's own pixels carry no depth. Without any frame the
        arm knows the floor and its own pedestal.
        """
        self._scene.see(frame, self.measured_joints()[0])
        self._eye_world = frame.T_world_cam.translation()

    def know(self, obstacles: Sequence[Obstacle]) -> None:
        """Keep clear, from now on, of things whose shape and place are known beforehand."""
        self._scene.know(obstacles)

    def record(self) -> MotionRecorder:
        """From now on every executed control step goes into the recorder that is returned."""
        self._drive.recorder = MotionRecorder(self._drive.step_s)
        return self._drive.recorder

    def measured_joints(self) -> tuple[FloatArray, FloatArray]:
        """Joint angles (7,) rad and speeds (7,) rad/s."""
        state = self._drive.refresh()
        return state.q, state.dq

    def T_world_gripper(self) -> gtsam.Pose3:
        """The measured gripper pose (forward kinematics of the measured joints)."""
        return self._kinematics.T_world_gripper(self.measured_joints()[0])

    def step_aside(self, frame: RgbdFrame, tick_s: float, unseen: bool = False) -> Iterator[None]:
        """Let go, and go where the arm hides little from the camera that took the frame.

        With `unseen`, little of what this frame does not show, and the next frame is a later one:
        a tick passes wherever it is. Stays where it is after letting go if no such place is within
        reach without touching anything.
        """
        yield from self._go_aside(frame, tick_s, unseen)
        if unseen:
            here = self.T_world_gripper().matrix()
            yield from self._drive.execute(self._stay(here, tick_s), tick_s)

    def _go_aside(self, frame: RgbdFrame, tick_s: float, unseen: bool) -> Iterator[None]:
        yield from self._drive.execute(self._release(), tick_s)
        if self._silhouette is None:
            self._silhouette = ArmSilhouette(self._scene.description, self.config.silhouette)
        around = self._scene.around(self.T_world_gripper(), self.config.reach.margins_m[0])
        try:
            yield from self._drive.execute(self._out_of_touch(around), tick_s)
        except (GraspFailed, MotionInfeasible):
            return
        q = self.measured_joints()[0]
        places = aside(self._silhouette, frame, q, self.config.aside, unseen)
        planner = RrtConnectPlanner(around.free_motion, self.config.plan)
        for place in places[: self.config.aside.tried]:
            if np.abs(place - q).max() < self.config.met_rad:
                return
            try:
                waypoints = planner.plan(self.measured_joints()[0], place)
                yield from self._drive.execute(self._joint_move(waypoints, around), tick_s)
            except (GraspFailed, MotionInfeasible):  # no way, or it met what no camera shows
                continue
            return

    def holding(self) -> bool:
        """Whether something is between the closed fingers."""
        return self.gripper.closed_on_something()

    def reachable(self, T_world_grasp: gtsam.Pose3, onward: Sequence[gtsam.Pose3] = ()) -> float:
        """Share of the poses that the hand gets to from a grasp, one after the other.

        Raises:
            MotionInfeasible: the grasp cannot be reached, or not without touching something.
        """
        _, options = self._options(T_world_grasp, onward)
        return options.configurations[0].onward

    def can_follow(self, poses: Sequence[gtsam.Pose3]) -> int:
        """How many of the poses the hand gets to from where it is, one after the other."""
        return followed(self._kinematics, poses, self.measured_joints()[0])

    def grasp(
        self,
        T_world_grasp: gtsam.Pose3,
        tick_s: float,
        feel_m: float = 0.0,
        onward: Sequence[gtsam.Pose3] = (),
    ) -> Iterator[None]:
        """Let go, move to the pre-grasp, approach along the gripper's z, close the fingers.

        With `feel_m`, the grasp's depth is only known to so much: the hand goes on by as far until
        something stops it, which may be as far before the grasp, and closes a little behind. It
        goes as the camera looked, along which depth errs, as far as `aslant_rad` allows. Of the
        ways to get there the one is taken from which the hand gets farthest along `onward`.

        Raises:
            MotionInfeasible: the pose cannot be reached, or not without touching something.
            GraspFailed: the arm met something on its way, the approach was blocked, or the fingers
                met with nothing between them.
        """
        around, options = self._options(T_world_grasp, onward)
        yield from self._drive.execute(self._release(), tick_s)
        motion = self._reach(T_world_grasp, options.configurations, around, feel_m)
        yield from self._drive.execute(motion, tick_s)
        off_m = float(
            np.linalg.norm(self.T_world_gripper().translation() - T_world_grasp.translation())
        )
        if off_m > self.config.arrival_m + feel_m:
            raise GraspFailed(_blocked(off_m))
        T_world_closed = T_world_grasp if feel_m == 0.0 else self.T_world_gripper()
        yield from self._drive.execute(self._close(T_world_closed), tick_s)
        if not self.holding():
            raise GraspFailed("the fingers met with nothing between them")

    def close_and_reach(
        self, T_world_wanted: gtsam.Pose3, tick_s: float, onward: Sequence[gtsam.Pose3] = ()
    ) -> Iterator[None]:
        """Let go, and move clear of what was seen to a pose, with closed fingers.

        Raises:
            MotionInfeasible: the pose cannot be reached, or not without touching something.
            GraspFailed: something was met on the way.
        """
        around, options = self._options(T_world_wanted, onward)
        yield from self._drive.execute(self._release(), tick_s)
        motion = self._reach_closed(T_world_wanted, options.configurations, around)
        yield from self._drive.execute(motion, tick_s)

    def pull(self, direction_world: FloatArray, distance_m: float, tick_s: float) -> Iterator[None]:
        """Pull gently, starting along a unit vector, and follow where the part lets the hand go.

        Ends after `distance_m` of travelled path, or when the part does not give.
        """
        yield from self._drive.execute(self._pull(direction_world, distance_m), tick_s)

    def relax(self, tick_s: float) -> Iterator[None]:
        """After a motion that was not iterated to its end: come to rest, and let the force fade."""
        yield from self._drive.execute(self._fade(), tick_s)

    def follow(self, path: HandPath, tick_s: float) -> Iterator[None]:
        """Follow a path compliantly, and wait until the arm has come to rest.

        The path takes longer than asked where the joints' limits ask for it.

        Raises:
            MotionInfeasible: a pose of the path cannot be reached.
        """
        q = self.measured_joints()[0]
        feasible = within_joint_limits(self._kinematics, path, q, self.config.reference)
        if feasible is None:
            raise MotionInfeasible("a pose of the path is out of the arm's reach")
        yield from self._drive.execute(self._track(feasible), tick_s)

    def _sense(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """q, dq, T_world_gripper (4, 4), J_gripper_q (6, 7), torques of gravity and Coriolis."""
        state = self._drive.state
        q, dq, fingers = state.q, state.dq, sum(state.fingers_m) / 2.0
        balance = self._kinematics.inverse_dynamics(q, dq, np.zeros(N_ARM), fingers)
        T, J = self._kinematics.update(q, fingers)
        return q, dq, T, J, balance

    def _cartesian(
        self, T_wanted: FloatArray, speed: FloatArray, sideways_n_m: float | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Torques of the stiff Cartesian impedance towards a pose moving at `speed` (6,).

        `sideways_n_m` replaces the stiffness along the fingers' opening. Second comes what the
        hand lacks of the pose (6,), m and rad, world axes.
        """
        c = self.config.impedance
        q, dq, T, J, balance = self._sense()
        error, twist = pose_error(T_wanted, T), J @ dq
        force = c.stiffness_n_m * error[:3] + c.damping_n_s_m * (speed[:3] - twist[:3])
        if sideways_n_m is not None:
            y = T[:3, 1]
            force -= (c.stiffness_n_m - sideways_n_m) * (y @ error[:3]) * y
        moment = c.stiffness_rot * error[3:] + c.damping_rot * (speed[3:] - twist[3:])
        wrench = np.concatenate([force, moment])
        return cartesian_torques(wrench, J, q, dq, self._q_rest, balance, c), error

    def _options(
        self, T_world_grasp: gtsam.Pose3, onward: Sequence[gtsam.Pose3] = ()
    ) -> tuple[Surroundings, GraspOptions]:
        """What is around, and the arm's clear configurations for a grasp: at least one.

        Raises:
            MotionInfeasible: there are none.
        """
        reach = self.config.reach
        around = self._scene.around(T_world_grasp, reach.margins_m[0])
        return around, clear_options(self._kinematics, T_world_grasp, around, reach, onward)

    def _reach(
        self,
        T_world_grasp: gtsam.Pose3,
        goals: Sequence[GraspConfiguration],
        around: Surroundings,
        feel_m: float,
    ) -> Iterator[FloatArray]:
        """To a pre-grasp, and straight on to the grasp."""
        reached = yield from self._free_motion(goals, around)
        yield from self._approach(T_world_grasp, reached, feel_m)

    def _free_motion(
        self, goals: Sequence[GraspConfiguration], around: Surroundings
    ) -> Generator[FloatArray, None, GraspConfiguration]:
        """To the first of the pre-grasps that it finds a free way to; which one is returned."""
        yield from self._out_of_touch(around)
        planner = RrtConnectPlanner(around.free_motion, self.config.plan)
        q_from, problem = self._drive.state.q, None
        for goal in goals:
            try:
                waypoints = planner.plan(q_from, goal.q_pregrasp)
            except MotionInfeasible as error:
                problem = problem or error
                continue
            yield from self._joint_move(waypoints, around)
            return goal
        assert problem is not None
        raise problem

    def _joint_move(self, waypoints: FloatArray, around: Surroundings) -> Iterator[FloatArray]:
        """Free motion along waypoints (K, 7) rad, the first where the arm is, from rest to rest."""
        step_m = self.config.plan.step_m
        motion = timed_motion(
            waypoints, around.free_motion, self._drive.step_s, self.config.time_law, step_m
        )
        yield from self._play(motion)

    def _out_of_touch(self, around: Surroundings) -> Iterator[FloatArray]:
        """Where the arm touches itself or what is seen, to where it does not.

        Raises:
            MotionInfeasible: no way leads out.
        """
        q = self._drive.state.q
        out = way_out(around.free_motion, q)
        if out is not None:
            law = self.config.time_law
            yield from self._play(joint_motion(np.stack([q, out]), self._drive.step_s, law))

    def _play(self, motion: JointMotion) -> Iterator[FloatArray]:
        for q_ref, dq_ref, ddq_ref in zip(motion.q, motion.dq, motion.ddq, strict=True):
            state = self._drive.state
            fingers = sum(state.fingers_m) / 2.0
            balance = self._kinematics.inverse_dynamics(state.q, state.dq, ddq_ref, fingers)
            if np.abs(q_ref - state.q).max() > self.config.met_rad:
                raise GraspFailed("the arm met something on its way")
            yield joint_impedance(q_ref, dq_ref, state.q, state.dq, balance, self.config.joints)
        self._q_rest = motion.q[-1].copy()

    def _approach(
        self, T_world_grasp: gtsam.Pose3, choice: GraspConfiguration, feel_m: float = 0.0
    ) -> Iterator[FloatArray]:
        c, T = self.config, T_world_grasp
        speed_m_s = min(
            c.unseen_m_s if choice.unseen else c.approach_m_s, self._kept_up_m_s(T, choice)
        )
        if feel_m > 0.0:
            slow_m, way = max(c.guarded_m, feel_m), looked_along(T, self._eye_world, c.aslant_rad)
            begin = T.translation() - slow_m * way
            yield from self._line(T, standoff(T, choice.standoff_m).translation(), begin, speed_m_s)
            yield from self._feel(T, slow_m, feel_m, way)
            return
        yield from self._straight(T, choice.standoff_m, c.guarded_m, speed_m_s, c.blocked_m)
        yield from self._straight(T, c.guarded_m, 0.0, c.guarded_m_s, c.blocked_m)
        yield from self._stay(T.matrix(), c.settle_s)

    def _reach_closed(
        self, T_world_wanted: gtsam.Pose3, goals: Sequence[GraspConfiguration], around: Surroundings
    ) -> Iterator[FloatArray]:
        c, T = self.config, T_world_wanted
        reached = yield from self._free_motion(goals, around)
        self.gripper.close()
        speed_m_s = min(c.approach_m_s, self._kept_up_m_s(T, reached))
        yield from self._straight(T, reached.standoff_m, 0.0, speed_m_s, c.blocked_m)
        self._q_rest = self._drive.state.q

    def _feel(
        self, T_world_grasp: gtsam.Pose3, before_m: float, beyond_m: float, way: FloatArray
    ) -> Iterator[FloatArray]:
        """On along a way (3,) until something stops the hand, and a little back."""
        c, p = self.config, T_world_grasp.translation()
        try:
            start, end = p - before_m * way, p + beyond_m * way
            yield from self._line(T_world_grasp, start, end, c.feel_m_s)
        except GraspFailed:  # what it was looking for
            pass
        here = self.T_world_gripper()
        back = gtsam.Pose3(T_world_grasp.rotation(), here.translation())
        yield from self._stay(standoff(back, c.felt_back_m).matrix(), c.settle_s)

    def _kept_up_m_s(self, T_world_grasp: gtsam.Pose3, choice: GraspConfiguration) -> float:
        """The speed at which the joints' damping holds the hand back by `approach_lag_m`.

        Moving along the unit vector n takes joint speeds J^+ n v. Their damping d is a force
        d (J J^T)^-1 n v at the hand, which the stiffness k makes up for by a lag of

            d v n^T (J J^T)^-1 n / k

        along n: the joints turn fast and have no lever where the arm is near a singularity. The
        worse end of the way counts; nothing is slower than its last, guarded stretch.
        """
        c, n = self.config, np.append(T_world_grasp.rotation().matrix()[:, 2], np.zeros(3))
        held_back = 1e-9  # n^T (J J^T)^-1 n, rad^2/m^2
        for q in (choice.q_pregrasp, choice.q_grasp):
            J = self._kinematics.update(q)[1]
            held_back = max(held_back, float(n @ np.linalg.solve(J @ J.T + REGULAR, n)))
        lag_s = c.impedance.joint_damping * held_back / c.impedance.stiffness_n_m
        return max(c.approach_lag_m / lag_s, c.guarded_m_s)

    def _straight(
        self,
        T_world_goal: gtsam.Pose3,
        from_m: float,
        to_m: float,
        speed_m_s: float,
        blocked_m: float = np.inf,
    ) -> Iterator[FloatArray]:
        """Along the goal's z, from `from_m` behind it to `to_m` behind it.

        Raises:
            GraspFailed: the hand stays behind by more than `blocked_m`: something is in the way.
        """
        start, end = (standoff(T_world_goal, m).translation() for m in (from_m, to_m))
        yield from self._line(T_world_goal, start, end, speed_m_s, blocked_m)

    def _line(
        self,
        T_world_goal: gtsam.Pose3,
        start: FloatArray,
        end: FloatArray,
        speed_m_s: float,
        blocked_m: float | None = None,
    ) -> Iterator[FloatArray]:
        """From a point (3,) to another, turned as the goal is.

        Raises:
            GraspFailed: the hand stays behind by more than `blocked_m`: something is in the way.
        """
        blocked_m = self.config.blocked_m if blocked_m is None else blocked_m
        length_m = float(np.linalg.norm(end - start))
        forward = (end - start) / max(length_m, 1e-9)
        wanted, last = T_world_goal.matrix(), 0.0
        for s in line_motion(length_m, self._drive.step_s, speed_m_s):
            wanted[:3, 3] = start + s * forward
            velocity = (s - last) / self._drive.step_s * forward
            last = s
            tau, error = self._cartesian(wanted, np.concatenate([velocity, np.zeros(3)]))
            if forward @ error[:3] > blocked_m:
                left_m = forward @ (T_world_goal.translation() - wanted[:3, 3] + error[:3])
                raise GraspFailed(_blocked(float(left_m)))
            yield tau

    def _stay(self, T_wanted: FloatArray, duration_s: float) -> Iterator[FloatArray]:
        for _ in range(round(duration_s / self._drive.step_s)):
            yield self._cartesian(T_wanted, np.zeros(6))[0]

    def _close(self, T_world_grasp: gtsam.Pose3) -> Iterator[FloatArray]:
        """Close, with the hand soft sideways so that an off-centre bar moves it, not the part."""
        self.gripper.close()
        wanted, step_s = T_world_grasp.matrix(), self._drive.step_s
        squeezed_s = 0.0
        for _ in range(round(self.config.close_max_s / step_s)):
            yield self._cartesian(wanted, np.zeros(6), self.config.impedance.sideways_n_m)[0]
            squeezed_s += step_s * self.gripper.at_full_force
            if squeezed_s >= self.config.squeeze_s:
                break
        self._q_rest = self._drive.state.q

    def _release(self) -> Iterator[FloatArray]:
        was_closed = self.gripper.squeezing
        self.gripper.open()
        if not was_closed:
            return
        here = self.T_world_gripper()
        yield from self._stay(here.matrix(), self.config.open_s)
        c, back_m = self.config, self.config.reach.standoffs_m[0]
        yield from self._straight(here, 0.0, back_m, c.approach_m_s)
        yield from self._stay(standoff(here, back_m).matrix(), c.settle_s)

    def _pull(self, direction_world: FloatArray, distance_m: float) -> Iterator[FloatArray]:
        T_start = self._sense()[2].copy()
        pull = Pull(direction_world, distance_m, T_start, self.config.pull)
        c = self.config.impedance
        while not pull.finished:
            q, dq, T, J, balance = self._sense()
            wrench = self._wrench = pull.wrench(T, J @ dq, self._drive.step_s)
            yield cartesian_torques(wrench, J, q, dq, self._q_rest, balance, c)

    def _track(self, path: HandPath) -> Iterator[FloatArray]:
        reference = pose_reference(
            path, self._sense()[2], self._drive.step_s, self.config.reference
        )
        tracker = self._tracker = PathTracker(reference, self.config.track)
        while not tracker.finished:
            yield self._tracked(tracker)
        self._tracker = None

    def _tracked(self, tracker: PathTracker) -> FloatArray:
        q, dq, T, J, balance = self._sense()
        self._wrench = tracker.wrench(T, J @ dq, self._drive.step_s)
        return cartesian_torques(
            self._wrench, J, q, dq, self._q_rest, balance, self.config.impedance
        )

    def _fade(self) -> Iterator[FloatArray]:
        """A path that was broken off comes to rest; the last wrench dies away smoothly."""
        tracker, self._tracker = self._tracker, None
        if tracker is not None:
            tracker.brake()
            while not tracker.passed:
                yield self._tracked(tracker)
        c, track = self.config.impedance, self.config.track
        steps = round(self.config.fade_s / self._drive.step_s)
        last = self._wrench
        for k in range(2 * steps):
            q, dq, _, J, balance = self._sense()
            x = min((k + 1) / steps, 1.0)
            left = 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
            twist = J @ dq
            held = np.concatenate(
                [track.damping_n_s_m * twist[:3], track.rotation_damping * twist[3:]]
            )
            wrench = left * last - min(10.0 * x, 1.0) * held
            yield cartesian_torques(wrench, J, q, dq, self._q_rest, balance, c)
        self._wrench = np.zeros(6)


def _blocked(left_m: float) -> str:
    return f"the approach was blocked {1e3 * left_m:.0f} mm before the grasp"
