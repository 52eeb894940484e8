"""Files of rows, a JSON line each, written as they come and read after an interruption too."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

log = logging.getLogger(__name__)
Row = TypeVar("Row")


def append_line(file: Path, line: str) -> None:
    """Add a line in one write, after one that an interruption may have left unfinished."""
    file.parent.mkdir(parents=True, exist_ok=True)
    text = line + "\n"
    with file.open("ab+") as stream:
        if stream.tell() > 0:
            stream.seek(-1, os.SEEK_END)
            text = text if stream.read() == b"\n" else "\n" + text
        stream.write(text.encode())


def whole_lines(file: Path) -> Iterator[tuple[int, Any]]:
    """Number and contents of each line; nothing where there is no file.

    A line that is not JSON, as an interruption leaves it, is left out: its trial is done again.
    """
    if not file.exists():
        return
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        try:
            yield number, json.loads(line)
        except json.JSONDecodeError:
            log.warning("%s:%d is not a whole row and is left out", file, number)


def rows_of(row: type[Row], *files: Path) -> list[Row]:
    """The rows of files, each made of the fields that its dataclass knows."""
    known = [field.name for field in fields(row)]  # type: ignore[arg-type]
    return [row(**{key: data[key] for key in known}) for f in files for _, data in whole_lines(f)]
