"""Results on disk: the old file or whole lines of the new one, whatever happens."""

import os
import resource
import signal
import stat
from pathlib import Path

import numpy as np
import pytest

from akm_fg.config import AkmConfig
from akm_fg.errors import OutputError
from akm_fg.io.config_file import write_config
from akm_fg.io.files.results import ResultFile
from akm_fg.io.tracks import write_tracks
from akm_fg.records import PointTracks


def test_an_old_file_stays_until_the_first_line(tmp_path: Path) -> None:
    out = tmp_path / "out.jsonl"
    out.write_text("old\n")
    with ResultFile(out) as results:
        assert out.read_text() == "old\n"
        results.write_line("a")
        assert out.read_text() == "a\n"
        results.write_line("b")
        assert out.read_text() == "a\nb\n"
    assert os.listdir(tmp_path) == ["out.jsonl"]


def test_nothing_written_leaves_all_as_it_was(tmp_path: Path) -> None:
    out = tmp_path / "out.jsonl"
    with ResultFile(out):
        pass
    assert os.listdir(tmp_path) == []
    out.write_text("old\n")
    with pytest.raises(KeyboardInterrupt), ResultFile(out):
        raise KeyboardInterrupt
    assert out.read_text() == "old\n" and os.listdir(tmp_path) == ["out.jsonl"]


def test_a_line_that_the_disk_refuses_is_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out.jsonl"
    with ResultFile(out) as results:
        results.write_line("whole")
        file = results._file

        class Full:
            truncate, close = file.truncate, file.close

            def write(self, data: memoryview) -> int:
                if len(data) > 3:
                    return file.write(data[:3])
                raise OSError(28, "No space left on device")

        monkeypatch.setattr(results, "_file", Full())
        with pytest.raises(OutputError, match="No space left"):
            results.write_line("broken")
        assert out.read_text() == "whole\n"


def test_a_refused_first_line_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out.jsonl"
    out.write_text("old\n")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError), ResultFile(out) as results:
        results.write_line("a")
    assert out.read_text() == "old\n" and os.listdir(tmp_path) == ["out.jsonl"]


def test_a_link_goes_on_pointing_where_it_does(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    real, link = tmp_path / "there" / "real.jsonl", tmp_path / "link.jsonl"
    real.write_text("old\n")
    link.symlink_to(real)
    with ResultFile(link) as results:
        results.write_line("a")
    assert link.is_symlink() and real.read_text() == "a\n"


def test_permissions_are_those_of_the_old_file_or_the_usual(tmp_path: Path) -> None:
    out, new = tmp_path / "out", tmp_path / "new"
    out.write_text("")
    out.chmod(0o640)
    usual = tmp_path / "usual"
    usual.touch()
    for path in (out, new):
        with ResultFile(path) as results:
            results.write_line("a")
    assert stat.S_IMODE(out.stat().st_mode) == 0o640
    assert new.stat().st_mode == usual.stat().st_mode


def test_a_device_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    with ResultFile(Path("/dev/null")) as results:
        results.write_line("a")
    assert not Path("/dev/null").is_file()
    with pytest.raises(OutputError, match="No space left"), ResultFile(Path("/dev/full")) as full:
        full.write_line("a")


@pytest.mark.parametrize("name", ["no/such/folder/a", ".", "x" * 300])
def test_a_place_that_cannot_be_written_is_told_first(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        ResultFile(tmp_path / name)


def test_tracks_and_settings_that_a_full_disk_refuses_leave_the_old_files(tmp_path: Path) -> None:
    small, large = (
        PointTracks(np.zeros((4, n, 3)), np.random.default_rng(0).normal(size=(4, n, 3, 3)))
        for n in (2, 500)
    )
    tracks, settings = tmp_path / "a.npz", tmp_path / "c.toml"
    write_tracks(tracks, small)
    write_config(settings, AkmConfig())
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
        with pytest.raises(OutputError, match="cannot be written"):
            write_tracks(tracks, large)
        with pytest.raises(OutputError, match="cannot be written"):
            write_config(settings, AkmConfig(), ("again",))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
