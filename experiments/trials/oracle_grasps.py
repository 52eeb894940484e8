"""Grasps of the true handle along which the arm can open the part as far as is asked.

The scene's builder knows handle and joint; nothing of this is ever told to the program.
"""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import FrankaKinematics
from sim.objects.part_spec import BuiltObject
from sim.objects.placement import Placement
from sim.objects.suites.furniture_place import (
    FurniturePlaceConfig,
    PlaceableSpec,
    can_open,
    grasps_at_handle,
)

# More ways to hold a bar than furniture is placed with: straight on first.
TILTS_RAD = (0.0, 0.35, -0.35, 0.7, -0.7)
MARGIN_RAD = 0.02  # to the soft limits, along the way


def followable_grasps(
    built: BuiltObject,
    spec: PlaceableSpec,
    placement: Placement,
    kinematics: FrankaKinematics,
    opening: float,
) -> list[gtsam.Pose3]:
    """T_world_grasp of each grasp that inverse kinematics can follow; what is around is left out.

    Args:
        built: the object.
        spec: what it was built from.
        placement: where it stands.
        kinematics: of the arm.
        opening: how far, m or rad.
    """
    config = replace(
        FurniturePlaceConfig(),
        tilts_rad=TILTS_RAD,
        opening_m=opening,
        opening_rad=opening,
        margin_rad=MARGIN_RAD,
    )
    T = placement.T_world_object
    return [
        T * T_object_grasp
        for T_object_grasp in grasps_at_handle(built, spec, config)
        if can_open(built, T, T_object_grasp, kinematics, config)
    ]


def enough(kind: str, cm_or_deg: float) -> float:
    """So many centimetres or degrees, as m or rad."""
    return cm_or_deg / 100.0 if kind == "prismatic" else float(np.deg2rad(cm_or_deg))
