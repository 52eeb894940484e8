"""The camera's noise over a sequence of frames: what of it remembers the frames before."""

from __future__ import annotations

import numpy as np

from akm_fg.records import PinholeCamera
from sim.camera.noise import NoiseConfig, Surface, noisy_depth, noisy_rgb
from sim.camera.pictures import DepthImage
from sim.camera.temporal_filter import TemporalFilter


class NoisySensor:
    """Turns exact pictures into what one camera reports, frame after frame."""

    def __init__(
        self, config: NoiseConfig, camera: PinholeCamera, rng: np.random.Generator
    ) -> None:
        self._config, self._camera, self._rng = config, camera, rng
        self._filter = None
        if config.temporal is not None:
            fb_px_m = config.depth_focal_px * config.baseline_m
            self._filter = TemporalFilter(config.temporal, fb_px_m)
        self._brightness, self._stamp_s = 1.0, -np.inf

    def depth(self, exact_m: DepthImage, surface: Surface) -> DepthImage:
        """The next depth image (H, W), metres; NaN where nothing is known."""
        noisy = noisy_depth(exact_m, self._camera, self._config, self._rng, surface)
        return noisy if self._filter is None else self._filter.filtered(noisy)

    def rgb(self, surface: Surface, stamp_s: float) -> np.ndarray:
        """The colour image (H, W, 3) at a time, seconds, not before the last."""
        walk = self._config.rgb_drift_per_sqrt_s
        if walk > 0.0:
            waited_s = max(stamp_s - self._stamp_s, 0.0)
            step = walk * np.sqrt(waited_s) if np.isfinite(waited_s) else 0.0
            self._brightness *= float(np.exp(step * self._rng.standard_normal()))
            self._stamp_s = stamp_s
        return noisy_rgb(surface.rgb, self._config, self._rng, self._brightness)
