"""Names of files, objects and parts are printed as they are, whatever Rich would make of them."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from akm_fg.cli.console.lines import console, tell
from akm_fg.cli.main import main
from akm_fg.io.recording import write_recording
from akm_fg.model.write import write_model

NAMES = ("[red]x", "[", "e[", ":cat:", "\x1b[31mred", "a\nb")
SHOWN = ("[red]x", "[", "e[", ":cat:", r"\x1b[31mred", r"a\nb")
MARKUP = "[red]x[/red] [/] :cat:"


def test_lines_tables_and_titles_hold_what_they_were_given(
    capfd: pytest.CaptureFixture[str],
) -> None:
    from rich.table import Table

    table = Table("[/]", title=MARKUP)
    table.add_row(MARKUP)
    out = console()
    out.print(MARKUP)
    out.print(table)
    printed = capfd.readouterr().out
    assert printed.count(MARKUP) == 3 and "[/]" in printed.replace(MARKUP, "")


def test_what_comes_next_is_one_line_of_text(capfd: pytest.CaptureFixture[str]) -> None:
    tell("reads a\nb\x1b[31m[/]", time.perf_counter())
    assert capfd.readouterr().err == "   0.0 s  reads a\\nb\\x1b[31m[/]\n"


@pytest.mark.parametrize(("name", "shown"), list(zip(NAMES, SHOWN, strict=True)))
def test_an_object_of_ones_own_is_listed_under_its_name(
    name: str,
    shown: str,
    mobility_object: Callable,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("pybullet")
    monkeypatch.chdir(tmp_path)
    (Path(name) / "]").mkdir(parents=True)  # so that `[/]` is among the paths
    mobility_object().write(Path(name) / "]")
    assert main(["objects", "--suite", "partnet", "--folder", f"{name}/]"]) == 0
    printed = capfd.readouterr().out
    assert f"partnet:{shown}/]" in printed and f"{shown}/]: " in printed


def test_parts_are_told_under_their_names(
    door_model, door, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "model").mkdir()
    write_model(tmp_path / "model", door_model)
    write_recording(tmp_path / "door", door.recording)
    file = tmp_path / "model" / "model.json"
    file.write_text(re.sub(r'("name": *)"part-0"', r'\1"[red]x[/red]"', file.read_text()))
    assert main(["relocalize", str(tmp_path / "model"), str(tmp_path / "door")]) == 0
    assert "[red]x[/red]" in capfd.readouterr().out
