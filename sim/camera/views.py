"""Where the camera stands."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.records import FloatArray
from sim.world import SimWorld


@dataclass(frozen=True, slots=True)
class ViewConfig:
    """Where the camera stands, seen from the middle of the closed front."""

    distance_m: float = 1.25
    azimuth_rad: float = np.deg2rad(48.0)  # from the front's normal, so that the arm hides little
    elevation_rad: float = np.deg2rad(33.0)
    low_elevation_rad: float = np.deg2rad(14.0)  # instead, where the front turns down
    ahead_m: float = 0.12  # the camera looks at a point this far in front of the front
    below_m: float = 0.05  # and this far below its middle


@dataclass(frozen=True, slots=True)
class FixedViewConfig:
    """The paper's camera: beside the robot's base, about a metre high, for every object alike.

    The lens belongs to the place, because the whole object is to be in view: the paper's opens
    90 deg upright. A D455 measures depth within 59 deg upright (848 x 480 at 425 px); this camera
    has that field, of which it takes the middle columns, and stands back until the tallest and
    the widest objects at their nearest place fit into it (`tests/sim/camera/test_views.py`).
    From 30 deg off the base's axis it still sees, at 70 deg of incidence, the front of a door
    that has its hinge on the other side and stands open by 40 deg.
    """

    eye_m: tuple[float, float, float] = (-0.60, 0.70, 1.10)  # in the robot's base frame
    target_m: tuple[float, float, float] = (0.60, 0.225, 0.58)
    upright_field_rad: float = 2.0 * float(np.arctan(240.0 / 425.0))

    def focal_px(self, height_px: int) -> float:
        """Focal length of an image that is so high."""
        return height_px / 2.0 / float(np.tan(self.upright_field_rad / 2.0))


def fixed_view(view: FixedViewConfig) -> gtsam.Pose3:
    """T_world_cam, from nothing but where the robot stands."""
    return look_at(np.array(view.eye_m), np.array(view.target_m))


def sample_view(rng: np.random.Generator, front_m: float) -> ViewConfig:
    """A view as people set up a camera: about the default, never twice the same.

    Args:
        rng: source of randomness.
        front_m: larger side of the part's front; a large one is seen from farther away.
    """
    return ViewConfig(
        distance_m=rng.uniform(1.0, 1.4) + 0.7 * max(front_m - 0.45, 0.0),
        azimuth_rad=np.deg2rad(rng.uniform(36.0, 56.0)),
        elevation_rad=np.deg2rad(rng.uniform(24.0, 40.0)),
        low_elevation_rad=np.deg2rad(rng.uniform(8.0, 18.0)),
    )


def camera_pose(world: SimWorld, view: ViewConfig) -> gtsam.Pose3:
    """T_world_cam: to one side of the arm and above, looking at the front.

    A door is seen from its hinge side, where its front stays in view while it opens; any other
    front from the side on which the robot does not stand.
    """
    built, T_world_object = world.built, world.placement.T_world_object
    az = view.azimuth_rad
    el = view.low_elevation_rad if built.view_low else view.elevation_rad
    robot_x = float(T_world_object.transformTo(np.zeros(3))[0])
    side = built.spec.view_side or (-1.0 if robot_x > 0.0 else 1.0)
    across = side * np.sin(az) * np.cos(el)
    away = np.array([across, -np.cos(az) * np.cos(el), np.sin(el)])
    target = built.p_object_front + np.array([0.0, -view.ahead_m, -view.below_m])
    eye = T_world_object.transformFrom(target + view.distance_m * away)
    return look_at(eye, T_world_object.transformFrom(target))


def look_at(eye: FloatArray, target: FloatArray) -> gtsam.Pose3:
    """T_world_cam of an upright camera at `eye` that looks at `target`."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return gtsam.Pose3(gtsam.Rot3(np.column_stack([x, np.cross(z, x), z])), eye)
