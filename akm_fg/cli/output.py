"""Where results go: a file that is known to be writable before work begins, or standard output."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from akm_fg.errors import OutputError


@contextmanager
def json_output(path: str | None) -> Iterator[TextIO | None]:
    """Open OUT of `--json OUT`; `-` is standard output, None is nowhere.

    Raises:
        OutputError: it cannot be written.
    """
    if path is None:
        yield None
        return
    if path == "-":
        yield sys.stdout
        return
    try:
        stream = Path(path).open("w", encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror}); expected a file in a folder that exists"
        ) from error
    with stream:
        yield stream


def write_line(stream: TextIO, line: str) -> None:
    """Write a line at once, so that an interruption loses nothing.

    Raises:
        OutputError: the disk refuses.
    """
    try:
        stream.write(line + "\n")
        stream.flush()
    except OSError as error:
        raise OutputError(f"{getattr(stream, 'name', 'output')}: {error.strerror}") from error
