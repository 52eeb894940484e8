"""What a stereo depth camera does to a perfect depth image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import special

from akm_fg.records import BoolArray, PinholeCamera
from sim.camera.pictures import DepthImage
from sim.camera.temporal_filter import TemporalFilterConfig


@dataclass(frozen=True, slots=True)
class NoiseConfig:
    """Noise of an active-stereo RGB-D camera; None as `disparity_sigma_px` turns depth noise off.

    The depth error follows from the disparity error: sd(z) = z^2 / (f b) * sd(disparity), as in
    Intel's "Best known methods for tuning RealSense depth cameras" (RMS error theory). The sources
    of every value stand in docs/camera.md.
    """

    name: str
    baseline_m: float = 0.095  # D455; a D435 has 0.050
    depth_focal_px: float = 425.0  # 848 x 480 depth stream, 90 deg wide
    depth_size_px: tuple[int, int] = (848, 480)  # what lies outside its view has no depth
    disparity_sigma_px: float | None = 0.08  # Intel gives < 0.1 px on textured targets
    correlation_px: float = 1.5  # the matching window blurs neighbouring errors together
    disparity_step_px: float = 1.0 / 32.0  # sub-pixel resolution of the D4 ASIC
    edge_jump_m: float = 0.02  # a step that counts as a depth edge
    edge_hole: float = 0.35  # share of edge pixels without depth
    edge_flying: float = 0.25  # share of edge pixels between the two surfaces
    grazing_cos: float = 0.25  # dropouts begin below this cosine of incidence
    dark_reflectance: float = 0.026  # dropouts begin below this diffuse reflectance
    glare_rad: float = 0.1  # a mirror dazzles this close to facing the camera
    hole_px: int = 7  # side of the patches in which dark and shiny surfaces are lost
    range_m: tuple[float, float] = (0.4, 6.0)  # working range of a D455
    temporal: TemporalFilterConfig | None = None
    rgb_sigma: float = 2.0  # grey levels, indoor light
    rgb_gain_sd: float = 0.0  # of each frame's brightness: flicker against the shutter
    rgb_tint_sd: float = 0.0  # of each frame's three colours: white balance
    rgb_drift_per_sqrt_s: float = 0.0  # random walk of the brightness: clouds, exposure


# The pattern is lost in the imager's noise where 255 grey levels * reflectance * contrast is below
# the noise; contrast 0.3 of dots on an evenly lit surface.
_D455 = NoiseConfig("d455")
NOISE_LEVELS = {
    "clean": NoiseConfig("clean", disparity_sigma_px=None, rgb_sigma=0.0),
    "d455": _D455,
    # As the paper's authors filter their D455.
    "d455-filtered": replace(_D455, name="d455-filtered", temporal=TemporalFilterConfig()),
    "harsh": NoiseConfig(
        "harsh",
        # The D455 data sheet's bound, 2 % at 4 m, as disparity: 0.08 m * f b / (4 m)^2.
        disparity_sigma_px=0.2,
        correlation_px=3.0,  # librealsense's spatial filter smooths errors over a few pixels more
        edge_hole=0.6,  # chosen: nearly twice d455's
        edge_flying=0.35,  # chosen: most of the others lie between the surfaces
        grazing_cos=0.4,  # chosen: dropouts begin at 66 deg of incidence, d455 at 76
        dark_reflectance=0.078,  # follows from three times the imager's noise
        glare_rad=0.2,  # chosen: twice d455's
        range_m=(0.52, 6.0),  # the data sheet's least distance at full resolution
        rgb_sigma=6.0,  # chosen: dim light, a gain that triples d455's noise
        rgb_gain_sd=0.03,  # chosen: lamps at mains frequency against a rolling shutter
        rgb_tint_sd=0.01,  # chosen: white balance that hunts by one part in a hundred
        rgb_drift_per_sqrt_s=0.02,  # chosen: a tenth of the light within half a minute
    ),
}

# The standard normal at 65536 equally likely levels. Looking it up is four times as fast as
# drawing it, and its variance is 1 to 1e-4.
_NORMAL = special.ndtri((np.arange(2**16) + 0.5) / 2**16).astype(np.float32)


def _levels(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.uint16]:
    return rng.integers(0, 2**16, shape, dtype=np.uint16)


def noisy_rgb(
    rgb: NDArray[np.uint8],
    config: NoiseConfig,
    rng: np.random.Generator,
    brightness: float = 1.0,
) -> NDArray[np.uint8]:
    """The image (H, W, 3) with white noise, and brightness and tint of its own.

    `brightness` is that of the light, beside what each frame has of its own.
    """
    gains = np.full(3, brightness)
    if config.rgb_gain_sd > 0.0:
        gains *= 1.0 + rng.normal(0.0, config.rgb_gain_sd)
    if config.rgb_tint_sd > 0.0:
        gains *= 1.0 + rng.normal(0.0, config.rgb_tint_sd, 3)
    if (gains != 1.0).any():
        levels = np.clip(np.rint(np.arange(256.0)[:, None] * gains), 0.0, 255.0)
        rgb = np.asarray(cv2.LUT(rgb, levels.astype(np.uint8)[None]), dtype=np.uint8)
    if config.rgb_sigma == 0.0:
        return rgb
    # Whole grey levels: the image has no others.
    noise = np.rint(config.rgb_sigma * _NORMAL).astype(np.int16).take(_levels(rng, rgb.shape))
    return np.asarray(cv2.add(rgb, noise, dtype=cv2.CV_8U))  # saturates


@dataclass(frozen=True, slots=True)
class Surface:
    """What a pixel's surface does with light."""

    rgb: NDArray[np.uint8]  # (H, W, 3) as rendered: its brightness stands for the reflectance
    specular: NDArray[np.float32]  # (H, W) share 0..1 that is mirrored instead of scattered


def noisy_depth(
    depth_m: DepthImage,
    camera: PinholeCamera,
    config: NoiseConfig,
    rng: np.random.Generator,
    surface: Surface | None = None,
) -> DepthImage:
    """Depth (H, W) as the camera would report it, before any filter; NaN where it sees nothing.

    Args:
        depth_m: exact depth along z, NaN where there is no surface.
        camera: intrinsics of the image.
        config: the noise.
        rng: source of randomness.
        surface: of what things are made; without it everything is bright and matt.
    """
    if config.disparity_sigma_px is None:
        return depth_m
    depth = np.where(np.isfinite(depth_m), depth_m, 50.0).astype(np.float32)
    lost = (depth > config.range_m[1]) | (depth < config.range_m[0])
    lost |= _stereo_shadow(depth, camera.fx * config.baseline_m)
    _lose_outside(lost, depth, camera, config)
    cosine = _incidence_cos(depth, camera)
    loss = 0.9 * np.clip(1.0 - cosine / config.grazing_cos, 0.0, 1.0)  # 0.9 edge-on
    some = np.flatnonzero(loss)
    lost.flat[some] |= rng.random(some.size) < loss.flat[some]
    if surface is not None:
        lost |= _surface_loss(surface, cosine, config) > _patches(depth.shape, config.hole_px, rng)
    depth = _mix_edges(depth, lost, config, rng)
    depth = _through_disparity(depth, config, rng)
    depth[lost] = np.nan
    return depth


def _mix_edges(
    depth: DepthImage, lost: BoolArray, config: NoiseConfig, rng: np.random.Generator
) -> DepthImage:
    """Depth with flying pixels at its edges; marks in `lost` those that fall into holes."""
    window = np.ones((3, 3), dtype=np.uint8)
    near, far = cv2.erode(depth, window), cv2.dilate(depth, window)
    edge = far - near > config.edge_jump_m * np.maximum(1.0, near) ** 2
    beside = np.flatnonzero(cv2.dilate(edge.astype(np.uint8), window))
    chance = rng.random(beside.size)
    lost.flat[beside] |= chance < config.edge_hole
    flying = beside[(chance > 1.0 - config.edge_flying) & edge.flat[beside]]
    low = near.flat[flying]
    high = np.minimum(far.flat[flying], low + 0.5)
    mixed = depth.copy()
    mixed.flat[flying] = low + rng.random(flying.size) * (high - low)
    return mixed


def _through_disparity(
    depth: DepthImage, config: NoiseConfig, rng: np.random.Generator
) -> DepthImage:
    """Depth to disparity, plus correlated noise, quantised, and back."""
    assert config.disparity_sigma_px is not None
    fb = config.depth_focal_px * config.baseline_m
    white = _NORMAL.take(_levels(rng, depth.shape))
    noise = np.asarray(cv2.GaussianBlur(white, (0, 0), config.correlation_px))
    # A Gaussian blur of sd s leaves white noise with variance 1 / (4 pi s^2).
    noise *= config.disparity_sigma_px * 2.0 * np.sqrt(np.pi) * config.correlation_px
    step = config.disparity_step_px
    disparity = np.rint((np.float32(fb) / depth + noise) / np.float32(step)) * np.float32(step)
    return np.asarray(np.float32(fb) / np.maximum(disparity, np.float32(step)))


def _stereo_shadow(depth: DepthImage, fb_px_m: float) -> BoolArray:
    """Pixels that the second imager, to the right, cannot see past something nearer."""
    seen_at = np.arange(depth.shape[1], dtype=np.float32) - np.float32(fb_px_m) / depth
    nearest_right = np.minimum.accumulate(seen_at[:, ::-1], axis=1)[:, ::-1]
    shadow = np.zeros(depth.shape, dtype=bool)
    shadow[:, :-1] = seen_at[:, :-1] > nearest_right[:, 1:] + 0.5
    return shadow


def _lose_outside(
    lost: BoolArray, depth: DepthImage, camera: PinholeCamera, config: NoiseConfig
) -> None:
    """Marks what only one imager of the depth stream has in view: a band on the left, and beyond.

    The depth stream comes from the left imager; what lies within b / z of its left border, in
    units of the image plane, is outside the right one's view.
    """
    half_x, half_y = (side / 2.0 / config.depth_focal_px for side in config.depth_size_px)
    x = (np.arange(depth.shape[1]) - camera.cx) / camera.fx
    y = (np.arange(depth.shape[0]) - camera.cy) / camera.fy
    lost[:, x > half_x] = True
    lost[np.abs(y) > half_y] = True
    near_border = x < config.baseline_m / config.range_m[0] - half_x
    seen_at = x[near_border] - config.baseline_m / depth[:, near_border]
    lost[:, near_border] |= seen_at < -half_x


def _incidence_cos(depth: DepthImage, camera: PinholeCamera) -> DepthImage:
    """Cosine of the angle between line of sight and surface normal (H, W); 1 is face on."""
    # For a plane n.p = 1 inverse depth is n.(x, y, 1): linear, so its gradient is exact.
    inv = np.float32(1.0) / depth
    ramp = cv2.Sobel(inv, cv2.CV_32F, 1, 0, ksize=1), cv2.Sobel(inv, cv2.CV_32F, 0, 1, ksize=1)
    nx, ny = ramp[0] * (0.5 * camera.fx), ramp[1] * (0.5 * camera.fy)
    x = ((np.arange(depth.shape[1]) - camera.cx) / camera.fx).astype(np.float32)
    y = ((np.arange(depth.shape[0]) - camera.cy) / camera.fy).astype(np.float32)[:, None]
    nz = inv - nx * x - ny * y
    return np.asarray(inv / np.sqrt((nx**2 + ny**2 + nz**2) * (x**2 + y**2 + 1.0)))


# Linear reflectance of a grey level, by the gamma that images are shown with.
_REFLECTANCE = ((np.arange(256) / 255.0) ** 2.2).astype(np.float32)


def _surface_loss(surface: Surface, cosine: DepthImage, config: NoiseConfig) -> DepthImage:
    """Chance of no return by the surface's own nature: too dark, or a mirror that dazzles.

    What is mirrored does not come back, so a shiny surface is dark but for the direction in which
    it mirrors the projector into the imagers, which stand side by side.
    """
    grey = np.asarray(cv2.cvtColor(surface.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    scattered = _REFLECTANCE.take(grey) * (1.0 - surface.specular)
    dark = 0.9 * np.clip(1.0 - scattered / config.dark_reflectance, 0.0, 1.0)
    glare = np.where(cosine > np.cos(config.glare_rad), surface.specular, 0.0)
    return np.asarray(np.maximum(dark, glare))


def _patches(shape: tuple[int, ...], side_px: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Uniform random numbers (H, W), the same within squares of `side_px`."""
    small = rng.random([-(-n // side_px) for n in shape], dtype=np.float32)
    large = np.repeat(np.repeat(small, side_px, axis=0), side_px, axis=1)
    return np.asarray(large[: shape[0], : shape[1]])
