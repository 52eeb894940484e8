"""A disk that is full: what was done is readable, nothing half-written is taken for whole.

On a file system of its own in memory, which only root may mount.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.cli.main import main
from akm_fg.errors import OutputError
from akm_fg.io.png import replace_file
from akm_fg.io.recording_reader import read_recording
from akm_fg.io.recording_writer import RecordingWriter
from akm_fg.records import PinholeCamera, RgbdFrame

SIZE = 1 << 20
BLOCK = 4096
CAMERA = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A folder that holds a megabyte, and no more."""
    if os.geteuid() != 0:
        pytest.skip("only root may mount a file system")
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(place)]
    if subprocess.run(mount, check=False, capture_output=True).returncode != 0:
        pytest.skip("no file system can be mounted here")
    try:
        yield place
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)


def fill(disk: Path, leave: int) -> Path:
    """A file that leaves so many bytes."""
    found = os.statvfs(disk)
    ballast = disk / "ballast"
    ballast.write_bytes(bytes(found.f_bavail * found.f_frsize - leave))
    return ballast


def noisy_frame(number: int) -> RgbdFrame:
    """No two pixels alike: 60 kB of PNG."""
    rng = np.random.default_rng(number)
    shape = (CAMERA.height, CAMERA.width)
    depth_m = rng.uniform(0.5, 2.0, shape).round(3).astype(np.float32)
    rgb = rng.integers(0, 256, (*shape, 3), dtype=np.uint8)
    return RgbdFrame(float(number), rgb, depth_m, CAMERA, gtsam.Pose3())


def halves(folder: Path) -> list[Path]:
    """Files that were not finished."""
    return [path for path in folder.rglob("*") if path.name.endswith(".part")]


def logs(folder: Path, count: int) -> list[str]:
    """Pose logs of a drawer."""
    folder.mkdir()
    paths = []
    for seed in range(count):
        rng, q = np.random.default_rng(seed), np.linspace(0.0, 0.3, 20)
        rows = np.stack([0.5 - q, np.full(20, 0.1), np.full(20, 0.4)], axis=1)
        path = folder / f"log-{seed}.txt"
        np.savetxt(path, rows + 1e-3 * rng.normal(size=rows.shape))
        paths.append(str(path))
    return paths


def test_a_recording_holds_every_frame_that_was_written_before(disk: Path) -> None:
    folder, number = disk / "recording", 0
    with RecordingWriter(folder) as writer:
        with pytest.raises(OutputError, match="No space left on device") as failed:
            while True:
                writer.add(noisy_frame(number))
                number += 1
        assert "\n" not in str(failed.value)
        assert number > 5
    found = read_recording(folder)
    assert len(found.frames) == number
    np.testing.assert_array_equal(found.frames[-1].rgb, noisy_frame(number - 1).rgb)
    np.testing.assert_allclose(found.frames[-1].depth_m, noisy_frame(number - 1).depth_m, atol=1e-6)
    assert halves(folder) == []


def test_a_file_keeps_what_it_held_where_the_new_does_not_fit(disk: Path) -> None:
    path = disk / "model.json"
    replace_file(path, b"old")
    fill(disk, leave=2 * BLOCK)
    with pytest.raises(OutputError, match="No space left on device"):
        replace_file(path, bytes(10 * BLOCK))
    assert path.read_bytes() == b"old"
    assert halves(disk) == []


def test_results_are_whole_lines_of_what_was_fitted_before(
    disk: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = disk / "out.jsonl"
    paths = logs(tmp_path / "logs", 4)
    fill(disk, leave=7 * BLOCK)  # for the settings beside the results, and for some lines
    assert main(["fit", *paths, "--json", str(out)]) == 2
    said = capfd.readouterr().err.strip().splitlines()
    assert any("No space left on device" in line for line in said)
    assert not any("Traceback" in line for line in said)
    lines = out.read_text().splitlines(keepends=True)
    assert 0 < len(lines) < len(paths)
    for line in lines:
        assert line.endswith("\n") and json.loads(line)["schema"] == "akm-fg/posterior/1"


def test_a_page_that_does_not_fit_is_one_line_and_leaves_nothing_half(
    disk: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (path,) = logs(tmp_path / "logs", 1)
    fill(disk, leave=5 * BLOCK)
    assert main(["fit", path, "--out", str(disk / "run")]) == 2
    said = capfd.readouterr().err
    assert "No space left on device" in said and "Traceback" not in said
    for found in disk.rglob("*.json"):
        json.loads(found.read_text())
    for page in disk.rglob("*.html"):
        assert page.read_text().rstrip().endswith("</html>")
    assert halves(disk) == []


def test_nothing_half_made_stays_in_a_cache_without_room(
    disk: Path,
    mobility_object: type,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("pybullet", reason="the simulator is not installed")
    cabinet = mobility_object().write(tmp_path / "46236")
    monkeypatch.setenv("XDG_CACHE_HOME", str(disk))
    ballast = fill(disk, leave=0)
    words = ["explore", "--object", str(cabinet), "--out", str(tmp_path / "runs")]
    assert main([*words, "--max-attempts", "1", "--without-ca"]) == 2
    said = capfd.readouterr().err.strip()
    assert said.splitlines()[-1].startswith(
        f"akm-fg: {disk / 'akm-fg'}: cannot be written (No space"
    )
    assert "Traceback" not in said
    ballast.unlink()
    left = [path for path in (disk / "akm-fg").iterdir() if not path.name.startswith(".")]
    assert left == []
