"""`akm-fg convert`: what it says, what it writes, what it leaves; every command of its page."""

from __future__ import annotations

import json
import re
import resource
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.cli.main import main
from akm_fg.io.conventions import GL_FROM_CV
from akm_fg.io.recording import read_recording, write_recording
from akm_fg.io.sources.prepare import Prepared
from akm_fg.io.sources.registry import read_source
from akm_fg.records import Recording

PAGE = Path(__file__).resolve().parents[4] / "docs" / "convert.md"


@pytest.fixture(scope="module")
def few(mm_door: Recording) -> Recording:
    return replace(mm_door, frames=mm_door.frames[:4])


@pytest.fixture(scope="module")
def tum(write: dict, tmp_path_factory: pytest.TempPathFactory, few: Recording) -> Path:
    return write["tum"](tmp_path_factory.mktemp("a") / "kitchen", few)


def test_it_says_what_it_understood_and_writes_what_fit_would_read(
    tum: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out, what = tmp_path / "new" / "out", tmp_path / "what.json"
    assert main(["convert", str(tum), str(out), "--json", str(what)]) == 0
    said = capfd.readouterr().out
    for words in (
        "4 frames of 320x240, 0.30 s, 10.0 Hz",
        "0.0002 m (the format's 1/5000 m)",
        "stands still; poses of groundtruth.txt",
        "OpenCV, T_world_cam (the format's; the floor agrees)",
        "floor 0.95 m below the camera",
        f"wrote {out}; next: akm-fg fit {out}",
    ):
        assert words in said
    assert max(map(len, said.splitlines()[1:-1])) <= 80
    described = json.loads(what.read_text())
    assert described["schema"] == "akm-fg/convert/1" and described["out"] == str(out)
    assert described["frames"] == 4 and described["camera"]["fx"] == 340.0
    got, want = read_recording(out), read_source(tum)
    for frame, true in zip(got.frames, want.frames, strict=True):
        np.testing.assert_array_equal(frame.rgb, true.rgb)
        np.testing.assert_array_equal(frame.depth_m, true.depth_m)
        assert frame.T_world_cam.equals(true.T_world_cam, 0) and frame.stamp_s == true.stamp_s
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == ["out"]


def test_without_a_place_nothing_is_written(
    tum: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["convert", str(tum), "--json", "-"]) == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["out"] is None
    assert list(tmp_path.iterdir()) == []


def test_frames_are_chosen_by_time_and_number(tum: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "out")
    assert main(["convert", str(tum), out, "--start", "0.05", "--every", "2"]) == 0
    stamps = [frame.stamp_s for frame in read_recording(Path(out)).frames]
    np.testing.assert_allclose(stamps, [1000.1, 1000.3])


def test_a_folder_that_is_in_our_format_already_is_told_so(
    mm_door: Recording, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "door", mm_door)
    assert main(["convert", str(tmp_path / "door"), str(tmp_path / "out")]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert "door: is a recording folder already; expected" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--intrinsics", "a,b"], "--intrinsics: is 'a,b'; expected fx,fy,cx,cy"),
        (["--intrinsics", "1,2"], "--intrinsics: gives 2 numbers"),
        (["--intrinsics", "nan,nan,nan,nan"], "must be finite"),
        (["--rate", "0"], "--rate: is 0; expected pictures a second"),
        (["--every", "0"], "--every: is 0; expected 1 or more"),
        (["--frames", "1"], "--frames: is 1; expected 2 or more"),
        (["--depth-unit", "0"], "--depth-unit: depth_unit_m is 0.0"),
        (["--start", "99"], "holds 4 pairs of colour and depth, 0 of them chosen"),
        (["--start", "nan"], "0 of them chosen"),
    ],
)
def test_a_flag_that_makes_no_sense_is_one_line(
    flags: list[str], words: str, tum: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(tum), str(tmp_path / "out"), *flags]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert words in line and "; expected " in line
    assert list(tmp_path.iterdir()) == []


def test_what_stands_at_the_place_stays(
    tum: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    taken, file, link = tmp_path / "taken", tmp_path / "file", tmp_path / "link"
    taken.mkdir()
    (taken / "mine").write_text("precious")
    file.write_text("precious")
    link.symlink_to(tmp_path / "elsewhere")
    for place, words in ((taken, "is not empty"), (file, "is a file"), (link, "or a link")):
        assert main(["convert", str(tum), str(place)]) == 2
        assert words in capfd.readouterr().err
    assert (taken / "mine").read_text() == file.read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link", "taken"]


def test_a_full_disk_and_an_interruption_leave_nothing(
    tum: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        assert main(["convert", str(tum), str(tmp_path / "out")]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "cannot be written (File too large)" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []

    def stopped(self):
        yield from list(whole(self))[:2]
        raise KeyboardInterrupt

    whole = Prepared.frames
    monkeypatch.setattr(Prepared, "frames", stopped)
    assert main(["convert", str(tum), str(tmp_path / "out")]) == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("module", "file", "start", "extra"),
    [
        ("rosbags.highlevel", "a.bag", b"#ROSBAG V2.0\n", "io"),
        ("pyrealsense2", "a.bag", b"#ROSBAG V2.0\n/file_version", "realsense"),
        ("liblzfse", "a.r3d", b"PK", "io"),
    ],
)
def test_a_library_that_is_not_there_is_one_line(
    module: str,
    file: str,
    start: bytes,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / file).write_bytes(start)
    for command in ("convert", "fit"):
        assert main([command, str(tmp_path / file)]) == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert f"install akm-fg[{extra}]" in line and str(tmp_path / file) in line


def test_what_was_guessed_is_a_warning_of_the_posterior(
    write: dict, tmp_path: Path, mm_door: Recording
) -> None:
    turned = [replace(f, T_world_cam=f.T_world_cam * GL_FROM_CV) for f in mm_door.frames]
    path = write["tum"](tmp_path / "a", replace(mm_door, frames=tuple(turned)))
    assert main(["fit", str(path), "--json", str(tmp_path / "o")]) == 0
    posterior = json.loads((tmp_path / "o").read_text())
    assert posterior["fit"]["warnings"][0].startswith("camera poses read as T_world_cam in OpenGL")
    assert posterior["joint"]["axis"][2] < -0.99  # in the world of the poses as they were meant


def commands() -> list[str]:
    """Those of the page, in its order."""
    blocks = re.findall(r"```\n(.*?)```", PAGE.read_text(), flags=re.S)
    return [line for block in blocks for line in block.splitlines() if line.startswith("akm-fg ")]


def make_sources(folder: Path, write: dict, recording: Recording) -> None:
    """All that the page's commands name."""
    hand = gtsam.Pose3(gtsam.Rot3(), np.array([0.4, 0.0, 0.5]))

    def with_hand(make):
        for topic, s, message in write["entries"](recording)(make):
            yield topic, s, message
            if topic.endswith("camera_info"):
                yield "/tf", s, make.tf(make.transform(s, "world", "panda_hand_tcp", hand))

    write["bag"](folder / "kitchen.bag", "ros1", with_hand)
    write["tum"](folder / "tum_folder", recording)
    write["redwood"](folder / "open3d_folder", recording)
    write["ros2"](folder / "ros2_folder", recording)
    write["mcap"](folder / "mcap", recording).rename(folder / "kitchen.mcap")
    write["realsense"](folder / "d455", recording)
    write["r3d"](folder / "phone", recording)
    write["video"](folder / "clip_folder", recording)


@pytest.mark.parametrize("name", [pytest.param("fit", marks=pytest.mark.slow), "convert"])
def test_every_command_of_the_page_runs(
    name: str,
    write: dict,
    tmp_path: Path,
    mm_door: Recording,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    for library in ("rosbags", "av", "liblzfse", "pyrealsense2", "open3d"):
        pytest.importorskip(library)
    step = 1 if name == "fit" else 3
    make_sources(tmp_path, write, replace(mm_door, frames=mm_door.frames[::step]))
    monkeypatch.chdir(tmp_path)
    done = [c for c in commands() if name == "fit" or c.startswith("akm-fg convert")]
    assert len(done) > 10
    for command in done:
        assert main(shlex.split(command)[1:]) == 0, (command, capfd.readouterr().err)
    assert read_recording(tmp_path / "recordings" / "hand").T_world_gripper is not None
