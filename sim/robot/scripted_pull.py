"""Moves a part and the robot by hand, without physics. FOR GENERATING DATA ONLY.

The part's joint is set to given states and the Franka's joints to those at which its gripper
holds the handle there, so that it occludes the scene as in a real pull. This knows the joint: it
writes recordings for tests and tuning, and no part of the program uses it.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from akm_fg.arm.motion.reaching import ReachConfig, choose_grasp_configuration
from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray
from sim.bullet import p
from sim.objects.placement import opened
from sim.robot.contacts import finger_links, nearby
from sim.world import SimWorld

STEP_MAX = 0.05  # m or rad between neighbouring poses of the inverse kinematics
TOUCH_M = 0.0005  # between a finger and the handle
DEEP_M = 0.004  # an overlap of robot and object that is more than a touch
CLEAR_LINKS = 7  # of the arm, counted from its base, that must not overlap the object


class ScriptedPull:
    """Poses of part and robot along an opening, found in advance."""

    def __init__(
        self, world: SimWorld, T_world_grasp: gtsam.Pose3, states: Sequence[float]
    ) -> None:
        """Finds the arm's joint angles along `states` (growing, from 0).

        Raises:
            MotionInfeasible: the arm cannot follow, or would go through the object.
        """
        self._world = world
        self._fingers = finger_links(world.client, world.robot_id)
        self.states = np.asarray(states, dtype=float)
        self._path = self._solve(T_world_grasp)
        for i in (0, len(self.states) // 2, -1):
            self.show(i)
            depth = self.overlap_m()
            if depth > DEEP_M:
                raise MotionInfeasible(f"the arm would be {1e3 * depth:.0f} mm inside the object")
        self.show(0)

    def show(self, i: int) -> None:
        """Puts part and robot where they are at state `i`."""
        world = self._world
        p.resetJointState(
            world.object_id, world.part_joint, self.states[i], physicsClientId=world.client
        )
        half = world.built.handle_thickness_m / 2.0 + TOUCH_M
        for joint, q in [*enumerate(self._path[i]), *((f, half) for f in self._fingers)]:
            p.resetJointState(world.robot_id, joint, float(q), physicsClientId=world.client)

    def T_world_gripper(self, i: int) -> gtsam.Pose3:
        """The gripper's pose at state `i`, from the arm's joint angles."""
        return self._world.kinematics.T_world_gripper(self._path[i])

    def overlap_m(self) -> float:
        """How deep the arm (not its hand) is inside the object now; 0 where it is not."""
        world = self._world
        p.performCollisionDetection(physicsClientId=world.client)
        points = nearby(world.client, world.robot_id, world.object_id, 0.0)
        return max((-point.distance_m for point in points if point.link < CLEAR_LINKS), default=0.0)

    def _solve(self, T_world_grasp: gtsam.Pose3) -> list[FloatArray]:
        world, T = self._world, self._world.placement.T_world_object
        start = choose_grasp_configuration(world.kinematics, T_world_grasp, ReachConfig())
        if start is None:
            raise MotionInfeasible("the handle is out of the arm's reach")
        path, q, before = [start.q_grasp], start.q_grasp, 0.0
        for state in self.states[1:]:
            steps = int(np.ceil((state - before) / STEP_MAX)) + 1
            between = np.linspace(before, state, steps)[1:]
            poses = [
                T * opened(world.built, float(s)) * T.inverse() * T_world_grasp for s in between
            ]
            chain = world.kinematics.chain(poses, q)
            if chain is None:
                raise MotionInfeasible(f"the arm cannot follow the handle to state {state:.3f}")
            path.append(chain[-1])
            q, before = chain[-1], float(state)
        return path
