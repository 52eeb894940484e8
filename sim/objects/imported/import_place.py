"""Where a user's object stands: as furniture does, or, where that fails, wherever it is reached."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from akm_fg.arm.body.kinematics import FrankaKinematics
from akm_fg.errors import MotionInfeasible
from sim.objects.imported.imported_spec import ImportedSpec
from sim.objects.part_spec import BuiltObject
from sim.objects.placement import Placement
from sim.objects.suites.furniture_place import FurniturePlaceConfig, place_furniture

LOG = logging.getLogger(__name__)

LESS_M, LESS_RAD = 0.10, float(np.deg2rad(10.0))  # what the arm must at least be able to open


def place_imported(
    built: BuiltObject, spec: ImportedSpec, kinematics: FrankaKinematics
) -> Placement:
    """A pose from which the arm can open the standard range, or else a little of it.

    Raises:
        MotionInfeasible: not even that.
    """
    config = FurniturePlaceConfig()
    try:
        return place_furniture(built, spec, kinematics, config)
    except MotionInfeasible as error:
        LOG.warning("%s; it is placed where the arm can open it a little", error)
    less = replace(config, opening_m=LESS_M, opening_rad=LESS_RAD)
    return place_furniture(built, spec, kinematics, less)
