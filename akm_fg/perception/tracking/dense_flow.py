"""Dense optical flow between two images, and its values between pixels."""

from __future__ import annotations

from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import TracksLost
from akm_fg.records import FloatArray

Flow = NDArray[np.float32]  # (H, W, 2) pixels
_LEAST_PX = 12  # side of the smallest image in which DIS looks for flow


class DenseFlow(Protocol):
    """Flow between two images, forth and back."""

    def both(self, a: NDArray[np.uint8], b: NDArray[np.uint8]) -> tuple[Flow, Flow]:
        """(H, W, 2) from a to b and from b to a, of gray images (H, W)."""
        ...


class DisFlow:
    """DIS flow; see `DenseFlow`."""

    def __init__(self) -> None:
        """The fast preset: coarser than a pixel, and the tracker matches patches afterwards."""
        self._dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)

    def both(self, a: NDArray[np.uint8], b: NDArray[np.uint8]) -> tuple[Flow, Flow]:
        """As `DenseFlow` says.

        Raises:
            TracksLost: the images are too small.
        """
        height, width = a.shape
        if min(height, width) < _LEAST_PX:
            raise TracksLost(
                f"images of {width} x {height} pixels; "
                f"expected at least {_LEAST_PX} x {_LEAST_PX} to follow points in"
            )
        empty: Any = None  # no start value; the stubs do not allow it
        forth, back = self._dis.calc(a, b, empty), self._dis.calc(b, a, empty)
        return np.asarray(forth, dtype=np.float32), np.asarray(back, dtype=np.float32)


def flow_at(flow: Flow, uv: FloatArray) -> FloatArray:
    """Flow (N, 2) at sub-pixel places (N, 2)."""
    u, v = (uv[:, i].astype(np.float32)[None] for i in (0, 1))
    values = cv2.remap(flow, u, v, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    return np.asarray(values[0], dtype=np.float64)
