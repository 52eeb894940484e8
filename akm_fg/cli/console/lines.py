"""One line for a person, whatever the names of files hold and the terminal can show."""

from __future__ import annotations

import codecs
import os
import sys
import time

from rich.console import Console

from akm_fg.report.wording import ascii_text, printable

ERRORS = "akm_fg_plain"
"""Name of the handler of characters that a stream cannot encode."""

PIPE_WIDTH = 80


def prepare_streams() -> None:
    """Let the standard streams print what they cannot encode in plain characters."""
    codecs.register_error(ERRORS, _plain)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors=ERRORS)


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = ascii_text(error.object[error.start : error.end])
    return text.encode("ascii", "backslashreplace").decode(), error.end


def complain(line: str) -> None:
    """Write one line to standard error, over a line of progress."""
    start = "\r\033[K" if sys.stderr.isatty() else ""
    print(f"{start}akm-fg: {printable(line)}", file=sys.stderr, flush=True)


def tell(words: str, began_s: float) -> None:
    """Say on standard error what comes next, and when, over a line of progress.

    Args:
        words: of one line.
        began_s: the command, by `time.perf_counter`.
    """
    start = "\r\033[K" if sys.stderr.isatty() else ""
    seconds = time.perf_counter() - began_s
    print(f"{start}{seconds:6.1f} s  {printable(words)}", file=sys.stderr, flush=True)


class _Output(Console):
    """Text alone: names of files and parts may hold what Rich takes for markup or emoji.

    Where a reader leaves, Rich would end the program with exit code 1, which says something else.
    """

    def __init__(self, width: int | None = None) -> None:
        super().__init__(width=width, markup=False, emoji=False)

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def console() -> Console:
    """Of standard output: as wide as the terminal, and 80 columns where it is none."""
    out = _Output()
    told = out.is_terminal or os.environ.get("COLUMNS")
    return out if told else _Output(width=PIPE_WIDTH)


def leave_broken_pipe() -> None:
    """Let nothing more be written to a pipe whose reader has gone, also not at exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
