"""Finds the corners of the board in images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.calibration.board_file import opencv_board
from akm_fg.calibration.records import BoardSpec
from akm_fg.records import FloatArray

LEAST_CORNERS = 6  # of a view; four points of a plane leave nothing to check them by


@dataclass(frozen=True, slots=True)
class BoardSighting:
    """What was found in one image."""

    corners: NDArray[np.intp]  # (N,) numbers of the corners; empty where the board was not found
    uv: FloatArray  # (N, 2) pixels, centres at integers
    markers: int  # that were read, of this board or any other of the dictionary


class BoardDetector:
    """Corners of one board by OpenCV's ChArUco detector, refined below a pixel."""

    def __init__(self, board: BoardSpec) -> None:
        self._detector = cv2.aruco.CharucoDetector(opencv_board(board))

    def find(self, rgb: NDArray[np.uint8]) -> BoardSighting:
        """The board's corners in an image (H, W, 3); none where fewer than six are seen."""
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        uv, corners, _, markers = self._detector.detectBoard(grey)
        read = 0 if markers is None else len(markers)
        if corners is None or len(corners) < LEAST_CORNERS or _on_a_line(uv.reshape(-1, 2)):
            return BoardSighting(np.empty(0, dtype=np.intp), np.empty((0, 2)), read)
        found = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
        return BoardSighting(np.asarray(corners, dtype=np.intp).ravel(), found, read)


def _on_a_line(uv: NDArray[Any]) -> bool:
    """Whether the points spread less than two pixels (rms) across their longest direction."""
    across = np.linalg.svd(uv - uv.mean(axis=0), compute_uv=False)[1]
    return bool(across < 2.0 * np.sqrt(len(uv)))
