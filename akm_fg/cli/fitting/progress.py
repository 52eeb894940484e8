"""How far a fit has come, on standard error."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from akm_fg.cli.console.lines import tell
from akm_fg.report.wording import printable

FRAMES_A_LINE = 50  # where lines stay, because there is no terminal that they can be written over


class Progress:
    """One line that is written over in a terminal; a line a step elsewhere, if asked for."""

    def __init__(self, steps_as_lines: bool) -> None:
        self._terminal = sys.stderr.isatty()
        self._lines = steps_as_lines and not self._terminal
        self._began = time.perf_counter()
        self._input = ""

    def input(self, number: int, total: int, path: Path) -> None:
        """An input's turn has come; numbers count from 1."""
        count = f"{number}/{total} " if total > 1 else ""
        self._input = f"{count}{printable(str(path))}"
        self._say("")

    def watched(self, frame: int, frames: int) -> None:
        """So many frames of a recording are done."""
        if self._terminal or frame % FRAMES_A_LINE == 0 or frame == frames:
            rest = "; fitting the joint" if frame == frames else ""
            self._say(f": frame {frame} of {frames}{rest}")

    def writing(self, folder: Path) -> None:
        """The report is being made."""
        self._say(f": writing {printable(str(folder))}")

    def done(self) -> None:
        """Leave a terminal's line empty."""
        if self._terminal:
            print("\r\033[K", end="", file=sys.stderr, flush=True)

    def _say(self, words: str) -> None:
        line = f"{self._input}{words}"
        if self._terminal:
            print(f"\r\033[K{line}", end="", file=sys.stderr, flush=True)
        elif self._lines:
            tell(line, self._began)
