"""How far a grasp has slipped, from the simulator's truth. FOR SCORING ALONE.

A friction grasp turns and slides a little on the handle. The robot cannot know by how much: it
knows its hand's pose, not the part's. Nothing here may reach the estimator or the arm.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from sim.objects.placement import opened
from sim.world import SimWorld


@dataclass(frozen=True, slots=True)
class Slip:
    """How the hand has moved in the part."""

    translation_m: float  # of the point between the fingertips
    rotation_rad: float


def true_part_pose(world: SimWorld) -> gtsam.Pose3:
    """T_world_part: the object's pose, moved by the part's true state."""
    return world.placement.T_world_object * opened(world.built, world.part_state())


class SlipGauge:
    """Made when the hand has taken hold; tells from then on how it has moved in the part."""

    def __init__(self, world: SimWorld, T_world_gripper: gtsam.Pose3) -> None:
        self._world = world
        self._T_part_grasp = true_part_pose(world).between(T_world_gripper)

    def slip(self, T_world_gripper: gtsam.Pose3) -> Slip:
        """How the hand, now at `T_world_gripper`, has moved since it took hold."""
        moved = self._T_part_grasp.between(true_part_pose(self._world).between(T_world_gripper))
        turn = gtsam.Rot3.Logmap(moved.rotation())
        return Slip(float(np.linalg.norm(moved.translation())), float(np.linalg.norm(turn)))
