"""A folder that appears whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from akm_fg.errors import OutputError


def check_new(folder: Path) -> None:
    """Find out before any work that it can be made.

    Raises:
        OutputError: something stands there, or nothing can.
    """
    try:
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise OutputError(f"{folder}: is a file or a link; expected a new folder")
        if folder.is_dir() and any(folder.iterdir()):
            raise OutputError(f"{folder}: is not empty; expected a new folder")
        folder.parent.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as e:
        why = getattr(e, "strerror", None) or str(e)
        raise OutputError(f"{folder}: cannot be written ({why}); expected a new folder") from e


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A folder beside, which takes its name when all is done and goes when anything fails.

    Raises:
        OutputError: it cannot be made, or something stands there meanwhile.
    """
    try:
        beside = Path(tempfile.mkdtemp(".part", f".{folder.name}.", folder.absolute().parent))
        os.chmod(beside, 0o755)
    except OSError as e:
        raise OutputError(f"{folder}: cannot be written ({e.strerror})") from e
    try:
        yield beside
        os.replace(beside, folder)
    except OSError as e:
        raise OutputError(f"{folder}: cannot be written ({e.strerror})") from e
    finally:
        shutil.rmtree(beside, ignore_errors=True)
