"""A calibration as JSON (akm-fg/calibration/1), and into the description of a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from akm_fg.calibration.read import open_recording, read_camera
from akm_fg.calibration.records import DISTORTION, INTRINSICS, HandEyeCalibration
from akm_fg.errors import InputError
from akm_fg.io.png import replace_file
from akm_fg.records import FloatArray
from factors.measurements.board_view import project_corners

SCHEMA = "akm-fg/calibration/1"


def calibration_as_line(result: HandEyeCalibration) -> str:
    """One line of JSON; fields in docs/conventions.md."""
    fixed = result.camera_place == "fixed"
    camera, board = (
        ("T_world_cam", "T_gripper_board") if fixed else ("T_gripper_cam", "T_world_board")
    )
    c = result.camera
    sds = np.sqrt(np.diag(result.intrinsics_cov)).tolist()
    intrinsics = {"width": c.width, "height": c.height}
    described: dict[str, Any] = {
        "schema": SCHEMA,
        "input": result.name,
        "camera_place": result.camera_place,
        "camera": {**intrinsics, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy},
        "distortion": dict(zip(DISTORTION, result.distortion.tolist(), strict=True)),
        "intrinsics_sd": dict(zip(INTRINSICS, sds, strict=True)),
        "intrinsics_cov": result.intrinsics_cov.tolist(),
        camera: result.T_mount_cam.matrix().tolist(),
        f"{camera}_cov": result.T_mount_cam_cov.tolist(),
        f"{camera}_sd": pose_sd(result.T_mount_cam_cov),
        board: result.T_holder_board.matrix().tolist(),
        f"{board}_cov": result.T_holder_board_cov.tolist(),
        f"{board}_sd": pose_sd(result.T_holder_board_cov),
        "rms_px": result.rms_px,
        "corner_scale_px": result.corner_scale_px,
        "views": [
            {
                "frame": view.frame,
                "corners": len(view.uv),
                "rms_px": view.rms_px,
                "robot_shift_m": view.robot_shift_m,
                "robot_turn_rad": view.robot_turn_rad,
            }
            for view in result.views
        ],
        "skipped": list(result.skipped),
        "left_out": [{"frame": v.frame, "off_px": v.off_px} for v in result.left_out],
        "warnings": list(result.warnings),
    }
    return json.dumps(described, allow_nan=False)


def pose_sd(cov: FloatArray) -> dict[str, list[float]]:
    """Standard deviations about and along the pose's own axes, for a person."""
    sd = np.sqrt(np.diag(cov))
    return {"rotation_deg": np.rad2deg(sd[:3]).tolist(), "translation_mm": (1e3 * sd[3:]).tolist()}


def write_into_recording(folder: Path, result: HandEyeCalibration) -> None:
    """Put camera, T_world_cam and their covariances into a recording's description.

    Everything else stays, what is said of the depth's errors too.

    Raises:
        ValueError: the calibration is of a camera in the gripper, or has distortion.
        InputError: the folder is no recording, or its images have another size.
        OutputError: it cannot be written.
    """
    if result.camera_place != "fixed" or result.distortion.any():
        raise ValueError("a recording holds a fixed camera without distortion")
    fields = open_recording(folder)
    before, c = read_camera(fields), result.camera
    if (before.width, before.height) != (c.width, c.height):
        size = f"its images are {before.width}x{before.height}"
        raise InputError(folder, size, f"those of the calibration: {c.width}x{c.height}")
    camera = {"width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy}
    described = {
        **fields.values,
        "camera": camera,
        "T_world_cam": result.T_mount_cam.matrix().tolist(),
        "cov_world_cam": result.T_mount_cam_cov.tolist(),
        "cov_intrinsics": result.intrinsics_cov[:4, :4].tolist(),
    }
    if fields.has("calibration"):
        of_depth = fields.table("calibration", "an object").values
        replaced = ("cov_world_cam", "focal_sd")
        described["calibration"] = {k: v for k, v in of_depth.items() if k not in replaced}
    text = json.dumps(described, allow_nan=False) + "\n"
    replace_file(folder / "recording.json", text.encode())


def largest_distortion_px(result: HandEyeCalibration) -> float:
    """How far distortion moves any pixel of the image, at most."""
    c = result.camera
    u, v = np.meshgrid(np.linspace(0, c.width - 1, 33), np.linspace(0, c.height - 1, 25))
    rays = c.back_project(np.stack([u.ravel(), v.ravel()], axis=-1), np.ones(u.size))
    lens = np.r_[c.fx, c.fy, 0.0, c.cx, c.cy, result.distortion]
    uv, _, _ = project_corners(lens, rays)
    return float(np.linalg.norm(uv - c.project(rays), axis=1).max())
