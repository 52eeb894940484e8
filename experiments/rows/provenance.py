"""Where rows come from: command, revision, machine, versions; a JSON line for each run."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from akm_fg.config import AkmConfig
from akm_fg.io.config_file import config_as_dict

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FILE = "provenance.json-lines"  # not *.jsonl: those are rows
_PACKAGES = ("numpy", "scipy", "gtsam")


def note_run(folder: Path, experiment: DataclassInstance | None = None) -> None:
    """Add what is run now, on what, to a folder of rows, with all settings.

    Args:
        folder: of the rows.
        experiment: its configuration; the program's own tree is noted anyway.
    """
    folder.mkdir(parents=True, exist_ok=True)
    note = {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": " ".join(["python -m", _module(), *sys.argv[1:]]),
        "revision": _revision(),
        "machine": machine(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in _PACKAGES},
        "experiment": {} if experiment is None else config_as_dict(experiment),
        "config": config_as_dict(AkmConfig()),
    }
    with (folder / FILE).open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(note, default=str) + "\n")


def runs_of(folder: Path) -> list[dict[str, Any]]:
    """The notes of a folder, oldest first."""
    file = folder / FILE
    if not file.exists():
        return []
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def machine() -> str:
    """Processor and number of cores."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    return f"{model}, {os.cpu_count()} cores"


def _module() -> str:
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    return spec.name if spec is not None else Path(sys.argv[0]).name


def _revision() -> str:
    """The commit, "-dirty" where files were changed since; "unknown" outside a repository."""
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    done = subprocess.run(
        command, cwd=Path(__file__).parent, check=False, capture_output=True, text=True
    )
    return done.stdout.strip() or "unknown"
