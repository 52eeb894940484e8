"""`akm-fg doctor --hardware`: what it says of a rig, and that it moves nothing."""

from __future__ import annotations

import importlib.metadata
import json
import os
import time

import gtsam
import numpy as np
import pytest

from akm_fg.cli.doctor import DoctorArguments, doctor
from akm_fg.records import PinholeCamera
from tests.akm_fg.hardware.calibration_file import write_calibration
from tests.akm_fg.hardware.software_realsense import SoftwareRealSense

pytest.importorskip("pinocchio", reason="the arm's packages are not installed")
from akm_fg.hardware.check import CheckConfig, check_rig

CAMERA = PinholeCamera(160, 120, 110.0, 110.0, 79.5, 59.5)
QUICK = CheckConfig(listen_s=0.3)


def looking_at(p_world, from_world):
    """T_world_cam of a camera that looks at a point, its picture upright."""
    z = (p_world - from_world) / np.linalg.norm(p_world - from_world)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return gtsam.Pose3(gtsam.Rot3(np.column_stack([x, np.cross(z, x), z])), from_world)


BEFORE_THE_ROBOT = looking_at(np.array([0.55, 0.0, 0.45]), np.array([-0.4, 0.5, 1.0]))


def found(*words, **more):
    return {check.name: check for check in check_rig(*words, config=QUICK, **more)}


def test_a_good_calibration_is_told_with_its_age(tmp_path):
    path = write_calibration(tmp_path / "rig.json", CAMERA, BEFORE_THE_ROBOT)
    checks = found(None, path)
    assert checks["calibration"].state == "ok"
    assert "0 days old" in checks["calibration"].words
    assert checks["workspace"].state == "ok"
    assert "robot" not in checks  # nobody asked for one


def test_an_old_or_vague_calibration_is_a_warning(tmp_path):
    vague = {"rms_px": 3.0, "T_world_cam_cov": np.diag([1e-4] * 6).tolist()}
    path = write_calibration(tmp_path / "rig.json", CAMERA, BEFORE_THE_ROBOT, vague)
    then = time.time() - 60 * 86400
    os.utime(path, (then, then))
    check = found(None, path)["calibration"]
    assert check.state == "warning"
    for words in ("60 days old", "older than 30 days", "rms above 1 px", "not known to 5 mm"):
        assert words in check.words


def test_a_camera_that_looks_elsewhere_is_a_warning_and_one_below_the_floor_a_problem(tmp_path):
    away = looking_at(np.array([-3.0, 0.0, 0.45]), np.array([-0.4, 0.5, 1.0]))
    path = write_calibration(tmp_path / "rig.json", CAMERA, away)
    check = found(None, path)["workspace"]
    assert check.state == "warning" and "sees 0 %" in check.words
    assert found(None, path, floor_m=1.2)["workspace"].state == "problem"


def test_pictures_are_taken_of_a_camera_that_is_there(tmp_path):
    pytest.importorskip("pyrealsense2")
    path = write_calibration(tmp_path / "rig.json", CAMERA, BEFORE_THE_ROBOT)
    rgb, far = np.zeros((120, 160, 3), np.uint8), np.full((120, 160), 1000, np.uint16)
    with SoftwareRealSense(lambda number: (rgb, far), CAMERA, CAMERA) as real:
        check = found(None, path, device=real.device)["camera"]
    assert check.state == "ok" and "100 % of its pixels have depth" in check.words


def test_a_stranger_of_the_same_name_is_a_problem(monkeypatch):
    version = importlib.metadata.version
    monkeypatch.setattr(
        importlib.metadata, "version", lambda name: "0.5" if name == "franky" else version(name)
    )
    check = found(None, None)["franky"]
    assert check.state == "problem" and "another project" in check.words


def test_doctor_fails_on_a_problem_and_says_it_in_json_too(tmp_path, capfd):
    asked = {"hardware": True, "calibration": tmp_path / "now\x1b[31mhere.json"}
    assert doctor(DoctorArguments(**asked), packages=()) == 2
    said = capfd.readouterr().out
    assert "problem  calibration: " in said and "\x1b" not in said and r"now\x1b[31mhere" in said
    assert doctor(DoctorArguments(json="-", **asked), packages=()) == 2
    report = json.loads(capfd.readouterr().out.splitlines()[-1])
    states = {check["name"]: check["state"] for check in report["hardware"]}
    assert states["calibration"] == "problem"


@pytest.mark.slow
@pytest.mark.hardware
def test_a_robot_is_looked_at_and_not_moved(counterpart):
    before = np.array(counterpart.ask("angles"))
    checks = found(counterpart.host, None)
    assert {"robot", "control rate", "joints", "hand", "fingers"} <= set(checks)
    for name in ("robot", "joints", "hand", "fingers"):
        assert checks[name].state == "ok", checks[name]
    assert "of 1000 Hz" in checks["control rate"].words
    assert found(counterpart.host, None, floor_m=0.47)["hand"].state == "problem"
    assert np.abs(np.array(counterpart.ask("angles")) - before).max() < 1e-3
