"""`board.json`: what is printed on the board. Format akm-fg/board/1, docs/conventions.md."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import cv2

from akm_fg.calibration.records import BoardSpec
from akm_fg.errors import InputError
from akm_fg.io.json_fields import Fields, load_json_object
from akm_fg.io.png import replace_file

SCHEMA = "akm-fg/board/1"
WHAT = f"a description of a ChArUco board ({SCHEMA})"


def read_board(path: Path) -> BoardSpec:
    """Read a board description.

    Raises:
        InputError: missing, not JSON, a field that is missing or wrong.
    """
    fields = Fields(path, load_json_object(path, WHAT))
    schema = fields.text("schema", f"the string {SCHEMA!r}")
    if schema != SCHEMA:
        raise fields.error("schema", f"is {schema!r}"[:80], f"{SCHEMA!r}")
    legacy = fields.values.get("legacy_pattern", False)
    if not isinstance(legacy, bool):
        raise fields.error("legacy_pattern", f"is {legacy!r}"[:60], "true or false")
    numbers = fields.positive_integer("squares_x"), fields.positive_integer("squares_y")
    sides = fields.positive("square_m"), fields.positive("marker_m")
    dictionary = fields.text("dictionary", "an OpenCV name such as DICT_4X4_50")
    try:
        board = BoardSpec(*numbers, *sides, dictionary, legacy)
        opencv_board(board)
    except ValueError as error:
        raise InputError(path, str(error), WHAT) from error
    return board


def write_board(path: Path, board: BoardSpec) -> None:
    """Write a board description.

    Raises:
        OutputError: the place cannot be written.
    """
    text = json.dumps({"schema": SCHEMA, **asdict(board)}) + "\n"
    replace_file(path, text.encode())


def opencv_board(board: BoardSpec) -> cv2.aruco.CharucoBoard:
    """The board as OpenCV's detector wants it.

    Raises:
        ValueError: no such dictionary, or one with too few markers.
    """
    name = board.dictionary
    if not (name.startswith("DICT_") and hasattr(cv2.aruco, name)):
        raise ValueError(
            f"dictionary {name!r}"[:60] + ", expected an OpenCV name: DICT_4X4_50, ..."
        )
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    markers = board.squares_x * board.squares_y // 2
    if markers > len(dictionary.bytesList):
        raise ValueError(
            f"{board.squares_x} x {board.squares_y} squares need {markers} markers, "
            f"{name} has {len(dictionary.bytesList)}"
        )
    made = cv2.aruco.CharucoBoard(
        (board.squares_x, board.squares_y), board.square_m, board.marker_m, dictionary
    )
    made.setLegacyPattern(board.legacy_pattern)
    return made
