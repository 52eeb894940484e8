"""Where the paper puts an object: in front of the base, whatever the arm can do there.

Nobody looks whether the arm can open the part, and no grasp is given: an object that stands badly
counts as one that was not opened. The ranges are those of the authors' settings (DESIGN.md,
Measures); the scale, 0.9 to 1.1, is in the object's spec already.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from sim.objects.part_spec import BuiltObject
from sim.objects.placement import Placement

STREAM = 6  # of the random numbers, beside those of other placements


@dataclass(frozen=True, slots=True)
class PublishedPlaceConfig:
    """The paper's ranges, in the robot's base frame; the robot stands on the ground."""

    front_x_m: tuple[float, float] = (0.5, 0.7)  # from the base to the middle of the front
    yaw_rad: tuple[float, float] = (-0.2, 0.2)  # of the front, from facing the robot
    roll_rad: tuple[float, float] = (-0.05, 0.05)  # about the front's normal
    above_m: tuple[float, float] = (0.01, 0.05)  # of the lowest corner, above the ground


def place_as_published(built: BuiltObject, config: PublishedPlaceConfig | None = None) -> Placement:
    """The pose of the object's name and seed; the joint plays no part in it.

    The front is that of the whole object's box. Its middle stands straight before the base.
    """
    config, spec = config or PublishedPlaceConfig(), built.spec
    rng = np.random.default_rng([*spec.name.encode(), spec.seed, STREAM])
    ranges = (config.front_x_m, config.yaw_rad, config.roll_rad, config.above_m)
    x, yaw, roll, above = (float(rng.uniform(*limits)) for limits in ranges)
    width, depth, _ = spec.size_m.tolist()
    R = gtsam.Rot3.Rz(-np.pi / 2 + yaw) * gtsam.Rot3.Ry(roll)
    front = R.matrix() @ np.array([0.0, -depth / 2.0, 0.0])
    height = above + width / 2.0 * abs(np.sin(roll))
    T_world_object = gtsam.Pose3(R, np.array([x - front[0], -front[1], height]))
    return Placement(T_world_object, None, plinth_m=height, roll_rad=roll)
