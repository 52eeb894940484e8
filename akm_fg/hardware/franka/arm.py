"""A real Franka behind `akm_fg.interfaces.Arm`. Motions execute while iterated.

What plans is `akm_fg.arm`; what moves is the robot's own motion generator in free space, and a
spring whose end goes as the laws of `akm_fg.arm` say wherever something may be touched. Whatever
ends a motion early, the caller's own error too, leaves the arm at rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import TracebackType

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import FrankaKinematics
from akm_fg.arm.depth_from_arm import (
    DepthCorrection,
    DepthFromArmConfig,
    MeasuringCamera,
    correct_by_arm,
)
from akm_fg.arm.motion.pulling import Pull
from akm_fg.arm.motion.reaching import standoff
from akm_fg.arm.motion.reference import pose_reference
from akm_fg.arm.motion.tracking import PathTracker
from akm_fg.errors import ArmStopped, GraspFailed
from akm_fg.hardware.franka.compliance import SpringOfWrench
from akm_fg.hardware.franka.control import HandControl
from akm_fg.hardware.franka.guarded import GuardedHand
from akm_fg.hardware.franka.hand_frame import checked_hand
from akm_fg.hardware.franka.legs import leg_limits
from akm_fg.hardware.franka.link import FrankaLink
from akm_fg.hardware.franka.planning import ArmPlanner
from akm_fg.records import CalibrationErrors, FloatArray, HandPath, RgbdFrame


class FrankaArm:
    """A context manager: connects, and leaves the arm at rest. World is the robot's base."""

    def __init__(self, host: str, planner: ArmPlanner) -> None:
        """Connects to nothing yet.

        Args:
            host: address of the robot's control interface.
            planner: what is known of the place, with the arm's settings.

        Raises:
            MissingDependency: `franky-control` is not installed.
        """
        self.config, self._planner = planner.config, planner
        self._link = FrankaLink(host, self.config)
        self._closed = False
        self._eye_world: FloatArray | None = None  # of the camera that took what was seen

    def __enter__(self) -> FrankaArm:
        """Connects, and compares the robot with its description.

        Raises:
            ArmStopped: no robot, or not the one that is described.
        """
        self._link.__enter__()
        try:
            self._planner.q_limits = self._link.joint_limits()
            T_ee_gripper = checked_hand(self._link.state(), self._planner.kinematics, self.config)
            kinematics = FrankaKinematics(description=self._planner.description)
            control = HandControl(self._link, kinematics, T_ee_gripper, self.config)
            self._hand = GuardedHand(control, self._planner.kinematics)
        except BaseException:
            self._link.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._link.__exit__(kind, error, trace)

    @property
    def link(self) -> FrankaLink:
        """The connection, for whoever checks it."""
        return self._link

    def measured_joints(self) -> tuple[FloatArray, FloatArray]:
        """Joint angles (7,) rad and speeds (7,) rad/s."""
        state = self._link.state()
        return state.q, state.dq

    def T_world_gripper(self) -> gtsam.Pose3:
        """The measured gripper pose (forward kinematics of the measured joints)."""
        return self._planner.kinematics.T_world_gripper(self.measured_joints()[0])

    def see(self, frame: RgbdFrame) -> None:
        """Keep clear, from now on, of what this frame shows and of what it cannot show behind it.

        The frame is of this moment, the robot's own pixels carry no depth.
        """
        self._planner.scene.see(frame, self.measured_joints()[0])
        self._eye_world = frame.T_world_cam.translation()

    def masked(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame without this arm, which is where it was when the frame was taken."""
        q = self.measured_joints()[0]
        return self._planner.silhouette.masked(frame, q, self._link.fingers_m() / 2.0)

    def correct_depth_of(
        self, camera: MeasuringCamera, errors: CalibrationErrors, config: DepthFromArmConfig
    ) -> DepthCorrection | None:
        """Correct the depth of a camera that sees this arm at rest; see `correct_by_arm`."""
        q, fingers_m = self.measured_joints()[0], self._link.fingers_m() / 2.0
        return correct_by_arm(camera, self._planner.description, q, fingers_m, errors, config)

    def holding(self) -> bool:
        """Whether something is between the closed fingers."""
        return self._closed and self._link.fingers_m() > self.config.grasp.nothing_m

    def reachable(self, T_world_grasp: gtsam.Pose3, onward: Sequence[gtsam.Pose3] = ()) -> float:
        """Share of the poses that the hand gets to from a grasp, one after the other.

        Raises:
            MotionInfeasible: the grasp cannot be reached, or not without touching something.
        """
        return self._planner.reachable(T_world_grasp, onward)

    def can_follow(self, poses: Sequence[gtsam.Pose3]) -> int:
        """How many of the poses the hand gets to from where it is, one after the other."""
        return self._planner.can_follow(poses, self.measured_joints()[0])

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
            ArmStopped: the robot has stopped by itself, or the connection is lost.
        """
        start = self._where_it_starts()
        self._planner.grasp(T_world_grasp, start, onward)  # refused before it moves
        yield from self._release(tick_s)
        planned = self._planner.grasp(T_world_grasp, self.measured_joints()[0], onward)
        yield from self._along(planned.waypoints, tick_s)
        yield from self._hand.approach(
            T_world_grasp, planned.choice, feel_m, self._eye_world, tick_s
        )
        c = self.config
        self._hand.expect(c.held_reflex)
        self._closed = True
        self._link.close_fingers()
        yield from self._hand.control.hold(c.stiff, c.grasp.patience_s, tick_s)
        if not self.holding():
            raise GraspFailed("the fingers met with nothing between them")

    def close_and_reach(
        self, T_world_wanted: gtsam.Pose3, tick_s: float, onward: Sequence[gtsam.Pose3] = ()
    ) -> Iterator[None]:
        """Let go, and move clear of what was seen to a pose, with closed fingers.

        Raises:
            MotionInfeasible: the pose cannot be reached, or not without touching something.
            GraspFailed: something was met on the way.
            ArmStopped: as `grasp`.
        """
        self._planner.grasp(T_world_wanted, self._where_it_starts(), onward)  # refused at rest
        yield from self._release(tick_s)
        planned = self._planner.grasp(T_world_wanted, self.measured_joints()[0], onward)
        yield from self._along(planned.waypoints, tick_s)
        c = self.config
        self._closed = True
        self._link.close_fingers()
        yield from self._hand.control.hold(c.stiff, c.grasp.patience_s, tick_s)
        yield from self._hand.approach(T_world_wanted, planned.choice, 0.0, None, tick_s)

    def step_aside(self, frame: RgbdFrame, tick_s: float, unseen: bool = False) -> Iterator[None]:
        """Let go, and go where the arm hides little from the camera that took the frame.

        With `unseen`, little of what this frame does not show.
        Stays where it is after letting go if no such place is within reach without touching
        anything.

        Raises:
            ArmStopped: as `grasp`.
        """
        yield from self._release(tick_s)
        q = self.measured_joints()[0]
        way = self._planner.out_of_sight(frame, q, self.T_world_gripper(), unseen)
        if way is None:
            return
        try:
            yield from self._along(way, tick_s)
        except GraspFailed as error:
            raise ArmStopped(f"{error} aside: look at what it touches, and start again") from error

    def pull(self, direction_world: FloatArray, distance_m: float, tick_s: float) -> Iterator[None]:
        """Pull gently, starting along a unit vector, and follow where the part lets the hand go.

        Ends after `distance_m` of travelled path, or when the part does not give.

        Raises:
            ArmStopped: as `grasp`.
        """
        start = self.T_world_gripper().matrix()
        law = Pull(direction_world, distance_m, start, self.config.pull)
        spring = self.config.pulling
        inner = SpringOfWrench(law, spring, self.config.period_s)
        yield from self._hand.held(inner, spring, tick_s)

    def relax(self, tick_s: float) -> Iterator[None]:
        """After a motion that was not iterated to its end: come to rest, and let the force fade.

        Raises:
            ArmStopped: as `grasp`.
        """
        self._hand.rest()
        yield from ()

    def follow(self, path: HandPath, tick_s: float) -> Iterator[None]:
        """Follow a path compliantly, and wait until the arm has come to rest.

        The path takes longer than asked where the joints' limits ask for it.

        Raises:
            MotionInfeasible: a pose of the path cannot be reached.
            ArmStopped: as `grasp`.
        """
        c = self.config
        slower = self._planner.path(path, self.measured_joints()[0])
        start = self.T_world_gripper().matrix()
        reference = pose_reference(slower, start, c.period_s, c.reference)
        inner = SpringOfWrench(PathTracker(reference, c.track), c.following, c.period_s)
        yield from self._hand.held(inner, c.following, tick_s)

    def _where_it_starts(self) -> FloatArray:
        """Joint angles from which a grasp is planned: those after letting go."""
        q = self.measured_joints()[0]
        if not self._closed:
            return q
        back = standoff(self.T_world_gripper(), self.config.reach.standoffs_m[0])
        after = self._planner.kinematics.solve(back, q)
        return q if after is None else after

    def _along(self, waypoints: FloatArray, tick_s: float) -> Iterator[None]:
        """Free motion along waypoints (K, 7) rad, from rest to rest at each.

        Raises:
            GraspFailed: the arm stays behind: it has met something.
        """
        self._hand.expect(self.config.free_reflex)
        q = waypoints[0]
        for goal in waypoints[1:]:
            self._link.go(goal, leg_limits(goal - q, self.config.time_law))
            try:
                yield from self._watched(tick_s)
            finally:
                self._link.stop()
            q = goal

    def _watched(self, tick_s: float) -> Iterator[None]:
        """Until the motion has ended; times are the robot's.

        Raises:
            GraspFailed: the arm stays behind.
        """
        c = self.config
        now_s = well_s = ticked_s = self._link.state().time_s
        while not self._link.done(c.look_s):
            state = self._link.state()
            now_s = state.time_s
            if np.abs(state.q_wanted - state.q).max() < c.met_rad:
                well_s = now_s
            if now_s - well_s > c.met_s:
                raise GraspFailed("the arm met something on its way")
            if now_s - ticked_s >= tick_s:
                ticked_s = now_s
                yield

    def _release(self, tick_s: float) -> Iterator[None]:
        """Open, and where something was held, back out of it."""
        c, was_closed = self.config, self._closed
        if not was_closed and self._link.fingers_m() > c.grasp.open_m - c.grasp.nothing_m:
            return
        self._hand.expect(c.held_reflex)
        self._link.open_fingers()
        yield from self._hand.control.hold(c.stiff, c.grasp.patience_s, tick_s)
        self._closed = False
        if was_closed:
            back_m, here = c.reach.standoffs_m[0], self.T_world_gripper()
            yield from self._hand.straight(here, 0.0, back_m, c.approach.speed_m_s, tick_s)
