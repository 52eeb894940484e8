"""Every `python -m ...` line of README and of the pages is run, each with one trial.

Flags that cut it down are added at its end, where they win over those of the page. What it reads is
made by the page's own line that writes it, cut down as well.
"""

from __future__ import annotations

import importlib
import os
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.docs.test_commands import ROOT, typed

pytest.importorskip("pybullet")

TIMEOUT_S = 1800.0
ONE_CELL = "--runs 1 --cells 'door 15*clean'"
CUT = {
    "experiments.accuracy_grid": ONE_CELL,
    "experiments.along_the_pull": "--limit 1",
    "experiments.claims.coverage": "",
    "experiments.claims.cramer_rao": "",
    "experiments.claims.pose_logs": "--runs 1",
    "experiments.claims.reliability": "--runs 1",
    "experiments.claims.rig_errors": "",
    "experiments.closed_loop": "--limit 1 --tasks 1",
    "experiments.demo_seeds": "--seeds 1",
    "experiments.faults": "--faults 1",
    "experiments.exploration": "--limit 1",
    "experiments.gallery": "--only door",
    "experiments.hands.approaches": "--trials 1",
    "experiments.hands.oracle_pulls": "--limit 1",
    "experiments.hands.published_reach": "--limit 1",
    "experiments.kind_against_travel": "--runs 1 --travels 15",
    "experiments.relocalization": "--limit 1 --states 1",
    "experiments.rendered_recordings": "--objects 1",
    "experiments.report": "--page experiments.md",
    "experiments.speed": "--repeats 1",
    "experiments.stream": "--long-every 0",
    "experiments.surface_gain": "--limit 1 --methods graph-both",
    "sim.objects.contact_sheet": "--only door-001",
}
WRITTEN_BY = {  # a folder that some lines read: how the line begins that leaves it
    "runs/accuracy": "experiments.accuracy_grid --part table --method graph",
    "runs/surface-gain": "experiments.surface_gain --recordings runs/recordings",
    "runs/recordings": "experiments.rendered_recordings --suite furniture-116 --out",
    "runs/dev-recordings": "experiments.rendered_recordings --suite furniture-dev --out",
    "runs/exploration/furniture-116": "experiments.exploration --suite furniture-116",
    "runs/closed-loop/furniture-116/models": "experiments.closed_loop --suite furniture-116",
}
READ_UNSAID = {"experiments.report": ("runs/accuracy",)}
PEER = "--method peer"  # lives in an environment of its own, that `make peer` sets up


def lines() -> list[str]:
    """Each different line once, its module first."""
    found = {shlex.join(shlex.split(p.values[0], comments=True)[2:]) for p in typed("python -m ")}
    return sorted(line for line in found if line.startswith(("experiments.", "sim.")))


@dataclass(frozen=True, slots=True)
class Bench:
    """A folder in which lines are run, each at most once."""

    folder: Path
    done: dict[str, str] = field(default_factory=dict)  # what each said

    def run(self, line: str) -> str:
        """What the line says, cut down; what it reads is made first."""
        if line in self.done:
            return self.done[line]
        module, *words = shlex.split(line)
        for read in [*words, *READ_UNSAID.get(module, ())]:
            start = WRITTEN_BY.get(read)
            if start is not None and not line.startswith(start):
                self.run(next(other for other in lines() if other.startswith(start)))
        command = [sys.executable, "-m", module, *words, *shlex.split(CUT[module])]
        paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        done = subprocess.run(
            command,
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": paths},
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        assert "Traceback" not in done.stderr, done.stderr
        self.done[line] = done.stdout
        return done.stdout


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = tmp_path_factory.mktemp("bench")
    shutil.copy(ROOT / "docs" / "experiments.md", folder)
    return Bench(folder)


def test_every_line_can_be_cut_down_and_what_it_reads_be_made() -> None:
    assert {line.split()[0] for line in lines()} == set(CUT)
    for start in WRITTEN_BY.values():
        assert any(line.startswith(start) for line in lines()), start
    read = {
        word
        for line in lines()
        for flag, word in zip(line.split(), line.split()[1:], strict=False)
        if flag in ("--recordings", "--rows", "--tracks", "--models")
    }
    assert read <= set(WRITTEN_BY)


@pytest.mark.slow
@pytest.mark.parametrize("line", lines())
def test_a_line_runs(line: str, bench: Bench) -> None:
    if PEER in line and not (ROOT / ".venv-peer").exists():
        pytest.skip("the peer is not installed: `make peer`")
    bench.run(line)
    words = shlex.split(line)
    if "--out" in words:
        assert (bench.folder / words[words.index("--out") + 1]).exists()


@pytest.mark.parametrize("module", ["stream", "surface_gain", "claims.rig_errors"])
def test_without_recordings_it_says_what_makes_them(
    module: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [module, "--recordings", "nowhere"])
    with pytest.raises(SystemExit, match=r"has no recordings: run experiments\."):
        importlib.import_module(f"experiments.{module}").main()


def test_without_rows_the_bound_says_what_makes_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["cramer_rao"])
    with pytest.raises(SystemExit, match=r"run experiments\.accuracy_grid"):
        importlib.import_module("experiments.claims.cramer_rao").main()
