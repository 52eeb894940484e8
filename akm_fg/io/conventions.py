"""What a person says of the poses and the depth of a recording, and what that changes.

Inside, a camera has x right, y down, z forward (OpenCV), and its pose is T_world_cam. OpenGL's
camera looks along -z with y up: T_world_cam = T_world_gl diag(1, -1, -1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np

from akm_fg.records import FloatArray

Axes = Literal["opencv", "opengl"]
Up = Literal["x", "y", "z", "-x", "-y", "-z"]

GL_FROM_CV = gtsam.Pose3(gtsam.Rot3(np.diag([1.0, -1.0, -1.0])), np.zeros(3))
"""Coordinates in a camera with OpenGL's axes of a point in one with OpenCV's; its own inverse."""


@dataclass(frozen=True, slots=True)
class InputConventions:
    """None: as the format says, or found out from what is seen, and reported where it is a guess.

    A recording folder (recording.json) says all but `up` itself; what is given here goes before.
    """

    convention: Axes | None = None  # of the camera whose poses are given
    invert_pose: bool | None = None  # True: poses are T_cam_world
    up: Up | None = None  # direction in the world's coordinates that points up
    depth_unit_m: float | None = None  # metres a unit of stored depth

    def __post_init__(self) -> None:
        unit = self.depth_unit_m
        if unit is not None and not (np.isfinite(unit) and unit > 0):
            raise ValueError(f"depth_unit_m is {unit}, must be a positive number of metres")

    @property
    def up_world(self) -> FloatArray | None:
        """(3,) unit vector, None where nobody said."""
        return None if self.up is None else direction(self.up)

    def T_world_cam(self, given: gtsam.Pose3) -> gtsam.Pose3:
        """The pose with our axes of a camera whose pose is given in these conventions."""
        T_world_given = given.inverse() if self.invert_pose else given
        return T_world_given * GL_FROM_CV if self.convention == "opengl" else T_world_given


def direction(up: Up) -> FloatArray:
    """(3,) unit vector of an axis by its name."""
    vector = np.zeros(3)
    vector["xyz".index(up[-1])] = -1.0 if up.startswith("-") else 1.0
    return vector
