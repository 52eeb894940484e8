"""`akm-fg explore --robot`: what it refuses, what it says dry, and one try on a simulated robot.

The pictures are of a simulated cabinet, shown by librealsense's software device; nothing moves in
them. The arm is franky-sim's, with nothing before it.
"""

from __future__ import annotations

import json
import re
import threading
import time
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.arm.body.surface import ArmSurface
from akm_fg.cli.exploring.explore import ExploreArguments
from akm_fg.cli.exploring.kept import RESULT
from akm_fg.cli.main import main
from akm_fg.records import PinholeCamera
from tests.akm_fg.hardware.calibration_file import write_calibration
from tests.akm_fg.hardware.software_realsense import SoftwareRealSense

HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])  # of the counterpart
OBJECT, SEED = "furniture-dev/drawer-001", 1


def refused(capsys, *words) -> str:
    assert main(["explore", *words]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    return told[0]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--robot", "127.9.9.9"), "needs to know where the camera stands"),
        (("--robot", "127.9.9.9", "--object", "drawer"), "--object: is of the simulator"),
        (("--robot", "127.9.9.9", "--locked"), "--locked: is of the simulator"),
        (("--robot", "127.9.9.9", "--calibration", "/nowhere.json"), "/nowhere.json: is missing"),
        (("--dry-run",), "--dry-run: is of a real robot"),
        (("--calibration", "/nowhere.json"), "--calibration: is of a real robot"),
    ],
)
def test_flags_that_do_not_go_together_are_one_line(capsys, words, told):
    pytest.importorskip("pinocchio")
    assert told in refused(capsys, *words)


@pytest.fixture
def scene(tmp_path):
    """A device that shows a cabinet, and the flags that name its calibration."""
    pytest.importorskip("pybullet")
    pytest.importorskip("pyrealsense2")
    from sim.episode import open_world

    with open_world(OBJECT, SEED, placement="published") as world:
        frame, floor_m = world.camera.capture(), world.world.placement.floor_m
    depth_mm = np.nan_to_num(1000.0 * frame.depth_m).round().astype(np.uint16)
    camera = frame.camera
    path = write_calibration(tmp_path / "rig.json", camera, frame.T_world_cam)
    flags = ["--calibration", str(path), "--floor", str(floor_m)]
    return SoftwareRealSense(lambda number: (frame.rgb, depth_mm), camera, camera), flags


def explored(device, flags, monkeypatch, capsys):
    """The command with a device of software in place of the first on a cable."""
    from akm_fg.cli.exploring import on_robot

    real = on_robot.open_hardware
    monkeypatch.setattr(
        on_robot, "open_hardware", lambda *words, **more: real(*words, **{**more, "device": device})
    )
    code = main(["explore", "--without-ca", "--max-attempts", "1", *flags])
    return code, capsys.readouterr()


@pytest.mark.slow
@pytest.mark.hardware
def test_a_dry_run_says_what_would_move_and_connects_nothing(scene, monkeypatch, capsys, tmp_path):
    real, flags = scene
    with real:
        words = ["--robot", "127.9.9.9", "--dry-run", "--out", str(tmp_path), *flags]
        code, said = explored(real.device, words, monkeypatch, capsys)
    assert code == 0
    would = [line for line in said.err.splitlines() if line.startswith("would move")]
    assert any("to the pre-grasp: " in line for line in would)
    assert any("close the fingers" in line for line in would)
    assert "nothing was moved" in said.out
    (folder,) = tmp_path.glob("*-explore-robot")
    told = json.loads((folder / RESULT).read_text())
    assert told["truth"] is None and not told["opened"] and told["contacts"]


@pytest.mark.slow
@pytest.mark.hardware
def test_a_robot_looks_plans_and_tries(scene, lonely_counterpart, monkeypatch, capsys, tmp_path):
    real, flags = scene
    with real:
        words = ["--robot", lonely_counterpart.host, "--out", str(tmp_path), *flags]
        code, said = explored(real.device, words, monkeypatch, capsys)
    assert code == 1, said.err
    assert "not opened: " in said.out
    (folder,) = tmp_path.glob("*-explore-robot")
    told = json.loads((folder / RESULT).read_text())
    assert told["object"] == f"robot {lonely_counterpart.host}"
    assert told["attempts"]
    for attempt in told["attempts"]:
        assert attempt["outcome"] in ("refused", "grasp_lost")
    assert (folder / "report.html").exists()
    assert np.abs(np.array(lonely_counterpart.ask("angles")) - HOME).max() > 0.1  # it has moved


@pytest.mark.slow
@pytest.mark.hardware
def test_what_depth_is_off_is_told_by_the_arm_that_the_camera_sees(
    tmp_path, lonely_counterpart, monkeypatch
):
    """Pictures of the arm where it stands, whose depth is 1.5 % short."""
    pytest.importorskip("pyrealsense2")
    from akm_fg.hardware.opening import HardwareRequest, open_hardware

    camera = PinholeCamera(640, 480, 425.0, 425.0, 319.5, 239.5)
    R = gtsam.Rot3(np.array([[0.0, -0.5, 0.8660254], [-1.0, 0.0, 0.0], [0.0, -0.8660254, -0.5]]))
    T_world_cam = gtsam.Pose3(R, np.array([-0.5, 0.0, 1.0]))
    seen = ArmSurface().seen(HOME, 0.04, camera, T_world_cam).depth_m
    depth_mm = np.where(np.isfinite(seen), 1000.0 * seen / 1.015, 0.0).round().astype(np.uint16)
    rgb = np.zeros((480, 640, 3), dtype=np.uint8)
    path = write_calibration(tmp_path / "rig.json", camera, T_world_cam)
    request = HardwareRequest(lonely_counterpart.host, path)
    with (
        SoftwareRealSense(lambda number: (rgb, depth_mm), camera, camera) as real,
        open_hardware(request, tell=print, device=real.device) as rig,
    ):
        assert rig.correction is not None
        assert rig.correction.scale == pytest.approx(0.015, abs=0.003)
        assert rig.calibration.depth_scale_sd < rig.mounted.errors.depth_scale_sd / 3


@pytest.mark.slow
@pytest.mark.hardware
def test_an_arm_that_is_lost_on_the_way_ends_the_run_in_one_line(
    scene, lonely_counterpart, monkeypatch, capsys, tmp_path
):
    real, flags = scene

    def pull_the_cable():
        while np.abs(np.array(lonely_counterpart.ask("angles")) - HOME).max() < 0.1:
            time.sleep(0.1)
        lonely_counterpart.tell("drop")

    with real:
        words = ["--robot", lonely_counterpart.host, "--out", str(tmp_path), *flags]
        threading.Thread(target=pull_the_cable, daemon=True).start()
        code, said = explored(real.device, words, monkeypatch, capsys)
    assert code == 1
    assert "Traceback" not in said.err
    assert re.search(r"not opened: the connection to the arm at .* was lost", said.out)
    (folder,) = tmp_path.glob("*-explore-robot")
    assert "was lost" in json.loads((folder / RESULT).read_text())["failure"]


def test_the_settings_of_an_exploration_with_a_robot_are_kept_and_read_again(tmp_path):
    pytest.importorskip("pinocchio")
    from akm_fg.cli.config_argument import chosen_config
    from akm_fg.cli.exploring.on_robot import RobotConfig
    from akm_fg.cli.exploring.robot_request import robot_request
    from akm_fg.config import AkmConfig
    from akm_fg.records import PinholeCamera

    camera = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
    path = write_calibration(tmp_path / "rig.json", camera, gtsam.Pose3())
    settings = tmp_path / "mine.toml"
    settings.write_text("[hardware.arm.approach]\nspeed_m_s = 0.02\n")
    arguments = ExploreArguments(
        robot="127.9.9.9", calibration=path, config=settings, out=tmp_path / "runs", floor=-0.4
    )
    request = robot_request(arguments)
    assert request.config.hardware.arm.approach.speed_m_s == 0.02
    assert request.hardware.floor_m == -0.4
    again = chosen_config(RobotConfig(), request.folder / "config.toml")
    assert again == request.config
    assert chosen_config(AkmConfig(), request.folder / "config.toml").fit == again.fit
    assert request.remember is None
    asked = replace(arguments, memory=tmp_path, remember=True, parts="2")
    request = robot_request(asked)
    assert request.config.explore.memory == str(request.remember) == str(tmp_path)
    assert request.config.explore.parts == 2
