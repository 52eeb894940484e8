"""`--config FILE` and the names of stages: what a run writes is what gives the same run again."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from akm_fg.cli.demo import DemoArguments
from akm_fg.cli.fit import FitArguments, fit
from akm_fg.cli.main import main
from akm_fg.config import AkmConfig
from akm_fg.io.config_file import read_config, write_config
from akm_fg.io.recording import write_recording
from akm_fg.records import Recording
from akm_fg.stream.frame_stream import FrameStream


@pytest.fixture
def tracks(tmp_path: Path) -> Path:
    """A drawer's."""
    rng = np.random.default_rng(0)
    shape, q = rng.uniform(-0.2, 0.2, (12, 3)), np.linspace(0.0, 0.15, 8)
    points = shape + q[:, None, None] * np.array([0.0, 0.0, 1.0])
    path = tmp_path / "drawer.npz"
    np.savez(path, points=points + rng.normal(0.0, 0.001, points.shape), sigma_m=0.001)
    return path


def fitted(path: Path, out: Path, *more: str) -> dict:
    assert main(["fit", str(path), "--json", str(out), *more]) == 0
    posterior = json.loads(out.read_text())
    del posterior["time_s"]
    return posterior


def test_what_a_fit_writes_gives_the_same_posterior_again(tracks: Path, tmp_path: Path, capfd):
    mine = tmp_path / "mine.toml"
    mine.write_text("fit.dof = 4.0\nfit.prior.hinge_distance_m = 0.5\n")
    plain = fitted(tracks, tmp_path / "plain.jsonl")
    tuned = fitted(tracks, tmp_path / "tuned.jsonl", "--config", str(mine))
    assert tuned != plain  # the file counts
    whole = tmp_path / "tuned.jsonl.config.toml"
    assert tomllib.loads(whole.read_text())["fit"]["dof"] == 4.0
    assert fitted(tracks, tmp_path / "again.jsonl", "--config", str(whole)) == tuned
    assert read_config(tmp_path / "plain.jsonl.config.toml", AkmConfig()) == AkmConfig()


def test_perception_is_tuned_by_the_file_too(door, tmp_path: Path, capfd):
    write_recording(tmp_path / "door", door.recording)
    mine = tmp_path / "mine.toml"
    mine.write_text(
        "perception.observe.seeding.number = 80\nperception.observe.seeding.reseed_gap = 99"
    )
    plain = fitted(tmp_path / "door", tmp_path / "plain.jsonl")
    few = fitted(tmp_path / "door", tmp_path / "few.jsonl", "--config", str(mine))
    assert few["fit"]["tracks_used"] < plain["fit"]["tracks_used"]


def test_a_stream_is_tuned_by_the_file_too(drawer, tmp_path: Path):
    mine, whole = tmp_path / "mine.toml", tmp_path / "whole.toml"
    mine.write_text("[stream.thinking]\nmax_keyframes = 4\nresting_keyframes = 9\n")
    config = read_config(mine, AkmConfig())
    kept = []
    for settings in (AkmConfig().model_settings, config.model_settings):
        stream = FrameStream("clip", settings)
        kept.append([stream.add(frame).keyframes for frame in drawer.frames[:8]][-1])
    assert kept == [8, 4]
    write_config(whole, config)
    thinking = tomllib.loads(whole.read_text())["stream"]["thinking"]
    assert (thinking["max_keyframes"], thinking["growth_to_compare"]) == (4, 0.5)
    assert read_config(whole, AkmConfig()) == config


def test_states_beside_the_graph_are_tuned_by_the_file_too(door, tmp_path: Path, capfd):
    """Of a door without texture, whose graph takes six frames of fifteen."""
    plain = tuple(replace(f, rgb=np.full_like(f.rgb, 120)) for f in door.frames)
    write_recording(tmp_path / "door", Recording("door", plain))
    mine = tmp_path / "mine.toml"
    never = "stream.surface_state.least_share = 1.1\nstream.surface_state.least_found = 1.1"
    mine.write_text(f"fit.surface.keyframes_alone = 6\n{never}")
    few = fitted(tmp_path / "door", tmp_path / "few.jsonl", "--config", str(mine))
    known = [k for k, q in enumerate(few["states"]["mean"]) if q is not None]
    assert len(known) == 6 and known == few["fit"]["keyframes_registered"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("thinking.max_keyframe = 4", "is no setting; expected stream.thinking.max_keyframes"),
        ("surfaces = 4", "is no setting; expected"),
        ("thinking.max_keyframes = 2", "max_keyframes 2; expected at least 3"),
        ("thinking.pieces_together = 0", "expected at least 1"),
        ("frames_a_piece = 1.5", "is of the wrong type; expected a whole number"),
    ],
)
def test_what_no_stream_can_be_tuned_with_is_one_line(text, said, tracks, tmp_path, capfd):
    mine = tmp_path / "mine.toml"
    mine.write_text(f"[stream]\n{text}")
    assert main(["fit", str(tracks), "--config", str(mine)]) == 2
    told = capfd.readouterr().err
    assert len(told.splitlines()) == 1 and f"stream.{text.split(' ')[0]}" in told and said in told


def test_flags_go_before_the_file(tracks: Path, tmp_path: Path, capfd):
    mine, out = tmp_path / "mine.toml", tmp_path / "out.jsonl"
    mine.write_text('stages.tracker = "nobody"\nstages.segmenter = "depth"\n')
    assert main(["fit", str(tracks), "--config", str(mine)]) == 2
    assert "tracker 'nobody': there is none of that name; expected one of" in capfd.readouterr().err
    fitted(tracks, out, "--config", str(mine), "--tracker", "flow", "--grasp")
    written = read_config(Path(f"{out}.config.toml"), AkmConfig())
    assert written.stages == AkmConfig().stages
    assert written.fit.grasp is not None


def test_a_bad_file_is_one_line_and_nothing_is_written(tracks: Path, tmp_path: Path, capfd):
    mine, out = tmp_path / "mine.toml", tmp_path / "out.jsonl"
    mine.write_text("fit.dofs = 4.0")
    assert main(["fit", str(tracks), "--json", str(out), "--config", str(mine)]) == 2
    told = capfd.readouterr()
    assert told.out == "" and len(told.err.splitlines()) == 1
    assert f"{mine}: fit.dofs = 4.0: is no setting; expected fit.dof" in told.err
    assert not out.exists()


def test_nothing_is_written_beside_standard_output(tracks: Path, tmp_path: Path, capfd):
    before = set(tmp_path.iterdir())
    assert fit(FitArguments((tracks,), json="-")) == 0
    assert set(tmp_path.iterdir()) == before


def test_a_demos_settings_serve_its_fit_and_its_next_run(tracks: Path, tmp_path: Path, capfd):
    pytest.importorskip("pybullet", reason="the simulator is not installed")
    from akm_fg.cli.demo_config import DemoConfig, demo_config

    mine, whole = tmp_path / "mine.toml", tmp_path / "config.toml"
    mine.write_text(
        "fit.dof = 4.0\nepisode.pull_m = 0.1\nsim.camera.noise.rgb_sigma = 3.0\n"
        'sim.camera.noise.disparity_sigma_px = "none"\nsim.franka.blocked_m = inf\n'
    )
    config = demo_config(DemoArguments(config=mine))
    assert config.sim.camera.noise.name == "d455" and config.sim.camera.noise.rgb_sigma == 3.0
    assert config.sim.camera.noise.disparity_sigma_px is None
    assert config.sim.franka.blocked_m == np.inf and config.episode.pull_m == 0.1
    write_config(whole, config)
    assert read_config(whole, DemoConfig()) == config
    tuned = fitted(tracks, tmp_path / "a.jsonl", "--config", str(mine))
    assert fitted(tracks, tmp_path / "b.jsonl", "--config", str(whole)) == tuned
    mine.write_text("sim.franka.time_law.speed = 0.7")
    assert main(["demo", "--config", str(mine), "--out", str(tmp_path / "runs")]) == 2
    assert "sim.franka.time_law.speed = 0.7: shares" in capfd.readouterr().err
    assert not (tmp_path / "runs").exists()
