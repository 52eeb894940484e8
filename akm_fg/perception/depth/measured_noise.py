"""How noisy a depth camera is, from one of its pictures: against the planes around its pixels.

Most of what a picture shows is smooth over a few pixels, so the median distance of readings from
the planes of their own windows (linear in inverse depth, see `depth_planes`) is that of noise. It
holds what is shared by the frames, too: patterns that a camera prints on every picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import RgbdFrame

_MAD = 1.4826  # standard deviation of a Gaussian over its median absolute value


@dataclass(frozen=True, slots=True)
class MeasuredNoiseConfig:
    """When the camera is taken to be worse than the model says."""

    radius_px: int = 7  # of the windows: wider than the errors that neighbours share
    least_share: float = 0.9  # of a window with depth
    least_pixels: int = 500
    trusted: float = 1.7  # times the model's: within, the model stands
    largest: float = 20.0  # times: beyond, it is no noise that is measured
    least: float = 0.5  # times: waves wider than a window are errors too, and are not measured


def measured_noise(
    frame: RgbdFrame, model: DepthNoiseModel, config: MeasuredNoiseConfig | None = None
) -> DepthNoiseModel:
    """The model with the disparity noise that a picture shows, where that is clearly more.

    Args:
        frame: its depth.
        model: what is assumed.
        config: tuning.
    """
    config = config or MeasuredNoiseConfig()
    found = noise_scale(frame, model, config)
    if not found > config.trusted:  # NaN: too little depth
        return model
    scale = min(max(found, config.least), config.largest)
    return replace(model, disparity_sigma_px=scale * model.disparity_sigma_px)


def noise_scale(frame: RgbdFrame, model: DepthNoiseModel, config: MeasuredNoiseConfig) -> float:
    """Standard deviation of readings about their surroundings, over the model's; or NaN."""
    z = frame.depth_m.astype(np.float64)
    known = np.isfinite(z) & (z > 0)
    side = (2 * config.radius_px + 1,) * 2
    share = cv2.boxFilter(known.astype(np.float64), cv2.CV_64F, side)
    full = known & (share > config.least_share)
    if full.sum() < config.least_pixels:
        return float("nan")
    inverse = np.where(known, 1 / np.where(known, z, 1.0), 0.0)
    middle = cv2.boxFilter(inverse, cv2.CV_64F, side) / np.maximum(share, config.least_share)
    off = np.abs(inverse - middle)[full]  # a plane's mean over a window is its value at the middle
    sigma = model.sigma_m(z[full], frame.camera.fx) / z[full] ** 2
    return float(_MAD * np.median(off / sigma))
