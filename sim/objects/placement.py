"""Where a cabinet stands so that the Franka can grasp its handle and open it all the way.

The builder of the scene may know the joint; the arm and the camera never do. This is for what
is about the time after the grasp: the demo with its given contact, recordings, the arm's own
measures. What must first be found stands where the paper puts it (`sim.objects.published_place`).
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import FrankaKinematics, limit_margin_rad
from akm_fg.arm.motion.reaching import choose_grasp_configuration
from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray
from sim.objects.part_spec import BuiltObject


@dataclass(frozen=True, slots=True)
class PlacementConfig:
    """Where handles may be, in the robot's base frame, and what the arm must reach."""

    handle_x_m: tuple[float, float] = (0.55, 0.78)  # the Franka reaches 0.85 m
    handle_y_m: tuple[float, float] = (-0.25, 0.25)
    yaw_rad: tuple[float, float] = (-0.4, 0.4)  # of the front, from facing the robot
    opening_m: float = 0.40  # the range the benchmark asks for
    opening_rad: float = np.deg2rad(45.0)  # 40 deg and a little
    steps: int = 12  # along the opening
    margin_rad: float = 0.08  # to the soft limits, along the whole opening
    candidates: int = 200


@dataclass(frozen=True, slots=True)
class Placement:
    """A pose of the object and the grasp at its closed handle."""

    T_world_object: gtsam.Pose3
    T_world_grasp: gtsam.Pose3 | None  # None where no contact is given
    floor_m: float = 0.0  # height of the floor: below 0, the robot stands on a pedestal
    plinth_m: float = 0.0  # of what the object stands on, above the floor
    roll_rad: float = 0.0  # of the object about its front's normal; the room stays upright

    def given_grasp(self) -> gtsam.Pose3:
        """T_world_grasp of an object that was placed together with its contact.

        Raises:
            ValueError: no contact is given, as where the paper puts objects.
        """
        if self.T_world_grasp is None:
            raise ValueError("no grasp is given at the published placement, expected 'reachable'")
        return self.T_world_grasp


def opened(built: BuiltObject, state: float) -> gtsam.Pose3:
    """T_object_object': how the part has moved at `state` (m or rad), in the object frame."""
    if built.spec.kind == "prismatic":
        return gtsam.Pose3(gtsam.Rot3(), built.axis_object * state)
    R = gtsam.Rot3.Rodrigues(built.axis_object * state)
    return gtsam.Pose3(R, built.pivot_object - R.matrix() @ built.pivot_object)


def grasp_in_object(built: BuiltObject, flipped: bool) -> gtsam.Pose3:
    """T_object_grasp at the closed handle: z into the front, y across the bar."""
    turn = gtsam.Rot3.Rz(np.pi) if flipped else gtsam.Rot3()
    return built.T_object_handle * gtsam.Pose3(turn, np.zeros(3))


def place(
    built: BuiltObject, kinematics: FrankaKinematics, config: PlacementConfig | None = None
) -> Placement:
    """The first of the seed's random poses from which the Franka can open the part.

    Raises:
        MotionInfeasible: none of the candidates will do.
    """
    config = config or PlacementConfig()
    rng = np.random.default_rng([built.spec.seed, 5])
    for _ in range(config.candidates):
        T_world_object = _candidate(built, rng, config)
        for flipped in (False, True):
            T_object_grasp = grasp_in_object(built, flipped)
            if _can_open(built, T_world_object, T_object_grasp, kinematics, config):
                return Placement(T_world_object, T_world_object * T_object_grasp)
    raise MotionInfeasible(
        f"{built.spec.name} {built.spec.seed}: no pose of {config.candidates} can be opened"
    )


def _candidate(
    built: BuiltObject, rng: np.random.Generator, config: PlacementConfig
) -> gtsam.Pose3:
    """An upright pose that puts the handle into the config's region, front to the robot."""
    yaw = -np.pi / 2 + rng.uniform(*config.yaw_rad)
    handle = np.array([rng.uniform(*config.handle_x_m), rng.uniform(*config.handle_y_m)])
    R = gtsam.Rot3.Rz(yaw)
    offset = (R.matrix() @ built.T_object_handle.translation())[:2]
    return gtsam.Pose3(R, np.array([*(handle - offset), 0.0]))


def _can_open(
    built: BuiltObject,
    T_world_object: gtsam.Pose3,
    T_object_grasp: gtsam.Pose3,
    kinematics: FrankaKinematics,
    config: PlacementConfig,
) -> bool:
    choice = choose_grasp_configuration(kinematics, T_world_object * T_object_grasp)
    if choice is None:
        return False
    full = config.opening_m if built.spec.kind == "prismatic" else config.opening_rad
    poses = [
        T_world_object * opened(built, float(q)) * T_object_grasp
        for q in np.linspace(0.0, full, config.steps)[1:]
    ]
    path: list[FloatArray] | None = kinematics.chain(poses, choice.q_grasp)
    return path is not None and min(limit_margin_rad(q) for q in path) > config.margin_rad
