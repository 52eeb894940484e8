"""The commands and the Python of docs/model.md are run as they stand there."""

from __future__ import annotations

import re
import shlex
from itertools import pairwise
from pathlib import Path

import pytest

import akm_fg
from akm_fg.cli.main import main
from akm_fg.export.config import ExportConfig
from akm_fg.export.pieces import convex_pieces
from akm_fg.io.recording_writer import write_recording
from akm_fg.model.write import write_model
from akm_fg.records import Recording

DOCS = Path(__file__).resolve().parents[3] / "docs" / "model.md"
COMMANDS = re.findall(r"^ {4}akm-fg (.+)$", DOCS.read_text(), re.M)
PYTHON = re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.S)


@pytest.fixture
def kitchen(door, door_model, tmp_path: Path, monkeypatch) -> Path:
    """A model where the page has one; meshes are small, and nothing waits for a browser."""
    (tmp_path / "runs" / "kitchen").mkdir(parents=True)
    write_model(tmp_path / "runs" / "kitchen", door_model)
    later = Recording("later", door.frames[::5])
    write_recording(tmp_path / "runs" / "kitchen" / "recording", later)
    monkeypatch.chdir(tmp_path)
    small = ExportConfig(triangles=500, poisson_depth=5)
    monkeypatch.setattr("akm_fg.export.describe.ExportConfig", lambda: small)
    monkeypatch.setattr(
        "akm_fg.export.describe.convex_pieces",
        lambda mesh, config, _: convex_pieces(mesh, config, one_hull=True),
    )
    monkeypatch.setattr("akm_fg.cli.models.view._serve", lambda *_: None)
    return tmp_path


def test_the_page_has_commands_and_python() -> None:
    assert len(COMMANDS) >= 6 and len(PYTHON) >= 1


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_page_runs(kitchen: Path, command: str) -> None:
    for package in ("viser", "trimesh", *(["rerun"] if "--rerun" in command else [])):
        pytest.importorskip(package)
    words = shlex.split(command)
    assert main(words) == 0
    for flag, written in pairwise(words):
        if flag in ("--urdf", "--mjcf", "--glb", "--html", "--rerun"):
            assert (kitchen / written).exists()


def test_the_python_of_the_page_runs(kitchen: Path, door_model, monkeypatch) -> None:
    pytest.importorskip("pandas")
    monkeypatch.setattr(akm_fg, "fit", lambda _: door_model.parts[0].posterior)
    names: dict[str, object] = {}
    for block in PYTHON:
        exec(block, names)
    assert isinstance(names["model"], akm_fg.ObjectModel)
