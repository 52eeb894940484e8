"""What a stereo depth camera does to a perfect depth image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter, maximum_filter, minimum_filter

from akm_fg.records import BoolArray, FloatArray, PinholeCamera


@dataclass(frozen=True, slots=True)
class NoiseConfig:
    """Noise of an active-stereo RGB-D camera; None as `disparity_sigma_px` turns depth noise off.

    The depth error follows from the disparity error: sd(z) = z^2 / (f b) * sd(disparity), as in
    Intel's "Best known methods for tuning RealSense depth cameras" (RMS error theory).
    """

    name: str
    baseline_m: float = 0.095  # D455; a D435 has 0.050
    depth_focal_px: float = 425.0  # 848 x 480 depth stream, 90 deg wide
    disparity_sigma_px: float | None = 0.08  # Intel gives < 0.1 px on textured targets
    correlation_px: float = 1.5  # the matching window blurs neighbouring errors together
    disparity_step_px: float = 1.0 / 32.0  # sub-pixel resolution of the D4 ASIC
    edge_jump_m: float = 0.02  # a step that counts as a depth edge
    edge_hole: float = 0.35  # share of edge pixels without depth
    edge_flying: float = 0.25  # share of edge pixels between the two surfaces
    grazing_cos: float = 0.25  # dropouts begin below this cosine of incidence
    range_m: tuple[float, float] = (0.4, 6.0)  # working range of a D455
    rgb_sigma: float = 2.0  # grey levels, indoor light


NOISE_LEVELS = {
    "clean": NoiseConfig("clean", disparity_sigma_px=None, rgb_sigma=0.0),
    "d455": NoiseConfig("d455"),
}


def noisy_rgb(
    rgb: NDArray[np.uint8], config: NoiseConfig, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """The image (H, W, 3) with white noise."""
    if config.rgb_sigma == 0.0:
        return rgb
    noise = rng.standard_normal(rgb.shape, dtype=np.float32) * np.float32(config.rgb_sigma)
    return np.asarray(np.clip(rgb + noise + 0.5, 0, 255), dtype=np.uint8)


def noisy_depth(
    depth_m: FloatArray, camera: PinholeCamera, config: NoiseConfig, rng: np.random.Generator
) -> FloatArray:
    """Depth (H, W) as the camera would report it; NaN where it sees nothing.

    Args:
        depth_m: exact depth along z, NaN where there is no surface.
        camera: intrinsics of the image.
        config: the noise.
        rng: source of randomness.
    """
    if config.disparity_sigma_px is None:
        return depth_m
    depth = np.where(np.isfinite(depth_m), depth_m, 50.0)
    lost = depth > config.range_m[1]
    lost |= depth < config.range_m[0]
    lost |= _stereo_shadow(depth, camera.fx * config.baseline_m)
    lost |= rng.random(depth.shape) < _grazing_loss(depth, camera, config.grazing_cos)
    near, far = minimum_filter(depth, 3), maximum_filter(depth, 3)
    edge = far - near > config.edge_jump_m * np.maximum(1.0, near) ** 2
    chance = rng.random(depth.shape)
    lost |= binary_dilation(edge, iterations=1) & (chance < config.edge_hole)
    flying = edge & (chance > 1.0 - config.edge_flying)
    mixed = near + rng.random(depth.shape) * (np.minimum(far, near + 0.5) - near)
    depth = np.where(flying, mixed, depth)
    depth = _through_disparity(depth, config, rng)
    return np.where(lost, np.nan, depth)


def _through_disparity(
    depth: FloatArray, config: NoiseConfig, rng: np.random.Generator
) -> FloatArray:
    """Depth to disparity, plus correlated noise, quantised, and back."""
    assert config.disparity_sigma_px is not None
    fb = config.depth_focal_px * config.baseline_m
    noise = gaussian_filter(
        rng.standard_normal(depth.shape, dtype=np.float32), config.correlation_px, truncate=3.0
    )
    # A Gaussian blur of sd s leaves white noise with variance 1 / (4 pi s^2).
    noise *= config.disparity_sigma_px * 2.0 * np.sqrt(np.pi) * config.correlation_px
    step = config.disparity_step_px
    disparity = np.round((fb / depth + noise) / step) * step
    return fb / np.maximum(disparity, step)


def _stereo_shadow(depth: FloatArray, fb_px_m: float) -> BoolArray:
    """Pixels that the second imager, to the right, cannot see past something nearer."""
    seen_at = np.arange(depth.shape[1]) - fb_px_m / depth
    nearest_right = np.minimum.accumulate(seen_at[:, ::-1], axis=1)[:, ::-1]
    shadow = np.zeros(depth.shape, dtype=bool)
    shadow[:, :-1] = seen_at[:, :-1] > nearest_right[:, 1:] + 0.5
    return shadow


def _grazing_loss(depth: FloatArray, camera: PinholeCamera, cos_start: float) -> FloatArray:
    """Chance of no return: 0 at `cos_start` of incidence, 0.9 edge-on."""
    dz_dv, dz_du = np.gradient(depth)
    # For a plane n.p = c the gradient of inverse depth gives n up to scale: stable on planes.
    inv = 1.0 / depth
    nx, ny = -dz_du * inv**2 * camera.fx, -dz_dv * inv**2 * camera.fy
    u = (np.arange(depth.shape[1]) - camera.cx) / camera.fx
    v = ((np.arange(depth.shape[0]) - camera.cy) / camera.fy)[:, None]
    nz = inv - nx * u - ny * v
    norm = np.sqrt(nx**2 + ny**2 + nz**2) * np.sqrt(u**2 + v**2 + 1.0)
    cosine = np.abs(inv) / norm
    return 0.9 * np.clip(1.0 - cosine / cos_start, 0.0, 1.0)
