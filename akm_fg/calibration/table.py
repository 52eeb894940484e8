"""A calibration as a table for a person, and scored against the truth of a simulation."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
from rich.table import Table

from akm_fg.calibration.read import read_camera
from akm_fg.calibration.records import DISTORTION, INTRINSICS, HandEyeCalibration
from akm_fg.errors import InputError
from akm_fg.io.json_fields import Fields, load_json_object
from akm_fg.records import FloatArray

TRUTH_SCHEMA = "akm-fg/board-truth/1"


def calibration_table(result: HandEyeCalibration) -> Table:
    """Every number with its standard deviation; without a title."""
    table = Table("", "value", "standard deviation")
    sds = np.sqrt(np.diag(result.intrinsics_cov))
    c = result.camera
    values = [c.fx, c.fy, c.cx, c.cy, *result.distortion]
    for name, value, sd in zip(INTRINSICS, values, sds, strict=True):
        unit, digits = ("", 5) if name in DISTORTION else (" px", 2)
        known = f"{sd:.{digits}f}{unit}" if sd > 0 else "held"
        table.add_row(name, f"{value:.{digits}f}{unit}", known)
    fixed = result.camera_place == "fixed"
    names = ("T_world_cam", "T_gripper_board") if fixed else ("T_gripper_cam", "T_world_board")
    poses = (
        (result.T_mount_cam, result.T_mount_cam_cov),
        (
            result.T_holder_board,
            result.T_holder_board_cov,
        ),
    )
    for name, (pose, cov) in zip(names, poses, strict=True):
        sd = np.sqrt(np.diag(cov))
        place = _three(1e3 * pose.translation(), 2)
        turn = _three(np.rad2deg(gtsam.Rot3.Logmap(pose.rotation())), 3)
        table.add_row(f"{name}, place", f"{place} mm", f"{_three(1e3 * sd[3:], 2)} mm")
        table.add_row(f"{name}, turn", f"{turn} deg", f"{_three(np.rad2deg(sd[:3]), 3)} deg")
    return table


def _three(numbers: FloatArray, digits: int) -> str:
    return ", ".join(f"{x:.{digits}f}" for x in numbers)


def score_line(result: HandEyeCalibration, truth: Path) -> str:
    """How far the camera is from the truth, in space and in its own covariance.

    Raises:
        InputError: the file does not say where the camera is.
    """
    what = f"the truth of a simulated recording ({TRUTH_SCHEMA})"
    fields = Fields(truth, load_json_object(truth, what))
    if fields.text("schema", f"the string {TRUTH_SCHEMA!r}") != TRUTH_SCHEMA:
        raise fields.error("schema", "is another", f"{TRUTH_SCHEMA!r}")
    if result.camera_place != "fixed":
        raise InputError(truth, "is of a fixed camera", "--camera-place fixed")
    xi = gtsam.Pose3.Logmap(result.T_mount_cam.between(fields.pose("T_world_cam")))
    nees = float(xi @ np.linalg.solve(result.T_mount_cam_cov, xi))
    camera = read_camera(fields)
    return (
        f"against the truth: T_world_cam off by {1e3 * np.linalg.norm(xi[3:]):.3f} mm, "
        f"{np.rad2deg(np.linalg.norm(xi[:3])):.4f} deg (NEES {nees:.1f}, expected 6); "
        f"fx by {result.camera.fx - camera.fx:.2f}, cx by {result.camera.cx - camera.cx:.2f}, "
        f"cy by {result.camera.cy - camera.cy:.2f} px"
    )
