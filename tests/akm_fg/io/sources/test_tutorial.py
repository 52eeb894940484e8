"""The commands of the tutorial do what the page shows, on a folder such as it describes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from akm_fg.cli.main import main
from akm_fg.records import Recording

PAGE = Path(__file__).resolve().parents[4] / "docs" / "start" / "tutorial.md"
FENCED = re.findall(r"^```(\w*)\n(.*?)^```", PAGE.read_text(), re.S | re.M)
BLOCKS = [body for language, body in FENCED if not language]


@pytest.fixture
def place(write: dict, tmp_path: Path, mm_door: Recording, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place in which `my_tum` is the rendered door."""
    write["tum"](tmp_path / "my_tum", mm_door)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def typed(start: str) -> list[str]:
    """The words after `akm-fg` of the page's only command that begins so."""
    (line,) = (x for block in BLOCKS for x in block.splitlines() if x.startswith(start))
    return shlex.split(line)[1:]


def shown(start: str) -> list[str]:
    """The lines of what the page shows of a command's output."""
    (block,) = (block for block in BLOCKS if block.startswith(start))
    return [line.rstrip() for line in block.strip().splitlines()]


def test_convert_says_what_the_page_shows(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(typed("akm-fg convert")) == 0
    said = [line.rstrip() for line in capfd.readouterr().out.strip().splitlines()]
    assert said == shown("my_tum\nformat")
    assert [path.name for path in place.iterdir()] == ["my_tum"]


def test_check_finds_nothing_and_leaves_the_picture_that_the_page_names(place: Path) -> None:
    assert main(typed("akm-fg check")) == 0
    assert (place / "checked" / "overlay.jpg").exists()


@pytest.mark.slow
def test_fit_shows_the_pages_table_and_leaves_its_files(
    place: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(typed("akm-fg fit")) == 0
    said = [line.rstrip() for line in capfd.readouterr().out.strip().splitlines()]
    assert said == shown("┏")
    for name in re.findall(r"^- `(\S+)`: ", PAGE.read_text(), re.M):
        assert (place / "runs" / "my_tum" / name).exists()
    assert main(typed("akm-fg export")) == 0
    assert (place / "my_door" / "object.urdf").exists()
