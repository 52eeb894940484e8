"""`akm-fg explore`: what it refuses at once, and one exploration from end to end."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.cli.demo_config import DemoConfig
from akm_fg.cli.exploring.explore import (
    ExploreArguments,
    command_of,
    explore_request,
    simulated_default,
)
from akm_fg.cli.main import main
from akm_fg.exploration.analogy.shipped import SHIPPED

pytest.importorskip("pybullet")
OBJECT = "furniture-dev/drawer-001"


def refused(capsys, *words) -> str:
    assert main(["explore", *words]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    return told[0]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--max-attempts", "0"), "--max-attempts: is 0; expected 1 or more"),
        (("--parts", "none"), "--parts: is 'none'; expected a number from 1 on, or all"),
        (("--parts", "0"), "--parts: is '0'"),
        (("--object", "furniture-dev/door-999"), "no such object"),
        (("--object", "nowhere.urdf"), "is no suite's object, file or folder"),
        (("--seed", "-1"), "--seed: is -1"),
        (("--resume", "/nonexistent"), "cannot be read"),
    ],
)
def test_what_cannot_be_explored_is_one_line(capsys, words, told):
    assert told in refused(capsys, *words)


def test_a_run_of_another_object_is_not_gone_on_with(capsys, tmp_path):
    told = {"schema": "akm-fg/explore/1", "object": "furniture-dev/door-001", "seed": 3}
    (tmp_path / "explore.json").write_text(json.dumps(told))
    line = refused(capsys, "--object", OBJECT, "--resume", str(tmp_path))
    assert "is of furniture-dev/door-001 with seed 3" in line
    (tmp_path / "explore.json").write_text(json.dumps({**told, "object": OBJECT, "seed": 0}))
    line = refused(capsys, "--object", OBJECT, "--resume", str(tmp_path))
    assert "is not a whole exploration" in line
    (tmp_path / "explore.json").write_text("[1]")
    assert "is no JSON object" in refused(capsys, "--object", OBJECT, "--resume", str(tmp_path))


def test_the_command_that_is_told_repeats_the_run():
    arguments = ExploreArguments(object=OBJECT, seed=4, stop="threshold", without_ca=True)
    words = command_of(arguments)
    assert words == f"akm-fg explore {OBJECT} --seed 4 --stop threshold --without-ca"


@pytest.mark.slow
def test_an_exploration_leaves_recordings_a_model_and_a_report(tmp_path, capsys):
    out = tmp_path / "told.json"
    code = main(["explore", "--object", OBJECT, "--rig-errors", "--out", str(tmp_path),
                 "--json", str(out)])  # fmt: skip
    told = json.loads(out.read_text())
    (folder,) = tmp_path.glob("*-explore-*")
    assert code == 0 and told["opened"]
    assert told["truth"]["final_state"] > 0.05
    last = told["attempts"][-1]
    assert last["outcome"] == "opened" and last["stretches"][-1]["kind"] == "prismatic"
    assert (folder / last["recording"] / "recording.json").exists()
    assert (folder / "model.json").exists()
    assert "<h2>In three dimensions</h2>" in (folder / "report.html").read_text()
    again = ["fit", str(folder / last["recording"]), "--json", str(tmp_path / "fit.jsonl")]
    assert main([*again, "--config", str(folder / "config.toml")]) == 0
    fitted = json.loads((tmp_path / "fit.jsonl").read_text())
    model = json.loads((folder / "model.json").read_text())["parts"][0]["posterior"]
    placed = [np.array(each["joint"]["T_world_joint"]) for each in (fitted, model)]
    assert_allclose(placed[0], placed[1], atol=1e-5)


@pytest.mark.slow
def test_of_two_doors_of_which_one_is_jammed_the_other_is_found(tmp_path, capsys):
    out = tmp_path / "told.json"
    code = main(["explore", "--object", "furniture-dev/door-015", "--seed", "2", "--rig-errors",
                 "--out", str(tmp_path), "--json", str(out)])  # fmt: skip
    told = json.loads(out.read_text())
    tries = [(attempt["outcome"], attempt["held"]) for attempt in told["attempts"]]
    assert code == 0 and ("rigid", True) in tries and tries[-1][0] == "opened"
    assert abs(told["truth"]["final_state"]) > math.radians(5.0)
    assert told["attempts"][-1]["stretches"][-1]["kind"] in ("revolute", "undecided")


@pytest.mark.slow
def test_where_everything_is_locked_nothing_is_called_opened(tmp_path, capsys):
    out = tmp_path / "told.json"
    code = main(["explore", "--object", OBJECT, "--locked", "--out", str(tmp_path),
                 "--json", str(out)])  # fmt: skip
    told = json.loads(out.read_text())
    assert code == 1 and not told["opened"] and told["model"] is None
    assert "nothing" in told["failure"]


def test_an_exploration_feels_for_handles_along_the_look_and_keeps_no_more_frames_than_it_fits():
    config, demo = simulated_default(), DemoConfig()
    assert config.sim.franka.aslant_rad > 0.0 == demo.sim.franka.aslant_rad
    assert config.sim.franka.gripper.close_m_s < demo.sim.franka.gripper.close_m_s
    assert config.perception.observe.kept.most == config.fit.max_frames < demo.fit.max_frames


def test_what_opens_is_remembered_where_it_is_asked_for_and_else_nowhere(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    base = ExploreArguments(object=OBJECT, out=tmp_path)
    request = explore_request(base)
    assert request.remember is None and request.config.explore.memory == ""
    request = explore_request(replace(base, remember=True))
    assert request.remember == tmp_path / "home" / "akm-fg" / "contacts"
    assert request.config.explore.memory == ""  # it begins with what comes with the package
    shutil.copytree(SHIPPED, tmp_path / "mine")
    request = explore_request(replace(base, remember=True, memory=tmp_path / "mine"))
    assert request.config.explore.memory == str(request.remember) == str(tmp_path / "mine")
    assert "--memory" in request.command and "--remember" in request.command
