"""What is around a grasp, for the two parts of the way to it.

In free motion the whole arm keeps clear of everything that is there and of everything that may be.
On the straight approach hand and fingers come near to what is grasped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np

from akm_fg.arm.body.collision import ArmCollisions, Obstacle
from akm_fg.arm.body.description import ArmDescription
from akm_fg.arm.body.model import FINGERS, HAND
from akm_fg.arm.motion.obstacle_map import MapConfig, ObstacleMap, map_from_frame, own_surroundings
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

WRIST = "panda_link7"  # carries the hand, and goes where it goes


@dataclass(frozen=True, slots=True)
class AroundConfig:
    """The maps of what a camera sees, and the hand's room at a grasp."""

    obstacles: MapConfig = field(default_factory=MapConfig)
    room_radius_m: float = 0.14  # about the approach, where the hand may come near to what is
    room_ahead_m: float = 0.05  # seen of handle and front; the palm stops 47 mm before the grasp
    near_m: float = 0.40  # half side of a finer map around the grasp, for hand and wrist
    near_voxel_m: float = 0.01


@dataclass(frozen=True, slots=True)
class GraspRoom:
    """Where a grasped handle and the front behind it are: before the palm, about its axis.

    What sticks out farther than the palm comes, such as a table top above, is not in it.
    """

    T_world_grasp: gtsam.Pose3
    radius_m: float  # about the gripper's z
    ahead_m: float  # of the grasp point, against the gripper's z: where the room begins

    def holds(self, p_world: FloatArray) -> BoolArray:
        """(N,) which points (N, 3) are in it."""
        T = self.T_world_grasp
        p_grasp = (p_world - T.translation()) @ T.rotation().matrix()
        aside = np.linalg.norm(p_grasp[:, :2], axis=1)
        return np.asarray((p_grasp[:, 2] > -self.ahead_m) & (aside < self.radius_m))


@dataclass(frozen=True, slots=True)
class SeenAround:
    """What a camera saw: all that the arm can reach, and finer what is around a grasp."""

    everything: ObstacleMap
    near: ObstacleMap


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The obstacles of one grasp, as the two parts of the way to it have to respect them."""

    free_motion: ArmCollisions  # the whole arm
    approach: ArmCollisions  # fingers anywhere, the hand before handle and front
    unseen: ArmCollisions | None  # what nobody has seen, and the hand may yet enter

    def set_margin(self, margin_m: float) -> None:
        """Changes the distance that the arm keeps from obstacles."""
        for collisions in (self.free_motion, self.approach, self.unseen):
            if collisions is not None:
                collisions.set_margin(margin_m)


def surroundings(
    known: list[Obstacle],
    seen: SeenAround | None,
    T_world_grasp: gtsam.Pose3,
    config: AroundConfig,
    margin_m: float,
    modelled: Sequence[Obstacle] = (),
    description: ArmDescription | None = None,
) -> Surroundings:
    """The arm among obstacles, for the way to a grasp.

    A handle is taken where somebody expects room for fingers and hand. So hand and wrist may
    enter, on the straight approach alone, what the camera could not see; they keep clear of the
    surfaces that it did see, but for handle and front before the palm.

    Args:
        known: what the arm need not see.
        seen: what a camera saw; None where none has looked.
        T_world_grasp: where the hand will close.
        config: of the hand's room.
        margin_m: that the arm keeps from all of it.
        modelled: of exactly known shape and place; on the approach the hand may come near them.
        description: of the arm; without one, the Franka of the installed PyBullet's data.
    """

    def arm_among(obstacles: Sequence[Obstacle]) -> ArmCollisions:
        return ArmCollisions(obstacles, margin_m, description=description)

    hand = (HAND, *FINGERS)
    whole = seen.everything.obstacle() if seen else None
    approach = [*known, *(replace(obstacle, spared=hand) for obstacle in modelled)]
    if whole is not None:
        approach.append(replace(whole, spared=(WRIST, *hand)))
    unseen = None
    if seen is not None:
        room = GraspRoom(T_world_grasp, config.room_radius_m, config.room_ahead_m)
        surface, near = seen.near.surface, seen.near
        outside = near.obstacle(surface & ~room.holds(near.p_world))
        if outside is not None:
            approach.append(replace(outside, spared=FINGERS))
        hidden = near.obstacle(~surface)
        if hidden is not None:
            unseen = arm_among([replace(hidden, spared=FINGERS)])
    return Surroundings(
        arm_among([*known, *modelled, *([whole] if whole else [])]),
        arm_among(approach),
        unseen,
    )


MakeMap = Callable[[RgbdFrame, FloatArray, float, MapConfig, ArmDescription | None], ObstacleMap]
"""A frame, the arm's joint angles (7,) in it, the floor's height, a config, the arm -> the map."""


class KnownScene:
    """What the arm has been told and shown of the place where it stands."""

    def __init__(
        self,
        floor_m: float,
        config: AroundConfig | None = None,
        description: ArmDescription | None = None,
        make_map: MakeMap = map_from_frame,
    ) -> None:
        """Knows nothing yet but the place where the robot was set up.

        Args:
            floor_m: height of the floor, world.
            config: of the maps, and of the hand's room.
            description: of the arm; without one, the Franka of the installed PyBullet's data.
            make_map: makes an obstacle map of a frame.
        """
        self.description, self._make_map = description, make_map
        self._own = own_surroundings(floor_m)
        self._floor_m = floor_m
        self._config = config or AroundConfig()
        self._modelled: tuple[Obstacle, ...] = ()
        self._frame: tuple[RgbdFrame, FloatArray, ObstacleMap] | None = None

    def see(self, frame: RgbdFrame, q: FloatArray) -> None:
        """What this frame shows is there, and what it cannot show behind it may be.

        The robot's own pixels carry no depth; `q` (7,) rad are its joint angles in it.
        """
        self._frame = (frame, q, self._map(frame, q, self._config.obstacles))

    def know(self, obstacles: Sequence[Obstacle]) -> None:
        """These are there too, of exactly known shape and place."""
        self._modelled = tuple(obstacles)

    def around(self, T_world_grasp: gtsam.Pose3, margin_m: float) -> Surroundings:
        """The obstacles on the way to a grasp; see `surroundings`."""
        seen, config = None, self._config
        if self._frame is not None:
            frame, q, everything = self._frame
            near = config.obstacles.near(
                T_world_grasp.translation(), config.near_m, config.near_voxel_m
            )
            seen = SeenAround(everything, self._map(frame, q, near))
        return surroundings(
            self._own, seen, T_world_grasp, config, margin_m, self._modelled, self.description
        )

    def _map(self, frame: RgbdFrame, q: FloatArray, config: MapConfig) -> ObstacleMap:
        return self._make_map(frame, q, self._floor_m, config, self.description)
