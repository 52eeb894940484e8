"""The demo's whole path, on its smallest configuration: pull, model, closed loop, report."""

import json

import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from akm_fg.cli.demo import DemoArguments, DemoSetting, demo
from akm_fg.cli.main import main
from akm_fg.closed_loop import EpisodeConfig
from akm_fg.io.recording import read_recording, read_truth

SMALL = DemoSetting(
    EpisodeConfig(pull_m=0.08, pull_tick_s=0.2, move_tick_s=0.4),
    image_scale=0.5,
)


def _only_folder(path):
    (folder,) = path.iterdir()
    return folder


@pytest.mark.parametrize(("name", "target"), [("drawer", "0.12"), ("door", "25deg")])
def test_the_demo_goes_from_a_closed_object_to_a_report(name, target, tmp_path, capfd):
    out = tmp_path / "run.json"
    code = demo(DemoArguments(name, target, 0, tmp_path / "runs", str(out)), SMALL)
    folder = _only_folder(tmp_path / "runs")
    run = json.loads(out.read_text())
    assert code == 0, run["failure"]
    assert run["schema"] == "akm-fg/run/1"
    assert run["posterior"]["kind"] == run["truth"]["kind"]
    assert run["p_within_tolerance"] >= 0.95
    assert abs(run["truth"]["final_state"] - run["target"]) < 0.1 * run["target"]
    assert json.loads((folder / "posterior.json").read_text())["schema"] == "akm-fg/posterior/1"
    page = (folder / "report.html").read_text()
    assert name in page and "http" not in page.split("</head>")[1].replace("http://www.w3.org", "")
    recording, truth = read_recording(folder / "recording"), read_truth(folder / "recording")
    assert truth is not None and len(truth.states) == len(recording.frames)
    assert recording.T_world_gripper is not None
    captured = capfd.readouterr()
    assert "pulling" in captured.err
    assert "joint kind" in captured.out


def test_an_interrupted_demo_leaves_what_was_recorded_readable(tmp_path, monkeypatch, capfd):
    from sim.camera import SimCamera

    real, taken = SimCamera.capture, []

    def capture(self):
        if len(taken) == 4:
            raise KeyboardInterrupt
        taken.append(1)
        return real(self)

    monkeypatch.setattr(SimCamera, "capture", capture)
    arguments = DemoArguments("drawer", None, 0, tmp_path / "runs")
    assert demo(arguments, SMALL) == 130
    folder = _only_folder(tmp_path / "runs")
    assert len(read_recording(folder / "recording").frames) == 4
    assert "interrupted" in (folder / "report.html").read_text()


def test_a_grasp_that_fails_before_the_first_frame_is_told(tmp_path, monkeypatch, capfd):
    from akm_fg.errors import GraspFailed
    from sim.franka import SimFranka

    def grasp(self, T_world_grasp, tick_s):
        raise GraspFailed("the fingers met with nothing between them")
        yield

    monkeypatch.setattr(SimFranka, "grasp", grasp)
    assert demo(DemoArguments("drawer", None, 0, tmp_path / "runs"), SMALL) == 1
    assert "nothing between them" in capfd.readouterr().err


def test_a_target_of_the_wrong_unit_is_refused(capfd):
    assert main(["demo", "--object", "door", "--target", "0.3"]) == 2
    assert "expected degrees" in capfd.readouterr().err


def test_an_unwritable_folder_is_refused(tmp_path, capfd):
    (tmp_path / "file").write_text("in the way")
    code = main(["demo", "--out", str(tmp_path / "file")])
    assert code == 2
    assert str(tmp_path / "file") in capfd.readouterr().err
