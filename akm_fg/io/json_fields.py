"""Typed access to a parsed JSON object, with errors that name the field."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.records import FloatArray

RIGID_TOLERANCE = 1e-3  # of R^T R - I; larger is a wrong matrix, not rounding on the way to text
MAX_BYTES = 2**26  # an hour of frames with a pose each, twice over
LARGEST_NUMBER = 1e15  # metres, seconds or pixels: squares of it are still numbers
EXACT_TOLERANCE = 1e-12  # below it a rotation is taken as written, so that files round-trip


def load_json_object(path: Path, what: str) -> dict[str, Any]:
    """Parse a file that holds one JSON object.

    Raises:
        InputError: missing, unreadable, not JSON (line and column), or not an object.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(path, "is not a regular file", what)
        if path.stat().st_size > MAX_BYTES:
            size = f"holds {path.stat().st_size / 1e6:.0f} MB"
            raise InputError(path, size, f"{MAX_BYTES / 1e6:.0f} MB at most, {what}")
        value = json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as e:
        raise InputError(path, "is missing", what) from e
    except OSError as e:
        raise InputError(path, f"cannot be read ({e.strerror})", what) from e
    except UnicodeDecodeError as e:
        raise InputError(path, f"is not text (byte {e.start})", what) from e
    except json.JSONDecodeError as e:
        problem = f"line {e.lineno}, column {e.colno}: {e.msg[0].lower()}{e.msg[1:]}"
        raise InputError(path, problem, f"valid JSON, {what}") from e
    except (RecursionError, ValueError) as e:
        raise InputError(path, "is nested too deeply or holds too large a number", what) from e
    if not isinstance(value, dict):
        raise InputError(path, f"holds {_kind_of(value)}", f"a JSON object, {what}")
    return value


def _kind_of(value: object) -> str:
    names = {dict: "an object", list: "a list", str: "a string", bool: "a truth value"}
    return "null" if value is None else names.get(type(value), "a number")


def _only_numbers(value: object) -> bool:
    if isinstance(value, list):
        return all(_only_numbers(v) for v in value)
    return isinstance(value, (int, float)) and not isinstance(value, bool)


@dataclass(frozen=True, slots=True)
class Fields:
    """One JSON object of a file; `prefix` is its own name inside the file ("camera.")."""

    path: Path
    values: Mapping[str, Any]
    prefix: str = ""

    def error(self, name: str, problem: str, expected: str) -> InputError:
        """The error that names this field of this file."""
        return InputError(self.path, f"`{self.prefix}{name}` {problem}", expected)

    def has(self, name: str) -> bool:
        """Whether the field is there and not null."""
        return self.values.get(name) is not None

    def get(self, name: str, expected: str) -> Any:
        """The raw value of a field that must be there."""
        if name not in self.values:
            raise self.error(name, "is missing", expected)
        return self.values[name]

    def text(self, name: str, expected: str) -> str:
        """A string."""
        value = self.get(name, expected)
        if not isinstance(value, str):
            raise self.error(name, f"is {_kind_of(value)}", expected)
        return value

    def table(self, name: str, expected: str) -> Fields:
        """An object inside this one."""
        value = self.get(name, expected)
        if not isinstance(value, dict):
            raise self.error(name, f"is {_kind_of(value)}", expected)
        return Fields(self.path, value, f"{self.prefix}{name}.")

    def positive_integer(self, name: str) -> int:
        """An integer above 0."""
        expected = "a positive integer"
        value = self.get(name, expected)
        if not isinstance(value, int) or isinstance(value, bool):
            raise self.error(name, f"is {value!r}"[:60], expected)
        if value <= 0:
            raise self.error(name, f"is {value}", expected)
        return value

    def number(self, name: str, expected: str = "a finite number") -> float:
        """A finite number."""
        return float(self.array(name, (), expected))

    def positive(self, name: str) -> float:
        """A finite number above 0."""
        expected = "a finite number above 0"
        value = self.number(name, expected)
        if value <= 0:
            raise self.error(name, f"is {value:g}", expected)
        return value

    def array(self, name: str, shape: tuple[int | None, ...], expected: str) -> FloatArray:
        """Finite numbers of this shape; None in `shape` is any length."""
        value = self.get(name, expected)
        if not _only_numbers(value):
            what = "holds other things than numbers" if isinstance(value, list) else ""
            raise self.error(name, what or f"is {_kind_of(value)}", expected)
        try:
            numbers = np.asarray(value, dtype=np.float64)
        except (ValueError, OverflowError) as e:
            problem = "has rows of different lengths or too large numbers"
            raise self.error(name, problem, expected) from e
        fits = numbers.ndim == len(shape) and all(
            want is None or want == got for want, got in zip(shape, numbers.shape, strict=True)
        )
        if not fits:
            got_shape = "x".join(map(str, numbers.shape)) or "a number"
            raise self.error(name, f"is {got_shape}", expected)
        if not np.isfinite(numbers).all():
            raise self.error(name, "holds NaN or infinity", expected)
        if (np.abs(numbers) > LARGEST_NUMBER).any():
            raise self.error(name, f"holds a number beyond {LARGEST_NUMBER:g}", expected)
        return numbers

    def pose(self, name: str) -> gtsam.Pose3:
        """A rigid transform as 4x4 rows."""
        expected = "a rigid transform, 4x4 (rotation, translation in metres, last row 0 0 0 1)"
        return self._rigid(self.array(name, (4, 4), expected), name, expected)

    def poses(self, name: str, n: int) -> tuple[gtsam.Pose3, ...]:
        """One rigid transform a frame."""
        expected = f"{n} rigid transforms 4x4, one for each of `stamps_s`"
        matrices = self.array(name, (n, 4, 4), expected)
        return tuple(self._rigid(m, f"{name}[{i}]", expected) for i, m in enumerate(matrices))

    def _rigid(self, matrix: FloatArray, name: str, expected: str) -> gtsam.Pose3:
        R = matrix[:3, :3]
        defect = float(np.abs(R.T @ R - np.eye(3)).max())
        if defect > RIGID_TOLERANCE:
            raise self.error(name, f"is not a rotation (R^T R is off by {defect:.2g})", expected)
        if np.linalg.det(R) < 0:
            raise self.error(name, "is a reflection (determinant -1)", expected)
        if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-9):
            raise self.error(name, "has a last row other than 0 0 0 1", expected)
        rotation = gtsam.Rot3(R) if defect <= EXACT_TOLERANCE else gtsam.Rot3.ClosestTo(R)
        return gtsam.Pose3(rotation, matrix[:3, 3])
