"""Reads what a calibration needs of a recording: images and the robot's poses.

The format is that of recordings (docs/conventions.md), without need of depth and `T_world_cam`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import gtsam

from akm_fg.calibration.detection import BoardDetector
from akm_fg.calibration.records import BoardSpec, BoardView, CalibrationViews
from akm_fg.errors import InputError
from akm_fg.io.json_fields import Fields, load_json_object
from akm_fg.io.recording_reader import SCHEMA, colour_file
from akm_fg.io.sources.pictures import read_colour
from akm_fg.records import PinholeCamera

WHAT = f"the description of a recording ({SCHEMA})"


def read_calibration_views(folder: Path, board: BoardSpec) -> CalibrationViews:
    """Read a recording and find the board in its images.

    Raises:
        InputError: the folder is no recording, holds no robot poses, or shows no such board.
    """
    fields = open_recording(folder)
    camera = read_camera(fields)
    grips = _grips(fields)
    views, skipped, markers = _views(folder, camera, grips, board)
    notes: tuple[str, ...] = ()
    if not views and markers and board.squares_y % 2 == 0:  # else both patterns are the same
        other = replace(board, legacy_pattern=not board.legacy_pattern)
        views, skipped, _ = _views(folder, camera, grips, other)
        notes, board = (_pattern_words(other),), other
    if not views:
        raise _no_board(folder, board, len(grips), markers)
    name = folder.name or folder.resolve().name
    return CalibrationViews(name, board, camera, tuple(views), tuple(skipped), notes)


def _views(
    folder: Path, camera: PinholeCamera, grips: Sequence[gtsam.Pose3], board: BoardSpec
) -> tuple[list[BoardView], list[int], int]:
    """Views of the board, frames without it, and how many markers were read in all."""
    detector = BoardDetector(board)
    views, skipped, markers = [], [], 0
    for frame, T_world_gripper in enumerate(grips):
        rgb = read_colour(colour_file(folder, frame), camera.width, camera.height)
        sighting = detector.find(rgb)
        markers += sighting.markers
        if sighting.corners.size:
            views.append(BoardView(frame, sighting.corners, sighting.uv, T_world_gripper))
        else:
            skipped.append(frame)
    return views, skipped, markers


def _pattern_words(found: BoardSpec) -> str:
    age = "the pattern of OpenCV before 4.6" if found.legacy_pattern else "the pattern of today"
    value = str(found.legacy_pattern).lower()
    return f'the board is printed in {age}: read so; say "legacy_pattern": {value} in board.json'


def open_recording(folder: Path) -> Fields:
    """The description of a recording.

    Raises:
        InputError: there is none, or it is something else.
    """
    if not folder.is_dir():
        problem = "is not a folder" if folder.exists() else "does not exist"
        raise InputError(folder, problem, f"a recording folder ({SCHEMA}: recording.json, rgb/)")
    path = folder / "recording.json"
    fields = Fields(path, load_json_object(path, WHAT))
    schema = fields.text("schema", f"the string {SCHEMA!r}")
    if schema != SCHEMA:
        raise fields.error("schema", f"is {schema!r}"[:80], f"{SCHEMA!r}")
    return fields


def read_camera(fields: Fields) -> PinholeCamera:
    """The field `camera`."""
    camera = fields.table("camera", "an object with width, height, fx, fy, cx, cy")
    return PinholeCamera(
        camera.positive_integer("width"),
        camera.positive_integer("height"),
        camera.positive("fx"),
        camera.positive("fy"),
        camera.number("cx"),
        camera.number("cy"),
    )


def _grips(fields: Fields) -> tuple[gtsam.Pose3, ...]:
    expected = "the robot's pose for each image, 4x4"
    if not fields.has("T_world_gripper"):
        raise fields.error("T_world_gripper", "is missing", expected)
    n = len(fields.array("T_world_gripper", (None, 4, 4), expected))
    stamps = len(fields.array("stamps_s", (None,), "one time in seconds an image"))
    if n != stamps:
        raise fields.error("T_world_gripper", f"lists {n} poses", f"{stamps}, one an image")
    return fields.poses("T_world_gripper", n)


def _no_board(folder: Path, board: BoardSpec, images: int, markers: int) -> InputError:
    what = f"{board.squares_x} x {board.squares_y} squares of {board.dictionary}"
    seen = f"{markers} of its markers were read, none where this board has it"
    if markers == 0:
        seen = "none of its markers was read"
    return InputError(
        folder, f"the board is in none of {images} images; {seen}", f"images of a board of {what}"
    )
