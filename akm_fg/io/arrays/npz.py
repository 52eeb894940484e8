"""Arrays of an ``.npz``: what its headers claim is checked before memory is taken.

An archive is a zip of .npy files (NEP 1), each of which begins with shape and type of its array;
a few kilobytes can claim, and even hold, gigabytes.
"""

from __future__ import annotations

import math
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError
from akm_fg.io.files.kind import looks_like

MAX_NUMBERS = 2**25
"""Of one array of points: a thousand frames of ten thousand points."""
MAX_BYTES = 2**30  # of all arrays that are read: such points with a covariance each

BROKEN = (
    OSError, ValueError, EOFError, KeyError, MemoryError, RuntimeError, NotImplementedError,
    SyntaxError, RecursionError, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What numpy and zipfile raise on files that are damaged, encrypted or hold pickles."""

_SUFFIX = ".npy"


def load_arrays(
    path: Path, wanted: Collection[str], what: str, most_numbers: int | None = None
) -> dict[str, NDArray[Any]]:
    """The arrays of these names, by lower-case name, that the archive holds.

    Args:
        path: of the file.
        wanted: names in lower case.
        what: the file should be, for messages.
        most_numbers: that one array may hold; the default is of covariances, three a coordinate.

    Raises:
        InputError: no such file, no archive, damaged, pickles, too large, or a name twice.
    """
    if not path.exists():
        raise InputError(path, "does not exist", what)
    if path.is_dir():
        raise InputError(path, "is a folder", what)
    if not path.is_file():
        raise InputError(path, "is not a regular file", what)
    try:
        with path.open("rb") as file:
            first = file.read(64)
    except OSError as e:
        raise InputError(path, f"cannot be read ({e.strerror})", what) from e
    if not zipfile.is_zipfile(path):
        other = "" if first.startswith(b"PK") else looks_like(first)
        raise InputError(path, f"is not an .npz archive, or is truncated{other}", what)
    name = ""
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            members = _members(path, archive, wanted, what)
            _check_sizes(path, archive, members, most_numbers or 3 * MAX_NUMBERS)
            for name, member in members.items():
                with archive.open(member) as file_:
                    arrays[name] = np.asarray(np.lib.format.read_array(file_, allow_pickle=False))
    except BROKEN as e:
        if "allow_pickle" in str(e):
            raise InputError(path, f"`{name}` holds Python objects", f"numbers; {what}") from e
        raise InputError(path, f"is damaged (`{name or 'archive'}` cannot be read)", what) from e
    return arrays


def names_in(path: Path) -> tuple[str, ...]:
    """Names of the arrays of an archive, for messages."""
    with zipfile.ZipFile(path) as archive:
        return tuple(i.filename.removesuffix(_SUFFIX) for i in archive.infolist())


def _members(
    path: Path, archive: zipfile.ZipFile, wanted: Collection[str], what: str
) -> dict[str, zipfile.ZipInfo]:
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        name = info.filename.removesuffix(_SUFFIX).lower()
        if not info.filename.endswith(_SUFFIX) or name not in wanted:
            continue
        if name in members:
            raise InputError(path, f"holds `{name}` twice", what)
        members[name] = info
    return members


def _check_sizes(
    path: Path, archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], most_numbers: int
) -> None:
    total, most_bytes = 0, max(MAX_BYTES, 4 * most_numbers)
    for name, info in members.items():
        with archive.open(info) as file:
            shape, dtype = _header(file)
            holds = info.file_size - file.tell()
        if dtype.hasobject:
            continue  # the reader refuses pickles by themselves
        numbers = math.prod(shape)
        if numbers > most_numbers:
            problem = f"`{name}` claims {numbers:.3g} numbers"
            raise InputError(path, problem, f"at most {min(most_numbers, MAX_NUMBERS)} of points")
        if numbers * dtype.itemsize != holds:
            problem = f"`{name}` claims shape {shape} ({numbers * dtype.itemsize} bytes)"
            raise InputError(path, f"{problem} and holds {holds}", "an archive that is whole")
        total += holds
    if total > most_bytes:
        raise InputError(path, f"holds {total / 1e9:.1f} GB", f"at most {most_bytes / 1e9:.1f} GB")


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    readers = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in readers:
        raise ValueError(f"version {version} of .npy")
    shape, _, dtype = readers[version](file)
    return shape, dtype
