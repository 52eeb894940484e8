"""The Python of README, tutorial and how-to pages is run as it stands there, on a rendered door."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import gtsam
import numpy as np
import pytest

import akm_fg
from akm_fg.cli.main import main
from akm_fg.model.write import write_model
from akm_fg.records import PinholeCamera, RgbdFrame

ROOT = Path(__file__).resolve().parents[2]


def run(page: str, names: dict[str, object] | None = None) -> dict[str, object]:
    """Runs the page's blocks one after another, each knowing the names of those before it."""
    names = dict(names or {})
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.S)
    assert blocks
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    return names


@pytest.fixture
def kitchen(door_model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a model where the pages have one, and the door's posterior for any input."""
    (tmp_path / "runs" / "my_tum").mkdir(parents=True)
    write_model(tmp_path / "runs" / "my_tum", door_model)
    monkeypatch.setattr(akm_fg, "fit", lambda _: door_model.parts[0].posterior)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_readme_fits_and_prints(kitchen: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("README.md")
    assert "revolute" in capsys.readouterr().out


def test_the_tutorial_reads_a_model_and_writes_a_recording(kitchen: Path) -> None:
    names = run("docs/start/tutorial.md")
    assert names["ahead"].p_world.shape == (1, 3)
    recording = akm_fg.read_recording("my_recording")
    assert len(recording.frames) == 20 and np.isnan(recording.frames[0].depth_m).all()


def test_the_covariance_in_the_world_is_that_of_axis_and_pivot(kitchen: Path) -> None:
    names = run("docs/howto/covariance.md")
    joint = names["joint"]
    across = np.eye(3) - np.outer(joint.axis, joint.axis)
    for cov, sd in (("cov_axis_world", joint.axis_sd_rad), ("cov_pivot_world", joint.pivot_sd_m)):
        variance = np.trace(across @ names[cov] @ across)
        np.testing.assert_allclose(np.sqrt(variance / 2), sd, rtol=1e-6)


def test_why_it_is_undecided_can_be_printed(kitchen: Path, capsys) -> None:
    run("docs/howto/undecided.md")
    assert "revolute" in capsys.readouterr().out


def test_the_factor_and_its_own_tests_hold() -> None:
    names = run("docs/howto/factor.md")
    tests = [f for name, f in names.items() if name.startswith("test_")]
    assert len(tests) == 2
    for test in tests:
        assert isinstance(test, Callable)
        test()
    with pytest.raises(ValueError, match="sigma_rad"):
        names["axis_direction_factor"](0, [0, 0, 1], 0.0)


def test_the_tracker_follows_a_door(door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(akm_fg, "read_recording", lambda _: door.recording)
    names = run("docs/howto/tracker.md")
    posterior = names["fit"].posterior
    assert posterior.kind == "revolute"
    assert np.rad2deg(np.arccos(abs(posterior.best.joint.axis[2]))) < 1.0
    with pytest.raises(ValueError, match="no frame"):
        names["LkTracker"]().begin().follow(np.zeros((1, 2)))


def test_the_skeletons_of_a_robot_have_what_the_protocols_ask_for() -> None:
    from akm_fg.interfaces import Arm, Camera

    names = run("docs/howto/robot.md")
    for protocol, skeleton in ((Arm, names["MyArm"]), (Camera, names["MyCamera"])):
        asked = {n for n in vars(protocol) if not n.startswith("_")}
        assert asked <= set(vars(skeleton))


@pytest.mark.parametrize("page", ["exploration", "manipulation", "howto/source"])
def test_what_a_page_imports_is_there(page: str) -> None:
    assert run(f"docs/{page}.md")


def test_the_arm_of_another_urdf_is_taken_out_of_a_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pinocchio")
    from akm_fg.arm.body.description import franka_description
    from akm_fg.arm.body.kinematics import Q_HOME

    arm = franka_description()
    shutil.copytree(arm.urdf.parent, tmp_path, dirs_exist_ok=True)
    file = tmp_path / "panda.urdf"
    file.write_text(file.read_text().replace(arm.gripper_frame, "panda_hand_tcp"))
    monkeypatch.chdir(tmp_path)
    camera = PinholeCamera(80, 60, 75.0, 75.0, 39.5, 29.5)
    T_world_cam = gtsam.Pose3(gtsam.Rot3.Rx(-np.pi / 2), np.array([0.4, -1.0, 0.5]))
    depth_m = np.full((60, 80), 2.0, np.float32)
    frame = RgbdFrame(0.0, np.zeros((60, 80, 3), np.uint8), depth_m, camera, T_world_cam)
    names = run("docs/franka.md", {"frame": frame, "q": Q_HOME, "fingers_m": 0.02})
    hidden = np.isnan(names["ArmSilhouette"](names["arm"]).masked(frame, Q_HOME, 0.02).depth_m)
    assert 0 < hidden.sum() < hidden.size


def test_the_exported_door_is_loaded(kitchen: Path) -> None:
    for package in ("pybullet", "mujoco", "trimesh"):
        pytest.importorskip(package)
    for flag, folder in (("--urdf", "door_urdf"), ("--mjcf", "door_mjcf")):
        words = ["export", "runs/my_tum", flag, folder, "--collision", "hull"]
        assert main(words) == 0
    names = run("docs/howto/urdf.md")
    pybullet, client = names["pybullet"], names["client"]
    state = pybullet.getJointState(names["door"], 0, physicsClientId=client)[0]
    pybullet.disconnect(client)
    assert state == pytest.approx(0.3) and names["model"].njnt == 1


def test_every_page_with_python_is_run_here_or_where_its_robot_is() -> None:
    """docs/model.md by model/test_model_docs.py; docs/hardware.md has an address of a robot."""
    elsewhere = {"docs/model.md", "docs/hardware.md"}
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    with_python = {str(p.relative_to(ROOT)) for p in pages if "```python" in p.read_text()}
    told = Path(__file__).read_text()
    for page in with_python - elsewhere:
        assert page in told or f'"{page.removeprefix("docs/").removesuffix(".md")}"' in told, page
