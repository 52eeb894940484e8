"""Pose logs: text, one row a frame, ``x y z`` or ``x y z qx qy qz qw`` (metres, unit quaternion).

Blank lines and comments (``#`` to the end of the line) are skipped.
"""

from __future__ import annotations

import math
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.records import PoseTrack

ROW = "`x y z` or `x y z qx qy qz qw`, numbers separated by blanks"
MIN_QUATERNION_NORM = 1e-3  # below it the direction of a printed quaternion is noise
MIN_ROWS = 2  # one pose shows no motion


def _text(path: Path) -> str:
    what = f"a pose log: text with a row a frame, {ROW}"
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as e:
        raise InputError(path, "does not exist", what) from e
    except UnicodeDecodeError as e:
        raise InputError(path, f"is not text (byte {e.start})", what) from e
    except OSError as e:
        raise InputError(path, f"cannot be read ({e.strerror})", what) from e


def _row(place: str, line: str) -> list[float]:
    tokens = line.split()
    numbers = []
    for token in tokens:
        try:
            number = float(token)
        except ValueError as e:
            raise InputError(place, f"{token[:30]!r} is not a number", ROW) from e
        if not math.isfinite(number):
            raise InputError(place, f"{token!r} is not finite", f"finite numbers, {ROW}")
        numbers.append(number)
    if len(numbers) not in (3, 7):
        raise InputError(place, f"{len(numbers)} columns", ROW)
    if len(numbers) == 7 and math.hypot(*numbers[3:]) < MIN_QUATERNION_NORM:
        raise InputError(place, "the quaternion is zero", "a unit quaternion qx qy qz qw")
    return numbers


def read_pose_log(path: Path) -> PoseTrack:
    """Read a pose log; quaternions are normalised.

    Raises:
        InputError: missing, not text, or a row that is not as it should be (with its line).
    """
    path = Path(path)
    rows: list[list[float]] = []
    for number, line in enumerate(_text(path).splitlines(), start=1):
        content = line.split("#", 1)[0].strip()
        if not content:
            continue
        place = f"{path}, line {number}"
        row = _row(place, content)
        if rows and len(row) != len(rows[0]):
            expected = f"{len(rows[0])} columns as in the rows before"
            raise InputError(place, f"{len(row)} columns", expected)
        rows.append(row)
    if len(rows) < MIN_ROWS:
        problem = "has no rows" if not rows else "has only one row"
        raise InputError(path, problem, f"at least {MIN_ROWS} rows, {ROW}")
    table = np.array(rows)
    p_world = table[:, :3]
    if table.shape[1] == 3:
        return PoseTrack(p_world)
    quaternions = table[:, 3:] / np.linalg.norm(table[:, 3:], axis=1, keepdims=True)
    rotations = [gtsam.Rot3.Quaternion(w, x, y, z).matrix() for x, y, z, w in quaternions]
    return PoseTrack(p_world, np.array(rotations))
