"""Corners of a printed board are found where a known homography has put them."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.calibration.board_file import opencv_board
from akm_fg.calibration.detection import BoardDetector
from akm_fg.calibration.records import BoardSpec

BOARD = BoardSpec(7, 5, 0.04, 0.03, "DICT_4X4_50")
PX_PER_M = 4000.0  # of the drawing


def _homography():
    """From board metres to pixels of a 640 x 480 image: a slanted view."""
    here = np.float32([[0, 0], [0.28, 0], [0.28, 0.2], [0, 0.2]])
    there = np.float32([[150, 90], [470, 130], [455, 350], [170, 370]])
    return cv2.getPerspectiveTransform(here, there)


def _image(board=BOARD):
    """The board drawn at four times the size, then averaged: smooth edges."""
    side = np.rint(PX_PER_M * board.square_m * np.array([board.squares_x, board.squares_y]))
    drawn = opencv_board(board).generateImage(tuple(int(n) for n in side))
    # Pixel centres at integers: metres = (pixel + 0.5) / PX_PER_M, large = 4 small + 1.5.
    metres = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, PX_PER_M]]) / PX_PER_M
    larger = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1.0]])
    H = larger @ _homography() @ metres
    fine = cv2.warpPerspective(drawn, H, (2560, 1920), borderValue=255)
    grey = cv2.resize(fine, (640, 480), interpolation=cv2.INTER_AREA)
    return np.repeat(grey[..., None], 3, axis=2)


def _expected():
    p = BOARD.corners_m()
    p[:, 2] = 1.0
    uv = p @ _homography().T
    return uv[:, :2] / uv[:, 2:]


def test_all_corners_are_found_below_a_fifth_of_a_pixel():
    sighting = BoardDetector(BOARD).find(_image())
    assert sorted(sighting.corners) == list(range(24))
    assert_allclose(sighting.uv, _expected()[sighting.corners], atol=0.2)
    off = sighting.uv - _expected()[sighting.corners]
    assert_allclose(off.mean(axis=0), 0.0, atol=0.03)  # half a pixel off would show here


def test_of_a_board_half_covered_the_rest_is_found():
    image = _image()
    image[:, 300:] = 128
    sighting = BoardDetector(BOARD).find(image)
    assert 6 <= sighting.corners.size < 24
    assert_allclose(sighting.uv, _expected()[sighting.corners], atol=0.2)


@pytest.mark.parametrize("empty", [0, 255])
def test_nothing_is_found_where_there_is_nothing(empty):
    sighting = BoardDetector(BOARD).find(np.full((480, 640, 3), empty, dtype=np.uint8))
    assert sighting.corners.size == 0 and sighting.uv.shape == (0, 2) and sighting.markers == 0


def test_corners_on_one_line_are_no_view():
    image = _image()
    image[190:] = 255  # the first row of inner corners alone is left
    assert BoardDetector(BOARD).find(image).corners.size == 0


def test_a_board_with_other_squares_is_not_taken_for_this_one():
    other = BoardSpec(9, 6, 0.04, 0.03, "DICT_4X4_50")
    sighting = BoardDetector(other).find(_image())
    assert sighting.corners.size == 0 and sighting.markers > 0
