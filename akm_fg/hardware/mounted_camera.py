"""What `akm-fg calibrate --json` said of a fixed camera, as a robot uses it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.calibration.records import DISTORTION
from akm_fg.calibration.result_json import SCHEMA
from akm_fg.errors import InputError
from akm_fg.io.json_fields import Fields, load_json_object
from akm_fg.io.sources.source import Lens
from akm_fg.records import CalibrationErrors, PinholeCamera

DAY_S = 86400.0
WHAT = f"what `akm-fg calibrate --json` wrote ({SCHEMA})"


@dataclass(frozen=True, slots=True)
class DepthErrors:
    """Errors of a depth camera that no calibration of its colour camera shows."""

    scale_sd: float = 0.01  # relative; the D455's data sheet: within 2 %, taken as 95 %
    bias_sd_m: float = 1e-3


@dataclass(frozen=True, slots=True)
class MountedCamera:
    """Where a camera stands, through which lens it looks, and how well both are known."""

    path: Path
    lens: Lens  # of the colour pictures, with its distortion
    T_world_cam: gtsam.Pose3
    errors: CalibrationErrors
    rms_px: float
    written_s: float  # since 1970; of the file

    def age_days(self) -> float:
        """Since the file was written."""
        return (time.time() - self.written_s) / DAY_S


def read_mounted_camera(path: Path, depth: DepthErrors | None = None) -> MountedCamera:
    """Read a calibration.

    Raises:
        InputError: it is none, or of a camera in the gripper.
    """
    depth = depth or DepthErrors()
    fields = Fields(path, load_json_object(path, WHAT))
    if fields.text("schema", repr(SCHEMA)) != SCHEMA:
        raise InputError(path, f"its schema is {fields.values['schema']!r}", WHAT)
    if fields.text("camera_place", "'fixed'") != "fixed":
        raise InputError(path, "is of a camera in the gripper", "one of a fixed camera")
    try:
        return _mounted(path, fields, depth)
    except ValueError as error:
        raise InputError(path, str(error), WHAT) from error


def _mounted(path: Path, fields: Fields, depth: DepthErrors) -> MountedCamera:
    camera, bent = fields.table("camera", "an object"), fields.table("distortion", "an object")
    size = camera.positive_integer("width"), camera.positive_integer("height")
    pinhole = PinholeCamera(*size, *(camera.number(name) for name in ("fx", "fy", "cx", "cy")))
    cov = fields.array("intrinsics_cov", (8, 8), "8 x 8 numbers")
    errors = CalibrationErrors(
        fields.array("T_world_cam_cov", (6, 6), "6 x 6 numbers"),
        depth_scale_sd=depth.scale_sd,
        depth_bias_sd_m=depth.bias_sd_m,
        cov_intrinsics=np.asarray(cov[:4, :4]),
    )
    return MountedCamera(
        path,
        Lens(pinhole, tuple(bent.number(name) for name in DISTORTION)),
        fields.pose("T_world_cam"),
        errors,
        fields.number("rms_px"),
        path.stat().st_mtime,
    )
