"""What the arm would do: grasps it can reach and the ways to them, on paper.

The arm and the dry run share this; nothing here moves or connects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.arm.body.collision import Obstacle
from akm_fg.arm.body.description import ArmDescription, franka_description
from akm_fg.arm.body.kinematics import Q_MAX, Q_MIN, FrankaKinematics
from akm_fg.arm.body.silhouette import ArmSilhouette
from akm_fg.arm.motion.aside import aside
from akm_fg.arm.motion.free_motion import RrtConnectPlanner, way_out
from akm_fg.arm.motion.reaching import GraspConfiguration, clear_options, followed
from akm_fg.arm.motion.reference import within_joint_limits
from akm_fg.arm.motion.surroundings import KnownScene, Surroundings
from akm_fg.errors import MotionInfeasible
from akm_fg.hardware.franka.config import FrankaArmConfig
from akm_fg.records import FloatArray, HandPath, RgbdFrame


@dataclass(frozen=True, slots=True)
class PlannedGrasp:
    """The way to a grasp: free motion to the pre-grasp, then straight."""

    waypoints: FloatArray  # (K, 7) rad, straight lines between them, the first where the arm is
    choice: GraspConfiguration


class ArmPlanner:
    """What is known of the place, and the ways in it."""

    def __init__(
        self,
        floor_m: float,
        config: FrankaArmConfig | None = None,
        description: ArmDescription | None = None,
    ) -> None:
        """Knows the floor and the arm's own pedestal.

        Args:
            floor_m: its height, world (the robot's base).
            config: margins, and how hard to look.
            description: of the arm; without one, the Franka of the installed PyBullet's data.

        Raises:
            MissingDependency: no description is given, and none is installed.
            InputError: the description cannot be read.
        """
        self.config = config or FrankaArmConfig()
        self.description = description or franka_description()
        self.kinematics = FrankaKinematics(description=self.description)
        self.scene = KnownScene(floor_m, self.config.around, self.description)
        self.q_limits = Q_MIN.copy(), Q_MAX.copy()
        self._silhouette: ArmSilhouette | None = None  # its meshes are read when it is asked for

    def know(self, obstacles: Sequence[Obstacle]) -> None:
        """Keep clear of things whose shape and place are known beforehand, such as a table."""
        self.scene.know(obstacles)

    @property
    def silhouette(self) -> ArmSilhouette:
        """The arm as a camera sees it."""
        if self._silhouette is None:
            self._silhouette = ArmSilhouette(self.description, self.config.silhouette)
        return self._silhouette

    def grasp(
        self, T_world_grasp: gtsam.Pose3, q: FloatArray, onward: Sequence[gtsam.Pose3] = ()
    ) -> PlannedGrasp:
        """The way from joint angles (7,) to a grasp, from which the hand will go `onward`.

        Raises:
            MotionInfeasible: out of reach, not clear, beyond this robot's joint limits, or no free
                way was found.
        """
        around, possible = self._options(T_world_grasp, onward)
        leaving = self._out_of_touch(around, q)
        problem: MotionInfeasible | None = None
        for choice in possible:
            try:
                waypoints = self._way(around, leaving, choice.q_pregrasp)
            except MotionInfeasible as error:
                problem = problem or error
                continue
            return PlannedGrasp(waypoints, choice)
        assert problem is not None
        raise problem

    def reachable(self, T_world_grasp: gtsam.Pose3, onward: Sequence[gtsam.Pose3]) -> float:
        """Share of the poses that the hand gets to from a grasp, one after the other.

        Raises:
            MotionInfeasible: out of reach, not clear, or beyond this robot's joint limits.
        """
        return self._options(T_world_grasp, onward)[1][0].onward

    def can_follow(self, poses: Sequence[gtsam.Pose3], q: FloatArray) -> int:
        """How many of the poses the hand gets to from joint angles (7,), one after the other."""
        return followed(self.kinematics, poses, q)

    def _options(
        self, T_world_grasp: gtsam.Pose3, onward: Sequence[gtsam.Pose3]
    ) -> tuple[Surroundings, list[GraspConfiguration]]:
        """What is around, and the clear configurations within this robot's limits: at least one."""
        reach = self.config.reach
        around = self.scene.around(T_world_grasp, reach.margins_m[0])
        options = clear_options(self.kinematics, T_world_grasp, around, reach, onward)
        possible = [x for x in options.configurations if self._within(x.q_pregrasp, x.q_grasp)]
        if not possible:
            where = f"the grasp at {np.round(T_world_grasp.translation(), 3)} m"
            raise MotionInfeasible(f"{where} is beyond this robot's joint limits")
        return around, possible

    def out_of_sight(
        self, frame: RgbdFrame, q: FloatArray, T_world_gripper: gtsam.Pose3, unseen: bool
    ) -> FloatArray | None:
        """A way (K, 7) from joint angles (7,) to where the arm hides little; None: stay."""
        config = self.config
        places = aside(self.silhouette, frame, q, config.aside, unseen)
        around = self.scene.around(T_world_gripper, config.reach.margins_m[0])
        try:
            leaving = self._out_of_touch(around, q)
        except MotionInfeasible:
            return None
        for place in places[: config.aside.tried]:
            if np.abs(place - q).max() < config.rest_rad:
                return None
            try:
                return self._way(around, leaving, place)
            except MotionInfeasible:
                continue
        return None

    def path(self, path: HandPath, q: FloatArray) -> HandPath:
        """The path as slow as the joints ask for, from joint angles (7,).

        Raises:
            MotionInfeasible: a pose of it cannot be reached.
        """
        slower = within_joint_limits(self.kinematics, path, q, self.config.reference)
        if slower is None:
            raise MotionInfeasible("a pose of the path is out of the arm's reach")
        poses, checks = slower.T_world_gripper, self.config.reference.checks
        angles = self.kinematics.chain(list(poses[:: max(len(poses) // checks, 1)]), q)
        if angles is None or not self._within(*angles):
            raise MotionInfeasible("a pose of the path is beyond this robot's joint limits")
        return slower

    def _out_of_touch(self, around: Surroundings, q: FloatArray) -> FloatArray:
        """Where the arm touches nothing, from joint angles (7,): those alone, or a way (2, 7).

        Raises:
            MotionInfeasible: no way leads out of what it touches.
        """
        out = way_out(around.free_motion, q)
        return q[np.newaxis] if out is None else np.stack([q, out])

    def _way(self, around: Surroundings, leaving: FloatArray, goal: FloatArray) -> FloatArray:
        """The way (K, 7) to joint angles (7,), after that which leaves what the arm touches.

        The arm stops at every waypoint, so that no corner is cut.

        Raises:
            MotionInfeasible: no free way was found, or it leaves this robot's joint limits.
        """
        planner = RrtConnectPlanner(around.free_motion, self.config.plan)
        waypoints = np.vstack([leaving[:-1], planner.plan(leaving[-1], goal)])
        if not self._within(*waypoints):
            raise MotionInfeasible("the way to the goal is beyond this robot's joint limits")
        return waypoints

    def _within(self, *angles: FloatArray) -> bool:
        low, high = self.q_limits
        return all(bool(np.all((low <= q) & (q <= high))) for q in angles)
