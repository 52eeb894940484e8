"""How far a depth reading may be off: the model the estimator assumes.

Stereo: z = f b / d, so an error of the disparity d gives sigma_z = sigma_d z^2 / (f b)
(Intel, "Best known methods for tuning RealSense D400 depth cameras", 2020: root-mean-square
error = distance^2 * subpixel / (focal length * baseline)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.records import FloatArray


@dataclass(frozen=True, slots=True)
class DepthNoiseModel:
    """A stereo camera's axial noise; the defaults are a RealSense D455's."""

    baseline_m: float = 0.095  # D455 datasheet
    disparity_sigma_px: float = 0.08  # Intel: 0.08 on textured targets, 0.1 and more on plain ones
    floor_m: float = (
        0.0005  # quantisation and calibration; never claim better than half a millimetre
    )
    correlation_px: float = 5.0  # width of the matching window: inside it errors are shared
    depth_focal_px: float | None = None  # of the depth camera; None: that of the picture

    def __post_init__(self) -> None:
        values = (self.baseline_m, self.disparity_sigma_px, self.floor_m, self.correlation_px)
        if not all(np.isfinite(v) and v > 0 for v in values):
            raise ValueError(f"depth noise {values}: every value must be finite and above 0")
        focal = self.depth_focal_px
        if focal is not None and not (np.isfinite(focal) and focal > 0):
            raise ValueError(f"depth_focal_px {focal}: must be finite and above 0")

    def sigma_m(self, depth_m: FloatArray, fx: float) -> FloatArray:
        """Standard deviation of single readings, metres, for the picture's focal length in pixels.

        NaN depth gives NaN.
        """
        focal_px = self.depth_focal_px or fx
        stereo = self.disparity_sigma_px * np.square(depth_m) / (focal_px * self.baseline_m)
        return np.sqrt(np.square(stereo, dtype=np.float64) + self.floor_m**2)

    def independent_samples(self, width_px: int) -> float:
        """How many independent readings a square window of this width holds, at least 1."""
        return max(1.0, (width_px / self.correlation_px) ** 2)
