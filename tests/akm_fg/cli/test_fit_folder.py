"""`akm-fg fit --out DIR`: what the demo writes, of one's own recordings, tracks and logs."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from akm_fg.cli.fit import FitArguments, fit
from akm_fg.cli.fitting.folder import folders_of
from akm_fg.cli.fitting.progress import Progress
from akm_fg.cli.main import main
from akm_fg.io.recording import write_recording
from akm_fg.model.read import read_model


def _log(path: Path, stamps: bool = False) -> Path:
    angles = np.linspace(0, 1.0, 40)
    p = np.stack([0.5 * np.cos(angles), 0.5 * np.sin(angles), 0 * angles], axis=1)
    p += np.random.default_rng(0).normal(0, 5e-4, p.shape)
    t = 0.1 * np.arange(40)[:, None]
    np.savetxt(path, np.hstack([t, p]) if stamps else p, header="t x y z" if stamps else "")
    return path


def test_a_recording_leaves_a_page_with_pictures(
    door, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "door", door.recording)
    out = tmp_path / "out"
    assert main(["fit", str(tmp_path / "door"), "--out", str(out)]) == 0
    captured = capfd.readouterr()
    posterior = json.loads((out / "posterior.json").read_text())
    assert posterior["kind"] == "revolute" and posterior["input"] == str(tmp_path / "door")
    page = (out / "report.html").read_text()
    assert page.count("data:image/jpeg") == len(list((out / "pictures").glob("*.jpg"))) >= 2
    assert f"akm-fg fit {tmp_path / 'door'} --seed 0" in page and "moving part" in page
    assert cv2.imread(str(min((out / "pictures").glob("*.jpg")))) is not None
    assert (out / "config.toml").exists()
    assert "In three dimensions" in page and ("<iframe" in page or "install akm-fg[view]" in page)
    model = read_model(out)
    assert model.sources == (str(tmp_path / "door"),)
    assert model.parts[0].posterior.to_dict() == posterior
    assert "report.html" in captured.out
    frames = len(door.recording.frames)
    assert f"frame {frames} of {frames}; fitting the joint" in captured.err


def test_logs_and_tracks_get_their_paths_drawn(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    shape, q = rng.uniform(-0.2, 0.2, (12, 3)), np.linspace(0.0, 0.15, 8)
    points = shape + q[:, None, None] * np.array([0.0, 0.0, 1.0])
    points = points + rng.normal(0, 1e-3, points.shape)
    points[3, 2] = np.nan
    np.savez(tmp_path / "drawer.npz", points=points, sigma_m=0.001)
    inputs = [tmp_path / "drawer.npz", _log(tmp_path / "a.tum", True), _log(tmp_path / "b.log")]
    out = tmp_path / "out"
    assert main(["fit", *map(str, inputs), "--out", str(out)]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["a", "b", "drawer"]
    pages = {name: (out / name / "report.html").read_text() for name in ("a", "b", "drawer")}
    for page in pages.values():
        assert len(re.findall("<svg", page)) == 3 and "image/jpeg" not in page
        assert "What the camera saw" not in page and "camera" not in page
    assert "12 points in 8 frames" in pages["drawer"]
    assert "the path of one point through 40 frames" in pages["a"]


def test_a_place_that_is_a_file_is_told_first(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine")
    assert main(["fit", str(_log(tmp_path / "a.log")), "--out", str(taken)]) == 2
    captured = capfd.readouterr()
    assert "taken: cannot be made" in captured.err and captured.out == ""
    assert taken.read_text() == "mine"


def test_what_was_done_before_an_interruption_is_named_with_its_place(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log, out = _log(tmp_path / "a.log"), tmp_path / "out"

    def interrupted_at_the_second(number: int, total: int, path: Path) -> None:
        if number == 2:
            raise KeyboardInterrupt

    code = fit(FitArguments((log, log), out=out), progress=interrupted_at_the_second)
    assert code == 130
    assert f"1 of 2 inputs done, kept in {out}" in capfd.readouterr().err
    assert (out / "a.log" / "report.html").exists()


def test_each_input_has_a_folder_of_its_own() -> None:
    out = Path("out")
    assert folders_of(out, [Path("x/a.npz")]) == [out]
    assert folders_of(out, [Path("x/a.npz"), Path("b.log")]) == [out / "a", out / "b"]
    runs = [Path("runs/1/recording"), Path("runs/2/recording")]
    assert folders_of(out, runs) == [out / "1-recording", out / "2-recording"]
    twice = folders_of(out, [Path("a.npz")] * 3)
    assert len(set(twice)) == 3
    (evil, _) = folders_of(out, [Path("../..\n/.."), Path("b")])
    assert evil.parent == out and evil.name not in ("", ".", "..")


def test_without_a_folder_or_a_terminal_progress_is_silent(
    capfd: pytest.CaptureFixture[str],
) -> None:
    for as_lines, lines in ((False, 0), (True, 3)):
        progress = Progress(as_lines)
        progress.input(1, 2, Path("a\n"))
        for frame in range(1, 61):
            progress.watched(frame, 60)
        progress.done()
        assert len(capfd.readouterr().err.splitlines()) == lines


def test_the_folder_of_another_run_is_left_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, run = _log(tmp_path / "a.log"), tmp_path / "run"
    run.mkdir()
    (run / "config.toml").write_text("# All settings of akm-fg explore x\n")
    assert main(["fit", str(log), "--out", str(run)]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1 and "is of another run" in told[0] and "expected a new folder" in told[0]
    assert [file.name for file in run.iterdir()] == ["config.toml"]
    other = tmp_path / "mine"
    assert main(["fit", str(log), "--out", str(other)]) in (0, 1)
    assert main(["fit", str(log), "--out", str(other)]) in (0, 1)  # its own may be written again
