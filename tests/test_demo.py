"""The demo's whole path, on its smallest configuration: pull, model, closed loop, replay."""

import contextlib
import hashlib
import io
import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from akm_fg.cli.demo import DemoArguments, demo, run_demo, wanted_state
from akm_fg.cli.demo_config import DemoConfig, SimulatorConfig, demo_config
from akm_fg.cli.main import main
from akm_fg.closed_loop import EpisodeConfig
from akm_fg.estimation.config import FitConfig
from akm_fg.io.config_file import read_config, write_config
from akm_fg.io.recording import read_recording, read_truth
from akm_fg.model.read import read_model
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.observe import ObserveConfig
from akm_fg.perception.tracking.seeding import SeedingConfig
from akm_fg.report.summary import RunSummary
from sim.camera.camera import CameraConfig
from sim.camera.rig import PERFECT, RigErrors

SMALL = DemoConfig(
    episode=EpisodeConfig(pull_m=0.08, pull_tick_s=0.2, move_tick_s=0.4),
    sim=SimulatorConfig(camera=CameraConfig().scaled(0.5)),
)
ERRING = replace(SMALL.sim, rig=RigErrors())
SEEDING = SeedingConfig(number=250)
TUNED = replace(
    SMALL,
    fit=FitConfig(dof=5.0),
    perception=PerceptionConfig(observe=ObserveConfig(seeding=SEEDING)),
    sim=ERRING,
)


@dataclass(frozen=True)
class Ran:
    """One demo: what it returned, said and wrote, and what it knew when it ended."""

    code: int
    json: dict
    stdout: str
    stderr: str
    folder: Path
    summary: RunSummary


def ran_demo(name: str, target: str, seed: int, path: Path, config: DemoConfig = SMALL) -> Ran:
    said, told, out = io.StringIO(), io.StringIO(), path / "run.json"
    arguments = DemoArguments(
        name, target=target, seed=seed, out=path / "runs", json=str(out), contact="given"
    )
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
        done = run_demo(arguments, config)
    assert done.folder == _only_folder(path / "runs") and done.summary is not None
    run = json.loads(out.read_text())
    return Ran(done.code, run, said.getvalue(), told.getvalue(), done.folder, done.summary)


def _only_folder(path):
    (folder,) = path.iterdir()
    return folder


@pytest.fixture(scope="module")
def drawer(tmp_path_factory):
    """Seed 5 is not the default of `fit`: a seed of the episode in its posterior would show."""
    return ran_demo("drawer", "0.12", 5, tmp_path_factory.mktemp("drawer"))


@pytest.fixture(scope="module")
def door(tmp_path_factory):
    """With settings of its own, and a rig that errs."""
    return ran_demo("door", "25deg", 0, tmp_path_factory.mktemp("door"), TUNED)


@pytest.mark.parametrize("name", ["drawer", "door"])
def test_the_demo_goes_from_a_closed_object_to_a_report(name, request):
    ran = request.getfixturevalue(name)
    run, folder = ran.json, ran.folder
    assert ran.code == 0, run["failure"]
    assert run["schema"] == "akm-fg/run/1"
    assert run["object"] == name and run["rounds"] >= 1
    assert run["posterior"]["kind"] == run["truth"]["kind"]
    assert run["p_within_tolerance"] >= 0.95
    assert abs(run["truth"]["final_state"] - run["target"]) < 0.1 * run["target"]
    page = (folder / "report.html").read_text()
    start, view, rest = page.partition("<h2>In three dimensions</h2>")
    assert view and ("<iframe" in rest or "install akm-fg[view]" in rest)
    around = start.split("</head>")[1] + rest.partition("<h2>Results</h2>")[2]
    around = re.sub(r"data:image/[^\"]+", "", around)  # four letters occur in a megabyte of base64
    assert name in page and "http" not in around.replace("http://www.w3.org", "")
    assert read_model(folder).parts[0].posterior.to_dict() == run["posterior"]
    assert "slip of the grasp" in page and 0.0 < run["truth"]["slip_m"] < 0.02
    truth = read_truth(folder / "recording")
    assert truth is not None and len(truth.states) == len(ran.summary.recording.frames)
    assert "pulling" in ran.stderr
    assert "joint kind" in ran.stdout


def digits(posterior: dict) -> str:
    """Every digit of a posterior but the seconds that it took."""
    return json.dumps({k: v for k, v in posterior.items() if k != "time_s"})


def fitted(recording: Path, *more: str) -> dict:
    out = recording.parent / "fit.json"
    assert main(["fit", str(recording), "--json", str(out), *more]) == 0
    return json.loads(out.read_text())


def test_fit_gives_the_posterior_of_the_episode_again_digit_by_digit(drawer, capsys):
    again = fitted(drawer.folder / "recording")
    assert again["kind"] == "prismatic"
    assert digits(again) == digits(json.loads((drawer.folder / "posterior.json").read_text()))
    assert digits(again) == digits(drawer.json["posterior"])


def test_the_settings_that_a_run_writes_are_its_own_and_give_its_posterior(door, capsys):
    written = door.folder / "config.toml"
    assert read_config(written, DemoConfig()) == TUNED
    again = fitted(door.folder / "recording", "--config", str(written))
    assert digits(again) == digits(door.json["posterior"])
    assert digits(fitted(door.folder / "recording")) != digits(again)
    told, errors = (
        read_recording(door.folder / "recording").calibration,
        TUNED.sim.rig.calibration(),
    )
    np.testing.assert_array_equal(told.cov_world_cam, errors.cov_world_cam)
    assert again["joint"]["axis_sd_deg"] > 0.1  # of the hand-eye calibration alone
    assert f"recording --config {written} --json -" in (door.folder / "report.html").read_text()


def test_the_recording_holds_what_the_episode_saw(drawer):
    got, want = read_recording(drawer.folder / "recording"), drawer.summary.recording
    assert got.grasp_frames == want.grasp_frames == (0, len(want.frames) - 1)
    for a, b in zip(got.frames, want.frames, strict=True):
        assert (a.stamp_s, a.camera) == (b.stamp_s, b.camera)
        assert a.rgb.tobytes() == b.rgb.tobytes()
        np.testing.assert_array_equal(a.depth_m, b.depth_m)
        np.testing.assert_array_equal(a.T_world_cam.matrix(), b.T_world_cam.matrix())
    for A, B in zip(got.T_world_gripper, want.T_world_gripper, strict=True):
        np.testing.assert_array_equal(A.matrix(), B.matrix())


def test_fit_takes_the_frames_that_an_episode_had_when_it_modelled(drawer, capsys):
    turn, n = drawer.summary.closed_loop_frame, len(drawer.summary.recording.frames)
    again = fitted(drawer.folder / "recording", "--frames", str(turn))
    assert len(again["states"]["mean"]) == turn
    first = drawer.summary.rounds[0]
    assert again["states"]["mean"][-1] == first.state_mean
    assert again["states"]["sd"][-1] == first.state_sd
    assert main(["fit", str(drawer.folder / "recording"), "--frames", "99"]) == 2
    assert f"2 to {n} frames" in capsys.readouterr().err


RUN = """
import sys
from pathlib import Path
from akm_fg.cli.demo import DemoArguments, demo
from akm_fg.cli.demo_config import DemoConfig, SimulatorConfig, demo_config
from sim.camera.camera import CameraConfig
from sim.camera.rig import PERFECT, RigErrors

arguments = DemoArguments("door", seed=5, out=Path(sys.argv[1]), contact="given")
demo(arguments, DemoConfig(sim=SimulatorConfig(camera=CameraConfig().scaled(0.5))))
"""


def hashes(folder: Path) -> dict[str, str]:
    """Of every file."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


@pytest.mark.slow
def test_the_same_seed_gives_the_same_files_in_every_process(tmp_path):
    found = []
    for hash_seed in ("1", "77"):  # of Python's own sets and dictionaries
        out = tmp_path / hash_seed
        env = {**os.environ, "PYTHONHASHSEED": hash_seed}
        subprocess.run([sys.executable, "-c", RUN, str(out)], check=True, env=env)
        found.append(hashes(_only_folder(out) / "recording"))
    assert "recording.json" in found[0] and len(found[0]) > 40
    assert found[0] == found[1]


class Interrupting:
    """An observer that interrupts at the fourth frame, before it is kept."""

    def __init__(self):
        self.seen = 0

    def looked(self, look):
        self.seen += 1
        if self.seen == 4:
            raise KeyboardInterrupt

    def stage(self, words):
        pass


def test_an_interrupted_demo_leaves_what_was_recorded_readable(tmp_path, capfd):
    arguments = DemoArguments("drawer", out=tmp_path / "runs", contact="given")
    assert run_demo(arguments, SMALL, Interrupting()).code == 130
    folder = _only_folder(tmp_path / "runs")
    assert len(read_recording(folder / "recording").frames) == 3
    page = (folder / "report.html").read_text()
    assert "interrupted" in page and f"akm-fg fit {folder}/recording --json -" in page


def test_a_grasp_that_fails_before_the_first_frame_is_told(tmp_path, capfd):
    wide = replace(SMALL.sim.franka.gripper, nothing_m=0.1)  # wider than the hand opens
    sim = replace(SMALL.sim, franka=replace(SMALL.sim.franka, gripper=wide))
    assert (
        demo(
            DemoArguments("drawer", out=tmp_path / "runs", contact="given"), replace(SMALL, sim=sim)
        )
        == 1
    )
    assert "nothing between them" in capfd.readouterr().err


@dataclass(frozen=True)
class Ranged:
    kind: str
    upper: float


@pytest.mark.parametrize(
    ("kind", "upper", "expected"),
    [
        ("prismatic", 0.4, 0.2),
        ("prismatic", 0.15, 0.12),
        ("revolute", 1.5, np.deg2rad(35.0)),
        ("revolute", 0.5, 0.4),
    ],
)
def test_a_target_that_is_not_given_lies_within_the_range(kind, upper, expected):
    found = wanted_state(DemoArguments(), None, Ranged(kind, upper))
    assert found == {kind: pytest.approx(expected)}


def test_rig_errors_are_a_flag_whatever_else_a_file_says(tmp_path):
    file = tmp_path / "c.toml"
    usual = DemoArguments(rig_errors=True)
    assert demo_config(usual).sim.rig == RigErrors()
    assert demo_config(DemoArguments()).sim.rig == PERFECT
    write_config(file, DemoConfig())
    assert demo_config(replace(usual, config=file)).sim.rig == RigErrors()
    file.write_text("sim.rig.focal = 0.01")
    assert demo_config(replace(usual, config=file)).sim.rig == RigErrors(focal=0.01)


def test_a_target_of_the_wrong_unit_is_refused(capfd):
    assert main(["demo", "--contact", "given", "--object", "door", "--target", "0.3"]) == 2
    assert "expected degrees" in capfd.readouterr().err


def test_an_unwritable_folder_is_refused(tmp_path, capfd):
    (tmp_path / "file").write_text("in the way")
    code = main(["demo", "--out", str(tmp_path / "file")])
    assert code == 2
    assert str(tmp_path / "file") in capfd.readouterr().err
