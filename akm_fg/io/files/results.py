"""A file of results, one line each, that is never lost and never half written.

What stood there before stays until the first new line is on the disk: the line goes to a new file
beside, which then takes the place of the old one; the lines after it are appended to it. A line
that the disk refuses in the middle is taken back. So a reader finds, whatever ends the writer,
either the old file or whole lines of the new one.
"""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from akm_fg.errors import OutputError

EXPECTED = "expected a file in a folder that exists and has room"


class ResultFile:
    """Whole lines to a file, a device or a pipe."""

    def __init__(self, path: Path) -> None:
        """Find out, before any work, that it can be written.

        Raises:
            OutputError: it cannot.
        """
        self._path = Path(os.path.realpath(path))  # a link goes on pointing where it does
        self._said = path
        self._beside: Path | None = None
        self._length = 0
        self.lines = 0
        try:
            self._file = self._open()
        except (OSError, ValueError) as error:
            raise self._refused(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        self._file.close()
        if self._beside is not None:
            self._beside.unlink(missing_ok=True)

    @property
    def is_file(self) -> bool:
        """Whether it is a file, and no device or pipe."""
        return self._beside is not None or self._path.is_file()

    def write_line(self, line: str) -> None:
        """Put a line on the disk, and with the first one replace the file that was there.

        Raises:
            OutputError: the disk refuses; the lines before are whole.
        """
        data = memoryview((line + "\n").encode())
        try:
            written = 0
            while written < len(data):
                written += self._file.write(data[written:])
            if self._beside is not None:
                os.replace(self._beside, self._path)
                self._beside = None
        except OSError as error:
            if self.is_file:
                self._file.truncate(self._length)
            raise self._refused(error) from error
        self._length += len(data)
        self.lines += 1

    def _open(self) -> BinaryIO:
        """A new file beside the one to be written; a device or pipe is opened as it is."""
        path = self._path
        if path.exists() and not path.is_file():
            return path.open("wb", buffering=0)
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(13, "is write-protected")
        number, name = tempfile.mkstemp(".part", f".{path.name}.", path.parent)
        self._beside = Path(name)
        os.fchmod(number, stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o666 & ~_umask())
        return os.fdopen(number, "wb", buffering=0)

    def _refused(self, error: Exception) -> OutputError:
        why = getattr(error, "strerror", None) or str(error)
        return OutputError(f"{self._said}: cannot be written ({why}); {EXPECTED}")


def _umask() -> int:
    """Bits that new files do not get; it can be read only by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
