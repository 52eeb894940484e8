"""board.json: what is written comes back, and every mistake in it gets its name."""

import json

import pytest

from akm_fg.calibration.board_file import opencv_board, read_board, write_board
from akm_fg.calibration.records import BoardSpec
from akm_fg.errors import InputError

BOARD = BoardSpec(7, 5, 0.04, 0.03, "DICT_4X4_50")


def _said(**changes):
    fields = {
        "schema": "akm-fg/board/1",
        "squares_x": 7,
        "squares_y": 5,
        "square_m": 0.04,
        "marker_m": 0.03,
        "dictionary": "DICT_4X4_50",
    }
    return {**fields, **changes}


def test_a_board_comes_back_as_it_was_written(tmp_path):
    for board in (BOARD, BoardSpec(5, 4, 0.05, 0.02, "DICT_5X5_100", legacy_pattern=True)):
        write_board(tmp_path / "board.json", board)
        assert read_board(tmp_path / "board.json") == board


def test_corners_are_where_opencv_has_them():
    assert opencv_board(BOARD).getChessboardCorners() == pytest.approx(BOARD.corners_m())
    assert BOARD.corners_m()[7] == pytest.approx([0.08, 0.08, 0.0])  # second in the second row


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": "akm-fg/board/9"}, "`schema` is 'akm-fg/board/9'"),
        ({"squares_x": 2.5}, "`squares_x` is 2.5"),
        ({"squares_y": 1}, "7 x 1 squares, expected 3 or more"),
        ({"square_m": -1}, "`square_m` is -1"),
        ({"marker_m": 0.05}, "marker_m 0.05, square_m 0.04"),
        ({"dictionary": "DICT_9X9"}, "dictionary 'DICT_9X9'"),
        ({"dictionary": 4}, "`dictionary` is a number"),
        ({"squares_x": 20, "squares_y": 20}, "need 200 markers, DICT_4X4_50 has 50"),
        ({"legacy_pattern": "no"}, "`legacy_pattern` is 'no'"),
    ],
)
def test_a_wrong_field_is_named(tmp_path, changes, message):
    path = tmp_path / "board.json"
    path.write_text(json.dumps(_said(**changes)))
    with pytest.raises(InputError) as caught:
        read_board(path)
    assert message in str(caught.value) and str(path) in str(caught.value)


@pytest.mark.parametrize("name", list(_said()))
def test_a_missing_field_is_named(tmp_path, name):
    fields = _said()
    del fields[name]
    path = tmp_path / "board.json"
    path.write_text(json.dumps(fields))
    with pytest.raises(InputError, match=f"`{name}` is missing"):
        read_board(path)
