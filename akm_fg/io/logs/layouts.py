"""What the columns of a log are: by their names, else by how many there are.

TUM: stamp, position, quaternion xyzw (vision.in.tum.de/data/datasets/rgbd-dataset/file_formats).
KITTI: the first three rows of T_world_part, row by row (odometry devkit). EuRoC: stamp in ns,
position, quaternion wxyz, then velocities and biases (Burri et al. 2016).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.io.logs.rows import ROW, Rows
from akm_fg.io.read_options import LARGEST_NUMBER, QuaternionOrder, ReadOptions
from akm_fg.records import FloatArray

MIN_QUATERNION_NORM = 1e-3  # below it the direction of a printed quaternion is noise
NORM_TOLERANCE = 0.1  # of a quaternion's length; more than rounding to two digits
ROTATION_TOLERANCE = 0.02  # of R^T R - I in a printed matrix
STAMP_UNITS_S = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
"""Stamps since 1970 are above the first number where they are in the second unit."""
SINCE_1970 = 1e6  # in any unit; no position is as large
EVEN = 0.02  # of the middle step between stamps, by which nine in ten differ
NANOSECONDS_S = 1e-9


@dataclass(frozen=True, slots=True)
class Columns:
    """Where in a row things are."""

    position: tuple[int, ...]
    stamp: int | None = None
    quaternion: tuple[int, ...] | None = None  # four columns in the file's order
    order: QuaternionOrder = "xyzw"
    matrix: int | None = None  # first of the numbers of a matrix with rows of four


@dataclass(frozen=True, slots=True)
class Poses:
    """Poses in the file's own unit of length."""

    positions: FloatArray  # (T, 3)
    quaternions: FloatArray | None  # (T, 4) of length 1, in the file's order
    order: QuaternionOrder
    rotations: FloatArray | None  # (T, 3, 3)
    stamps_s: FloatArray | None  # (T,)
    notes: tuple[str, ...]


def poses_of(path: object, rows: Rows, options: ReadOptions) -> Poses:
    """Positions, rotations and stamps of a log.

    Raises:
        InputError: the columns are none that are known, or hold no rotations where they should.
    """
    named = _by_name(rows)
    columns = named or _by_number(path, rows)
    order = options.quaternion or columns.order
    table = rows.table
    notes: list[str] = []
    if named is None and table.shape[1] == 4:
        notes.append("four columns were read as stamp, x, y, z")
    stamps_s = None if columns.stamp is None else _seconds(table[:, columns.stamp])
    if stamps_s is not None and np.any(np.diff(stamps_s) <= 0):
        line = rows.lines[int(np.argmax(np.diff(stamps_s) <= 0)) + 1]
        notes.append(f"stamps do not grow at line {line}; rows were taken in the file's order")
    quaternions = rotations = None
    if columns.quaternion is not None:
        quaternions = _unit(path, rows, table[:, list(columns.quaternion)], columns.quaternion)
        rotations = rotations_of(quaternions, order)
    elif columns.matrix is not None:
        rotations = _matrices(path, rows, columns.matrix)
    positions = table[:, list(columns.position)]
    large = (np.abs(positions) > LARGEST_NUMBER).any(axis=1)
    if large.any():
        place = f"{path}, line {rows.lines[int(np.argmax(large))]}"
        raise InputError(place, "holds a position that is too large", "metres")
    return Poses(positions, quaternions, order, rotations, stamps_s, tuple(notes))


def rotations_of(quaternions: FloatArray, order: QuaternionOrder) -> FloatArray:
    """(T, 3, 3) of unit quaternions (T, 4)."""
    wxyz = quaternions if order == "wxyz" else quaternions[:, [3, 0, 1, 2]]
    return np.array([gtsam.Rot3.Quaternion(*q).matrix() for q in wxyz])


def _role(name: str) -> str | None:
    """What a column of this name holds: t, x, y, z, qx, qy, qz, qw, or nothing that is used."""
    if re.match(r"t$|time|stamp|sec", name):
        return "t"
    last = name[-1:]
    if last in "xyzw" and (name.startswith("q") or re.search("orient|quat|rot", name)):
        return f"q{last}"
    if last in "xyz" and (name == last or re.match(r"[pt]_?|.*(pos|trans)", name)):
        return last
    return None


def _by_name(rows: Rows) -> Columns | None:
    """Columns by the names above them; None where these do not name one position and rotation."""
    if rows.names is None or len(rows.names) != rows.table.shape[1]:
        return None
    roles = [_role(re.sub("_m{1,2}$", "", name)) for name in rows.names]
    if any(roles.count(axis) != 1 for axis in "xyz"):
        return None
    position = tuple(roles.index(axis) for axis in "xyz")
    stamp = roles.index("t") if roles.count("t") == 1 else None
    quaternion = tuple(i for i, role in enumerate(roles) if role and role.startswith("q"))
    if not quaternion:
        return Columns(position, stamp)
    order = "".join((roles[i] or "")[1] for i in quaternion)
    if order == "xyzw":
        return Columns(position, stamp, quaternion)
    return Columns(position, stamp, quaternion, "wxyz") if order == "wxyz" else None


def _by_number(path: object, rows: Rows) -> Columns:
    table, n = rows.table, rows.table.shape[1]
    match n:
        case 3:
            return Columns((0, 1, 2))
        case 4 if _ticks(table[:, 0]):
            return Columns((1, 2, 3), 0)
        case 7:
            return Columns((0, 1, 2), None, (3, 4, 5, 6))
        case 8 if not _is_rotation_before(table):
            euroc = rows.commas and _unit_of(table[:, 0]) == NANOSECONDS_S
            return Columns((1, 2, 3), 0, (4, 5, 6, 7), "wxyz" if euroc else "xyzw")
        case 12 | 16:
            return Columns((3, 7, 11), matrix=0)
        case 17 if _are_unit(table[:, 4:8]):
            return Columns((1, 2, 3), 0, (4, 5, 6, 7), "wxyz")
        case 13 | 17:
            return Columns((4, 8, 12), 0, matrix=1)
    looks = {
        2: "pixels, or a path in a plane",
        4: "x y z and one number more, or stamps that do not tick evenly",
        8: "x y z qx qy qz qw and one number more",
        6: "positions with decimal commas between commas, or position and three angles",
        9: "a rotation without a position",
        14: "positions and quaternions with decimal commas between commas",
    }
    hint = f", looks like {looks[n]}" if n in looks else ""
    problem = f"{n} column{'s' * (n != 1)}{hint}"
    raise InputError(f"{path}, line {rows.lines[0]}", problem, f"{ROW}, or names above")


def _ticks(stamps: FloatArray) -> bool:
    """Whether a column can only be time: since 1970, or as even as no motion is."""
    steps = np.diff(stamps)
    if not (steps > 0).all():
        return False
    low, middle, high = np.percentile(steps, (5, 50, 95))
    return bool(stamps[0] > SINCE_1970 or high - low < EVEN * middle)


def _is_rotation_before(table: FloatArray) -> bool:
    """Whether eight columns hold a quaternion from the fourth on, and not after a stamp."""
    lengths = np.linalg.norm(table[:, 3:7], axis=1)
    return bool((np.abs(lengths - 1) < ROTATION_TOLERANCE).all())


def _unit_of(stamps: FloatArray) -> float:
    """Seconds a unit of stamps since 1970; 1 where they are small."""
    largest = float(np.abs(stamps).max())
    return next((unit_s for least, unit_s in STAMP_UNITS_S if largest > least), 1.0)


def _seconds(stamps: FloatArray) -> FloatArray:
    """From the first stamp on: doubles hold no nanoseconds since 1970."""
    return (stamps - stamps[0]) * _unit_of(stamps)


def _are_unit(quaternions: FloatArray) -> bool:
    off = np.abs(np.linalg.norm(quaternions, axis=1) - 1) > NORM_TOLERANCE
    return bool(2 * off.sum() <= len(off))


def _unit(
    path: object, rows: Rows, quaternions: FloatArray, columns: tuple[int, ...]
) -> FloatArray:
    norms = np.linalg.norm(quaternions, axis=1)
    zero = np.flatnonzero(norms < MIN_QUATERNION_NORM)
    if zero.size:
        place = f"{path}, line {rows.lines[int(zero[0])]}"
        raise InputError(place, "the quaternion is zero", "a unit quaternion qx qy qz qw")
    if not _are_unit(quaternions):
        worst = int(np.argmax(np.abs(norms - 1)))
        problem = (
            f"columns {columns[0] + 1} to {columns[-1] + 1} are no unit quaternion (length "
            f"{norms[worst]:.2g}), looks like a stamp first, or angles"
        )
        raise InputError(f"{path}, line {rows.lines[worst]}", problem, ROW)
    return quaternions / norms[:, None]


def _matrices(path: object, rows: Rows, first: int) -> FloatArray:
    """(T, 3, 3), mended of rounding."""
    R = rows.table[:, first : first + 12].reshape(-1, 3, 4)[:, :, :3]
    defect = np.abs(R.swapaxes(1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    bad = (defect > ROTATION_TOLERANCE) | (np.linalg.det(R) < 0)
    if bad.any():
        place = f"{path}, line {rows.lines[int(np.argmax(bad))]}"
        expected = "rows of T_world_part: r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z (KITTI)"
        raise InputError(place, "holds no rotation matrix", expected)
    return np.array([gtsam.Rot3.ClosestTo(r).matrix() for r in R])
