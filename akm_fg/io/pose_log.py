"""Pose logs: text, one row a frame, with or without stamps, rotations and names of columns.

Read are `x y z` and `x y z qx qy qz qw` (metres, unit quaternion), TUM, KITTI and EuRoC files, and
CSV with names; separated by blanks, tabs, commas or semicolons. Blank lines and comments (``#`` to
the end of the line) are skipped, rows with NaN left out and counted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from akm_fg.errors import InputError
from akm_fg.io.files.kind import looks_like
from akm_fg.io.logs.layouts import poses_of
from akm_fg.io.logs.plausible import order_note
from akm_fg.io.logs.rows import ROW, Rows, read_rows, read_text
from akm_fg.io.read_options import METRES_A_UNIT, ReadOptions, extent_of, guessed_unit
from akm_fg.records import PoseTrack

MIN_ROWS = 2  # one pose shows no motion


def read_pose_log(path: Path, options: ReadOptions | None = None) -> PoseTrack:
    """Read a pose log; quaternions are normalised, and what was guessed is in `notes`.

    Raises:
        InputError: missing, not text, or a row that is not as it should be (with its line).
    """
    path, options = Path(path), options or ReadOptions()
    text = read_text(path)
    rows = read_rows(path, text)
    if len(rows.lines) < MIN_ROWS:
        raise _too_few(path, rows, text)
    poses = poses_of(path, rows, options)
    if rows.millimetres and options.unit is None:
        options = replace(options, unit="mm")
    unit, unit_notes = guessed_unit(extent_of(poses.positions), options)
    notes = (*_left_out(rows), *poses.notes, *unit_notes, *order_note(poses))
    p_world = poses.positions * METRES_A_UNIT[unit]
    return PoseTrack(p_world, poses.rotations, poses.stamps_s, notes)


def _too_few(path: Path, rows: Rows, text: str) -> InputError:
    problem = "has only one row" if rows.lines else f"has no rows{looks_like(text[:64].encode())}"
    if rows.left_out:
        problem += f" ({rows.left_out} with NaN left out)"
    return InputError(path, problem, f"at least {MIN_ROWS} rows, {ROW}")


def _left_out(rows: Rows) -> tuple[str, ...]:
    n = rows.left_out
    return () if n == 0 else (f"{n} row{'s' * (n != 1)} with NaN left out",)
