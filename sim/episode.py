"""Everything needed to run one object: world, arm, camera and the given contact."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from akm_fg.records import FloatArray, JointTruth
from sim.camera import CameraConfig, SimCamera
from sim.franka import FrankaConfig, SimFranka
from sim.noise import NOISE_LEVELS
from sim.world import SimWorld, WorldConfig


@dataclass(frozen=True, slots=True)
class ViewConfig:
    """Where the camera stands, seen from the middle of the closed front."""

    distance_m: float = 1.25
    azimuth_rad: float = np.deg2rad(48.0)  # from the front's normal, so that the arm hides little
    elevation_rad: float = np.deg2rad(33.0)
    ahead_m: float = 0.12  # the camera looks at a point this far in front of the front
    below_m: float = 0.05  # and this far below its middle


@dataclass(frozen=True, slots=True)
class SimEpisode:
    """One object in front of one robot and one camera."""

    world: SimWorld
    arm: SimFranka
    camera: SimCamera
    T_world_grasp: gtsam.Pose3  # the given contact: a grasp of the closed handle
    pull_direction_world: FloatArray  # (3,) unit, out of the front: against the grasp's z

    def truth(self) -> JointTruth:
        """The true joint and its state now. For scoring alone."""
        return self.world.truth()


@contextmanager
def open_world(
    object_name: str,
    seed: int = 0,
    noise: str = "d455",
    *,
    world_config: WorldConfig | None = None,
    franka_config: FrankaConfig | None = None,
    camera_config: CameraConfig | None = None,
    view: ViewConfig | None = None,
) -> Iterator[SimEpisode]:
    """Opens the simulated world of one object and closes it again.

    Args:
        object_name: `door` or `drawer`.
        seed: varies size, place, mass, friction, looks and the camera's noise.
        noise: `clean` or `d455`.
        world_config: physics.
        franka_config: arm and gripper.
        camera_config: image size and rendering; its noise is replaced by `noise`.
        view: where the camera stands.

    Raises:
        ValueError: no such object or noise level.
        MotionInfeasible: no pose of the object can be opened by the arm.
    """
    if noise not in NOISE_LEVELS:
        raise ValueError(f"noise {noise!r}, expected one of {', '.join(NOISE_LEVELS)}")
    config = replace(camera_config or CameraConfig(), noise=NOISE_LEVELS[noise])
    with SimWorld(object_name, seed, world_config) as world:
        arm = SimFranka(world, franka_config)
        T_world_cam = camera_pose(world, view or ViewConfig())
        camera = SimCamera(world, T_world_cam, seed, config)
        grasp = world.placement.T_world_grasp
        outwards = -grasp.rotation().matrix()[:, 2]
        try:
            yield SimEpisode(world, arm, camera, grasp, outwards)
        finally:
            camera.close()


def camera_pose(world: SimWorld, view: ViewConfig) -> gtsam.Pose3:
    """T_world_cam: to one side of the arm and above, looking at the front.

    A door is seen from its hinge side, where its front stays in view while it opens.
    """
    spec, T_world_object = world.spec, world.placement.T_world_object
    right = spec.hinge == "right" if spec.hinge else spec.seed % 2 == 1
    side = 1.0 if right else -1.0
    az, el = view.azimuth_rad, view.elevation_rad
    away = np.array([side * np.sin(az) * np.cos(el), -np.cos(az) * np.cos(el), np.sin(el)])
    depth, height = spec.size_m[1], spec.size_m[2]
    middle = height - spec.front_height_m / 2.0
    target = np.array([0.0, -depth / 2.0 - view.ahead_m, middle - view.below_m])
    eye = T_world_object.transformFrom(target + view.distance_m * away)
    return look_at(eye, T_world_object.transformFrom(target))


def look_at(eye: FloatArray, target: FloatArray) -> gtsam.Pose3:
    """T_world_cam of an upright camera at `eye` that looks at `target`."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return gtsam.Pose3(gtsam.Rot3(np.column_stack([x, np.cross(z, x), z])), eye)
