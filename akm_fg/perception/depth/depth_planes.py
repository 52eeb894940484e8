"""A plane through the depth around every pixel at once: smoothed depth and normals of a surface.

A plane n . p = 1 of the scene is linear in inverse depth over the image,

    1/z = a + b du + c dv,   n = (f_x b, f_y c, a - b f_x x - c f_y y),   x = (u - cx) / f_x,

so a least-squares fit in a window needs only window sums (moments) of the inverse depth, which
box filters give for all pixels in one go. Two passes: readings far from the plane of their own
window are left out of the second.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import BoolArray, FloatArray, PinholeCamera, RgbdFrame

Image = NDArray[np.floating]  # (H, W) float32
Box = tuple[slice, slice]  # rows, columns
_FARTHEST = np.float32(0.05)  # 1/m; a window whose plane passes behind the camera has no depth


@dataclass(frozen=True, slots=True)
class DepthPlanesConfig:
    """Local plane fits."""

    radius_px: int = 7  # 3 cm at 1.2 m and 600 px: normals of 3 deg; smaller ones are all noise
    min_share: float = 0.6  # of the window with readings on the plane; an edge leaves about half
    gate_sigmas: float = 3.5  # of one reading, around the plane of its own window
    gate_m: float = 0.002  # on top: mouldings
    max_rms_sigmas: float = 1.5  # of a window; a step of 2 cm through it leaves a fifth of that
    max_rms_m: float = 0.001  # on top
    max_slope: float = 5.0  # tangent of the angle between ray and normal; 79 deg


@dataclass(frozen=True, slots=True)
class PlaneSamples:
    """Surface at N pixels; NaN where the depth is no plane."""

    p_world: FloatArray  # (N, 3) metres
    normal_world: FloatArray  # (N, 3) unit, towards the camera
    sigma_normal_m: FloatArray  # (N,) sd of a single depth reading, along the normal


@dataclass(frozen=True, slots=True)
class MetPlanes:
    """Surface at those M of some pixels whose depth is a plane, in the camera's axes."""

    index: NDArray[np.int_]  # (M,) of the pixels, growing
    p_cam: FloatArray  # (3, M) metres
    normal_cam: FloatArray  # (3, M) unit, towards the camera
    sigma_normal_m: FloatArray  # (M,) sd of a single depth reading, along the normal


@dataclass(frozen=True, slots=True)
class DepthPlanes:
    """Local planes of one depth image; lookups cost the same at any pixel."""

    inverse_depth: Image  # (H, W) 1/m, of the plane at the pixel's centre
    slope_u: Image  # (H, W) d inverse depth / d u, 1/(m px)
    slope_v: Image  # (H, W)
    valid: BoolArray  # (H, W); elsewhere the other fields mean nothing
    depth_m: NDArray[np.floating]  # (H, W) the readings themselves, in and outside of the mask
    camera: PinholeCamera
    T_world_cam: gtsam.Pose3
    noise: DepthNoiseModel

    def at(self, uv: FloatArray) -> PlaneSamples:
        """Points and normals where the rays of pixels (N, 2) meet the plane of the nearest pixel.

        Pixels outside the image, without a plane, or NaN give NaN.
        """
        found = self.met(uv[:, 0], uv[:, 1])
        R, eye = self.T_world_cam.rotation().matrix(), self.T_world_cam.translation()
        p_world, normal = (np.full((len(uv), 3), np.nan) for _ in range(2))
        sigma = np.full(len(uv), np.nan)
        p_world[found.index] = found.p_cam.T @ R.T + eye
        normal[found.index] = found.normal_cam.T @ R.T
        sigma[found.index] = found.sigma_normal_m
        return PlaneSamples(p_world, normal, sigma)

    def met(self, u: FloatArray, v: FloatArray) -> MetPlanes:
        """The planes that the rays of pixels (N,), (N,) meet, in the camera's axes."""
        camera = self.camera
        column, row = np.rint(u), np.rint(v)  # NaN compares False
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        index = np.flatnonzero(inside)
        place = (row[index] * camera.width + column[index]).astype(int)
        planes = self.valid.ravel()[place]
        index, place = index[planes], place[planes]
        u, v, column, row = u[index], v[index], column[index], row[index]
        b, c = (k.ravel()[place].astype(float) for k in (self.slope_u, self.slope_v))
        a = self.inverse_depth.ravel()[place] + b * (u - column) + c * (v - row)
        a = np.where(a > 0, a, np.nan)
        x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
        n_x, n_y = b * camera.fx, c * camera.fy
        n_z = a - n_x * x - n_y * y
        length = np.sqrt(n_x * n_x + n_y * n_y + n_z * n_z)
        z = 1 / a
        # n . (x, y, 1) is the inverse depth.
        sigma = self.noise.sigma_m(z, camera.fx) * a / length
        p_cam, normal_cam = np.stack([x * z, y * z, z]), np.stack([n_x, n_y, n_z]) / -length
        return MetPlanes(index, p_cam, normal_cam, sigma)


def depth_planes(
    frame: RgbdFrame,
    noise: DepthNoiseModel,
    mask: BoolArray | None = None,
    config: DepthPlanesConfig | None = None,
) -> DepthPlanes:
    """Fit a plane around every pixel.

    Args:
        frame: its depth.
        noise: what a reading may be off; scales the tests of what is a plane.
        mask: (H, W) pixels to use, and to fit; all with depth if not given. Windows reach to the
            mask's border and no farther.
        config: tuning.

    Raises:
        ValueError: the mask has another size than the image.
    """
    config = config or DepthPlanesConfig()
    shape = frame.depth_m.shape
    if mask is not None and mask.shape != shape:
        raise ValueError(f"mask {mask.shape}, expected {shape}")
    a, b, c = (np.zeros(shape, np.float32) for _ in range(3))
    valid = np.zeros(shape, dtype=bool)
    box = bounding_box(mask, config.radius_px) if mask is not None else np.s_[:, :]
    if box is not None:
        z = frame.depth_m[box]
        known = np.asarray(np.isfinite(z) & (z > 0) & (True if mask is None else mask[box]))
        a[box], b[box], c[box], valid[box] = _fit(z, known, frame.camera, noise, config)
    return DepthPlanes(a, b, c, valid, frame.depth_m, frame.camera, frame.T_world_cam, noise)


def bounding_box(mask: BoolArray, margin_px: int) -> Box | None:
    """Rows and columns that hold all True pixels and a margin; None if there are none."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return None
    low = max(0, int(rows[0]) - margin_px), max(0, int(columns[0]) - margin_px)
    high = int(rows[-1]) + margin_px + 1, int(columns[-1]) + margin_px + 1
    return np.s_[low[0] : high[0], low[1] : high[1]]


@dataclass(frozen=True, slots=True)
class PlaneWindows:
    """A plane of inverse depth around every pixel of a crop (h, w), with or without a reading."""

    inverse_depth: Image  # 1/m, at the pixel's centre
    slope_u: Image  # d inverse depth / d u, 1/(m px)
    slope_v: Image
    readings: Image  # in the window
    count: Image  # of them on the plane; 0 where these lie on a line
    beside_px: Image  # from the pixel to their middle
    plane: BoolArray  # whether it is one: enough readings, near it, and it is not seen edge-on
    gate: Image  # 1/m, how far a reading may lie off it


def _fit(
    z: Image,
    known: BoolArray,
    camera: PinholeCamera,
    noise: DepthNoiseModel,
    config: DepthPlanesConfig,
) -> tuple[Image, Image, Image, BoolArray]:
    """Inverse depth, slopes and validity (h, w) of a crop of the depth image."""
    fit = plane_windows(z, known, camera, noise, config)
    inverse = 1 / np.where(known, z, np.float32(np.inf))
    # A flying pixel in front of a plane is not on it.
    valid = known & fit.plane & (np.abs(inverse - fit.inverse_depth) < fit.gate)
    return fit.inverse_depth, fit.slope_u, fit.slope_v, valid


def plane_windows(
    z: Image,
    known: BoolArray,
    camera: PinholeCamera,
    noise: DepthNoiseModel,
    config: DepthPlanesConfig,
) -> PlaneWindows:
    """Fit a plane to the readings in a window around every pixel.

    Args:
        z: (h, w) depth of a crop.
        known: (h, w) readings to use.
        camera: of the picture.
        noise: what a reading may be off.
        config: tuning.
    """
    inverse = 1 / np.where(known, z, np.float32(np.inf))
    middle = np.float32(inverse.sum(dtype=np.float64) / max(np.count_nonzero(known), 1))
    offset = np.where(known, inverse - middle, 0)  # small numbers: float32 keeps the residuals
    first = _Windows.of(offset, known, config.radius_px)
    safe = np.where(known, z, 1 / np.maximum(first.value + middle, _FARTHEST))
    per_m = (1 / np.square(safe)).astype(np.float32)  # of inverse depth
    sigma = noise.sigma_m(safe, camera.fx).astype(np.float32) * per_m
    gate = np.float32(config.gate_sigmas) * sigma + np.float32(config.gate_m) * per_m
    kept = known & (np.abs(offset - first.value) < gate)
    offset = np.where(kept, offset, 0)
    fit = _Windows.of(offset, kept, config.radius_px)
    a, b, c = fit.value + middle, fit.slope_u, fit.slope_v
    limit = np.float32(config.max_rms_sigmas) * sigma + np.float32(config.max_rms_m) * per_m
    plane = fit.on_plane >= config.min_share * (2 * config.radius_px + 1) ** 2
    plane &= (fit.mean_square(offset) < np.square(limit)) & (a > 0)
    slope2 = np.square(b * np.float32(camera.fx)) + np.square(c * np.float32(camera.fy))
    plane &= slope2 < np.square(np.float32(config.max_slope) * a)
    return PlaneWindows(a, b, c, first.on_plane, fit.on_plane, fit.beside_px(), plane, gate)


@dataclass(frozen=True, slots=True)
class _Windows:
    """Least-squares planes through values in a window around each pixel, (h, w) all."""

    radius: int
    value: Image  # at the middle
    slope_u: Image
    slope_v: Image
    on_plane: Image  # number of readings; 0 where these lie on a line
    share: Image  # of one reading
    mean: Image  # of the values
    mean_u: Image  # of the readings' places, pixels from the middle
    mean_v: Image
    pull_u: Image  # sum of the values times places, from their means
    pull_v: Image

    @staticmethod
    def of(values: Image, known: BoolArray, radius: int) -> _Windows:
        """Through `values`, which are 0 where not known."""
        one = np.ones(2 * radius + 1, np.float32)
        ramp = np.arange(-radius, radius + 1, dtype=np.float32)
        m = known.astype(np.float32)
        n = _window(m, one, one)
        share = 1 / np.maximum(n, 1)
        u, v = _window(m, ramp, one), _window(m, one, ramp)
        mean, mean_u, mean_v = _window(values, one, one) * share, u * share, v * share
        uu = _window(m, ramp**2, one) - u * mean_u  # from the means: a 2 x 2 system is left
        vv = _window(m, one, ramp**2) - v * mean_v
        uv = _window(m, ramp, ramp) - u * mean_v
        pull_u = _window(values, ramp, one) - u * mean
        pull_v = _window(values, one, ramp) - v * mean
        determinant = uu * vv - uv * uv
        solvable = determinant > 1e-3 * np.square(np.maximum(n, 1))  # less: readings on a line
        inverse = 1 / np.where(solvable, determinant, np.float32(np.inf))
        b, c = (vv * pull_u - uv * pull_v) * inverse, (uu * pull_v - uv * pull_u) * inverse
        a = mean - b * mean_u - c * mean_v
        on_plane = np.where(solvable, n, 0)
        return _Windows(radius, a, b, c, on_plane, share, mean, mean_u, mean_v, pull_u, pull_v)

    def mean_square(self, values: Image) -> Image:
        """Of the residuals of these values."""
        one = np.ones(2 * self.radius + 1, np.float32)
        square = _window(values * values, one, one) * self.share - np.square(self.mean)
        square -= (self.slope_u * self.pull_u + self.slope_v * self.pull_v) * self.share
        return np.maximum(square, 0)

    def beside_px(self) -> Image:
        """From the pixel to the middle of its readings."""
        return np.asarray(np.sqrt(np.square(self.mean_u) + np.square(self.mean_v)))


def _window(image: Image, along_u: Image, along_v: Image) -> Image:
    """Sums over windows around all pixels, weighed along both axes."""
    got = cv2.sepFilter2D(image, cv2.CV_32F, along_u, along_v, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(got, dtype=np.float32)
