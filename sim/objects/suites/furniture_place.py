"""Where a piece of furniture stands: about a metre away, at many heights, turned a little.

Low ones stand on a plinth; for tall ones the robot stands on a pedestal. The Franka must be able
to follow the handle over the benchmark's whole range (the builder of the scene may know the
joint; the arm and the camera never do).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import FrankaKinematics, limit_margin_rad
from akm_fg.arm.motion.reaching import ReachConfig, choose_grasp_configuration
from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray
from sim.objects.part_spec import BuiltObject
from sim.objects.placement import Placement, opened


class HandleStyled(Protocol):
    """A handle or another place to grip."""

    @property
    def style(self) -> str:
        """`edge` is a board pinched from the side."""


class PlaceableSpec(Protocol):
    """What is asked of an object to place it."""

    @property
    def name(self) -> str:
        """For errors."""

    @property
    def key(self) -> tuple[int, ...]:
        """Of the object; with the seed, of the poses that are tried."""

    @property
    def seed(self) -> int:
        """Of the meeting."""

    @property
    def upper(self) -> float:
        """End of the range, m or rad."""

    @property
    def handle(self) -> HandleStyled:
        """Where it is gripped."""


@dataclass(frozen=True, slots=True)
class FurniturePlaceConfig:
    """Where handles may be, in the robot's base frame, and what the arm must reach."""

    handle_x_m: tuple[float, float] = (0.50, 0.80)  # the Franka reaches 0.85 m
    handle_y_m: tuple[float, float] = (-0.35, 0.35)
    handle_z_m: tuple[float, float] = (0.15, 0.65)
    pedestal_max_m: float = 0.9  # of the robot, above the floor
    plinth_max_m: float = 0.7  # of the object
    yaw_rad: tuple[float, float] = (-0.45, 0.45)  # of the front, from facing the robot
    tilts_rad: tuple[float, ...] = (0.0, 0.35, -0.35)  # of the grasp about the bar
    # Within a board's plane: the palm's corner stays a centimetre from the edge that the fingers
    # pinch 18 mm behind; at 0.8 rad it would touch.
    edge_tilts_rad: tuple[float, ...] = (0.0, 0.4, -0.4, 0.5, -0.5)
    opening_m: float = 0.40  # the benchmark's ranges
    opening_rad: float = np.deg2rad(40.0)
    steps: int = 9  # along the opening
    margin_rad: float = 0.05  # to the soft limits, along the whole opening
    candidates: int = 150
    reach: ReachConfig = field(default_factory=lambda: ReachConfig(starts=4))


def place_furniture(
    built: BuiltObject,
    spec: PlaceableSpec,
    kinematics: FrankaKinematics,
    config: FurniturePlaceConfig | None = None,
) -> Placement:
    """The first of the seed's random poses from which the Franka can open the part.

    Raises:
        MotionInfeasible: none of the candidates will do.
    """
    config = config or FurniturePlaceConfig()
    rng = np.random.default_rng([*spec.key, spec.seed, 5])
    for _ in range(config.candidates):
        T_world_object, floor_m, plinth_m = _candidate(built, rng, config)
        if floor_m < -config.pedestal_max_m or plinth_m > config.plinth_max_m:
            continue
        for T_object_grasp in grasps_at_handle(built, spec, config):
            if can_open(built, T_world_object, T_object_grasp, kinematics, config):
                T_world_grasp = T_world_object * T_object_grasp
                return Placement(T_world_object, T_world_grasp, floor_m, plinth_m)
    raise MotionInfeasible(
        f"{spec.name} (seed {spec.seed}): no pose of {config.candidates} can be opened"
    )


def _candidate(
    built: BuiltObject, rng: np.random.Generator, config: FurniturePlaceConfig
) -> tuple[gtsam.Pose3, float, float]:
    """An upright pose with the handle in the config's region; heights of floor and plinth."""
    R = gtsam.Rot3.Rz(-np.pi / 2 + rng.uniform(*config.yaw_rad))
    x, y, z = (rng.uniform(*c) for c in (config.handle_x_m, config.handle_y_m, config.handle_z_m))
    offset = R.matrix() @ built.T_object_handle.translation()
    bottom = z - float(offset[2])
    return gtsam.Pose3(R, np.array([x, y, z]) - offset), min(bottom, 0.0), max(bottom, 0.0)


def grasps_at_handle(
    built: BuiltObject, spec: PlaceableSpec, config: FurniturePlaceConfig
) -> list[gtsam.Pose3]:
    """T_object_grasp at the closed handle: both ways up, straight on first.

    A bar is gripped from any side about its own axis; the flat board of an edge only within its
    plane, so that both pads lie on it.
    """
    edge = spec.handle.style == "edge"
    tilted = gtsam.Rot3.Ry if edge else gtsam.Rot3.Rx
    return [
        built.T_object_handle * gtsam.Pose3(tilted(tilt) * gtsam.Rot3.Rz(turn), np.zeros(3))
        for tilt in (config.edge_tilts_rad if edge else config.tilts_rad)
        for turn in (0.0, np.pi)
    ]


def can_open(
    built: BuiltObject,
    T_world_object: gtsam.Pose3,
    T_object_grasp: gtsam.Pose3,
    kinematics: FrankaKinematics,
    config: FurniturePlaceConfig,
) -> bool:
    """Whether the Franka, held by nothing but its joints, follows a grasp as far as is asked."""
    T_world_grasp = T_world_object * T_object_grasp
    full = config.opening_m if built.spec.kind == "prismatic" else config.opening_rad
    full = min(full, built.spec.upper)
    poses = [
        T_world_object * opened(built, float(q)) * T_object_grasp
        for q in np.linspace(0.0, full, config.steps)[1:]
    ]
    choice = choose_grasp_configuration(kinematics, T_world_grasp, config.reach)
    if choice is None:
        return False
    path: list[FloatArray] | None = kinematics.chain(poses, choice.q_grasp)
    return path is not None and min(limit_margin_rad(q) for q in path) > config.margin_rad
