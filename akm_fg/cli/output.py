"""Where results go: a file that is known to be writable before work begins, or standard output."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from akm_fg.errors import OutputError


class Results(Protocol):
    """Takes results line by line."""

    def write_line(self, line: str) -> None:
        """Put a line where it is safe, at once.

        Raises:
            OutputError: the disk refuses.
        """
        ...


class _StandardOutput:
    """Whoever reads it may leave (BrokenPipeError goes up); a full disk is an error."""

    def write_line(self, line: str) -> None:
        try:
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            raise OutputError(f"standard output: cannot be written ({error.strerror})") from error


@contextmanager
def json_output(path: str | None) -> Iterator[Results | None]:
    """Open OUT of `--json OUT`; `-` is standard output, None is nowhere.

    A file that is there stays as it is until the first line is written.

    Raises:
        OutputError: it cannot be written.
    """
    if path is None:
        yield None
    elif path == "-":
        yield _StandardOutput()
    else:
        from akm_fg.io.files.results import ResultFile

        with ResultFile(Path(path)) as results:
            yield results


def write_line(results: Results, line: str) -> None:
    """Write a line at once, so that an interruption loses nothing.

    Raises:
        OutputError: the disk refuses.
    """
    results.write_line(line)
