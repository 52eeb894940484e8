"""Every `akm-fg` line in a block of README and of the pages is run, in a folder made for it.

Not here: what `make`, `pip` and the experiments do (these run for hours; `test_commands.py` checks
that they exist and have the flags), and what `ELSEWHERE` and `HARDWARE` name.
"""

from __future__ import annotations

import shlex
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest

from akm_fg.cli.main import main
from tests.docs.test_commands import PAGES, ROOT, lines_to_type

pytest.importorskip("pybullet")
from tests.docs.stand_ins import MAKERS, Stock

# Its commands are run one after another by tests/akm_fg/io/sources/test_convert_command.py.
ELSEWHERE = ROOT / "docs" / "convert.md"
# The address of a robot: its lines are for a Franka, whose stand-in the `hardware` tests have.
HARDWARE = "172.16.0.2"
OUTPUT_FLAGS = ("--out", "--json", "--picture", "--simulate", "--urdf", "--mjcf", "--glb",
                "--html", "--rerun")  # fmt: skip
# A simulated robot may not reach its goal; the pages say that 1 is the answer then.
MAY_END_WITH_ONE = ("demo", "explore", "run")
HAND_CAMERA, HAND_CAMERA_BOARD = "--camera-place gripper", "a hand camera's board"


def lines() -> list[object]:
    """Each different line once, with the page where it is met first."""
    found = {
        shlex.join(shlex.split(line, comments=True)): page.relative_to(ROOT)
        for page in reversed(PAGES)
        if page != ELSEWHERE
        for line in lines_to_type(page)
        if line.startswith("akm-fg ") and HARDWARE not in line
    }
    return [pytest.param(line, id=f"{page}: {line}") for line, page in found.items()]


def split(words: list[str]) -> tuple[list[str], list[str]]:
    """The names of what a command reads (that have stand-ins) and of what it writes."""
    outputs = [word for flag, word in pairwise(words) if flag in OUTPUT_FLAGS]
    if words[0] == "convert" and len(words) > 2 and not words[2].startswith("-"):
        outputs.append(words[2])
    names = [word.rstrip("/") for word in words[1:] if word not in outputs]
    return [name for name in names if name in MAKERS], outputs


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Stock:
    for library in ("rosbags", "liblzfse", "viser"):
        pytest.importorskip(library)
    return Stock(tmp_path_factory.mktemp("stock"))


def interrupted(_: float) -> None:
    """Instead of sleeping: Ctrl-C, as soon as the page is served."""
    raise KeyboardInterrupt


def test_reads_and_writes_are_told_apart() -> None:
    words = "convert phone.r3d recordings/phone --every 6".split()
    assert split(words) == (["phone.r3d"], ["recordings/phone"])
    words = "fit my_cabinet/ tracks.npz --json posteriors.jsonl".split()
    assert split(words) == (["my_cabinet", "tracks.npz"], ["posteriors.jsonl"])
    assert len(lines()) > 50


@pytest.mark.slow
@pytest.mark.parametrize("line", lines())
def test_a_line_runs(
    line: str,
    stock: Stock,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    words = shlex.split(line)[1:]
    inputs, outputs = split(words)
    for name in inputs:
        made = name
        if HAND_CAMERA in line:
            made = HAND_CAMERA_BOARD
        elif f"--write {name}" in line:  # of the camera that saw the board
            made = "recordings/board"
        stock.put(made, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("akm_fg.cli.models.view.time", SimpleNamespace(sleep=interrupted))
    capfd.readouterr()
    code = main(words)
    said = "".join(capfd.readouterr())
    assert code == 0 or (code == 1 and words[0] in MAY_END_WITH_ONE), said
    assert "Traceback" not in said
    if code == 0:
        assert all((tmp_path / output).exists() for output in outputs)
