"""Text to rows of numbers: separators, decimal commas, header lines, rows with NaN.

Of a file all rows are separated alike: the first row of numbers says how.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from akm_fg.errors import InputError
from akm_fg.io.files.kind import looks_like
from akm_fg.records import FloatArray

ROW = (
    "a row a frame: `x y z`, `x y z qx qy qz qw`, either after a stamp (TUM), "
    "12 numbers (KITTI) or EuRoC's CSV"
)
MAX_BYTES = 2**28  # a million rows of a dozen numbers, twice over
LARGEST_STAMP = 1e20  # nanoseconds since 1970, and to spare
UNKNOWN = frozenset({"nan", "-nan", "null", "none", "na", "n/a", ""})
"""What stands in a cell whose number is not known."""
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")

Split = Callable[[str], list[str]]


@dataclass(frozen=True, slots=True)
class Rows:
    """The numbers of a log."""

    table: FloatArray  # (T, columns), finite
    lines: tuple[int, ...]  # T, of the file, from 1
    names: tuple[str, ...] | None  # of the columns, where a line says them
    commas: bool  # whether commas separate
    left_out: int  # rows with NaN
    millimetres: bool  # whether a line above them says so


def read_text(path: Path) -> str:
    """The text of a log, UTF-8 or (with its mark) UTF-16.

    Raises:
        InputError: missing, not a file, too large, or not text.
    """
    what = f"a pose log: text with {ROW}"
    try:
        if path.exists() and not path.is_file():
            raise InputError(path, "is not a regular file", what)
        if path.stat().st_size > MAX_BYTES:
            size = f"holds {path.stat().st_size / 1e6:.0f} MB"
            raise InputError(path, size, f"at most {MAX_BYTES / 1e6:.0f} MB, {what}")
        data = path.read_bytes()
    except FileNotFoundError as e:
        raise InputError(path, "does not exist", what) from e
    except OSError as e:
        raise InputError(path, f"cannot be read ({e.strerror})", what) from e
    code = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = data.decode(code)
    except UnicodeDecodeError as e:
        raise InputError(path, f"is not text (byte {e.start}){looks_like(data)}", what) from e
    if "\0" in text:
        raise InputError(path, f"holds zero bytes{looks_like(data)}", what)
    return text


def read_rows(path: Path, text: str) -> Rows:
    """Rows of finite numbers, all with as many columns.

    Raises:
        InputError: a row that is not as it should be, with its line.
    """
    header, content = _content(text)
    split = _split_as([row for _, row in content])
    rows: list[list[float]] = []
    lines: list[int] = []
    width, left_out = 0, 0
    for number, row in content:
        place = f"{path}, line {number}"
        values = [_number(place, cell, text) for cell in split(row)]
        if width and len(values) != width:
            expected = f"{width} columns as in the rows before"
            raise InputError(place, f"{len(values)} columns", expected)
        width = len(values)
        if any(math.isnan(value) for value in values):
            left_out += 1
            continue
        rows.append(values)
        lines.append(number)
    table = np.array(rows, dtype=np.float64).reshape(len(rows), width)
    millimetres = re.search(r"[\[(_]mm\b", header) is not None
    names, commas = _names(header), split is _by_commas
    return Rows(table, tuple(lines), names, commas, left_out, millimetres)


def _content(text: str) -> tuple[str, list[tuple[int, str]]]:
    """The last line above the numbers that may name columns, and rows with their line numbers."""
    header = ""
    rows: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        content, _, comment = line.partition("#")
        content = content.strip()
        above = content or comment
        if not rows and (not content or _is_header(content)):
            header = above if _names(above) else header
        elif content:
            rows.append((number, content))
    return header, rows


def _is_header(content: str) -> bool:
    """Whether no cell of a line holds a number, and one has letters."""
    cells = [cell for cell in re.split(r"[\s,;]+", content) if cell]
    wordy = any(cell.strip("\"'")[:1].isalpha() and cell.lower() not in UNKNOWN for cell in cells)
    return wordy and not any(_as_float(cell) is not None for cell in cells)


def _names(header: str) -> tuple[str, ...] | None:
    """Names of columns without their units; None where there are not even three."""
    plain = re.sub(r"\[[^\]]*\]|\([^)]*\)", " ", header).strip().strip("%").strip()
    separators = r"\s*[,;\t]\s*" if re.search(r"[,;\t]", plain) else r"\s+"
    names = tuple(name.strip("\"'` ").lower() for name in re.split(separators, plain))
    return names if len(names) >= 3 else None


def _by_blanks(content: str) -> list[str]:
    return content.split()


def _by_commas(content: str) -> list[str]:
    return [cell.strip() for cell in content.rstrip(",").split(",")]


def _by_blanks_decimal_comma(content: str) -> list[str]:
    return [cell.replace(",", ".") for cell in content.split()]


def _by_semicolons(content: str) -> list[str]:
    return [cell.strip().replace(",", ".") for cell in content.rstrip("; ").split(";")]


def _split_as(rows: list[str]) -> Split:
    """How rows are separated. A comma separates unless blanks do, and it stands inside numbers."""
    if any(";" in row for row in rows):
        return _by_semicolons
    if not any("," in row for row in rows):
        return _by_blanks
    if any("." in row or len(row.split()) == 1 for row in rows):
        return _by_commas
    words = {word for row in rows for word in row.split()}
    decimal = all(
        _DECIMAL_COMMA.fullmatch(word) or word.lstrip("+-").isdigit() or word.lower() in UNKNOWN
        for word in words
    )
    return _by_blanks_decimal_comma if decimal else _by_commas


def _as_float(cell: str) -> float | None:
    if cell.strip("\"'").lower() in UNKNOWN:
        return math.nan
    try:
        return None if "_" in cell else float(cell.strip("\"'"))
    except ValueError:
        return None


def _number(place: str, cell: str, text: str) -> float:
    number = _as_float(cell)
    if number is None:
        hint = looks_like(text[:64].encode())
        raise InputError(place, f"{cell[:30]!r} is not a number{hint}", f"numbers, {ROW}")
    if math.isinf(number):
        raise InputError(place, f"{cell[:30]!r} is not finite", f"finite numbers, {ROW}")
    if abs(number) > LARGEST_STAMP:
        raise InputError(place, f"{cell[:30]!r} is too large", f"metres, {ROW}")
    return number
