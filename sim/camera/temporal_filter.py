"""The temporal filter of librealsense: an average over frames that gives way where depth jumps.

After what the documentation of librealsense says of it ("Post-processing filters"; Grunnet-Jepsen
and Tong, "Depth post-processing for Intel RealSense D400 depth cameras", which the paper cites for
its real-world trials). It runs on disparities, over the frames that are taken.

With smoothing a, a still pixel whose disparities are independent from frame to frame with variance
v comes out with variance a / (2 - a) v, and k frames apart with correlation (1 - a)^k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.records import BoolArray
from sim.camera.pictures import DepthImage


@dataclass(frozen=True, slots=True)
class TemporalFilterConfig:
    """Defaults are librealsense's."""

    alpha: float = 0.4  # weight of the new frame
    delta_px: float = 20.0 / 32.0  # a larger step of disparity starts anew: 20 steps of 1/32 px
    valid_frames: int = 2  # a hole keeps its last value if this many ...
    of_frames: int = 4  # ... of so many frames before had one: persistency "valid in 2/last 4"


class TemporalFilter:
    """Remembers the frames of one camera."""

    def __init__(self, config: TemporalFilterConfig, fb_px_m: float) -> None:
        """`fb_px_m`: focal length times baseline, pixels times metres."""
        self._config, self._fb = config, np.float32(fb_px_m)
        self._before: DepthImage | None = None  # disparities, px; NaN where never seen
        self._history: list[BoolArray] = []  # where the last frames had depth, newest first

    def filtered(self, depth_m: DepthImage) -> DepthImage:
        """The next frame (H, W) after the filter; NaN where it knows nothing.

        Raises:
            ValueError: the frame has another size than those before.
        """
        new = self._fb / depth_m.astype(np.float32)
        valid = np.isfinite(new)
        before = self._before
        if before is None:
            self._before, self._history = new, [valid]
            return depth_m
        if before.shape != new.shape:
            raise ValueError(f"frame {new.shape} after frames {before.shape}")
        c = self._config
        step = new - before
        # NaN compares False: a pixel seen for the first time is as it is.
        smooth = np.where(np.abs(step) < c.delta_px, before + np.float32(c.alpha) * step, new)
        smooth = np.where(valid, smooth, before)
        seen = np.sum(self._history, axis=0, dtype=np.uint8)
        self._before = smooth
        self._history = [valid, *self._history[: c.of_frames - 1]]
        return np.asarray(np.where(valid | (seen >= c.valid_frames), self._fb / smooth, np.nan))
