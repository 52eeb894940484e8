"""A robot on loopback with a drawer before it (`franka_counterpart`)."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest

HANDLE_M = np.array([0.50, 0.0, 0.45])  # of the drawer of `franka_counterpart`
COUNTERPART = Path(__file__).with_name("franka_counterpart.py")
NEEDED = ("franky", "franky_sim")


class Counterpart:
    """The process that stands in for robot and drawer."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        assert process.stdin is not None and process.stdout is not None
        self._in, self._out = process.stdin, process.stdout
        self.host = self._out.readline().strip()

    def ask(self, command: str) -> Any:
        """One of the counterpart's commands."""
        self.tell(command)
        return json.loads(self._out.readline())

    def tell(self, command: str) -> None:
        """A command that has no answer."""
        self._in.write(command + "\n")
        self._in.flush()


@contextmanager
def running(*words: str) -> Iterator[Counterpart]:
    """A robot on this computer, at home, its fingers half open."""
    for module in NEEDED:
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed: `make test-hardware` installs it")
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, str(COUNTERPART), *words], stdin=pipe, stdout=pipe, text=True
    ) as process:
        try:
            yield Counterpart(process)
        finally:
            process.kill()


@pytest.fixture
def counterpart() -> Iterator[Counterpart]:
    """A robot with a drawer before it."""
    with running() as robot:
        yield robot


@pytest.fixture
def lonely_counterpart() -> Iterator[Counterpart]:
    """A robot with nothing before it."""
    with running("--empty") as robot:
        yield robot


@pytest.fixture
def T_world_handle() -> gtsam.Pose3:
    """A grasp of the handle from the front, the fingers above and below the bar."""
    y, z, x = np.eye(3)[1], np.eye(3)[2], np.eye(3)[0]
    return gtsam.Pose3(gtsam.Rot3(np.column_stack([y, z, x])), HANDLE_M)
