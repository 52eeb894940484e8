"""Pixels to points in space: depth at sub-pixel places, with its covariance.

Around each pixel a plane is fitted robustly. A plane of the scene is linear in inverse depth
over the image (1/z = a + b du + c dv), so slanted panels bring no bias. Where the window
straddles an edge, or most of it is unknown, the point is lost.

Covariance (camera frame): a track that is off by a few tenths of a pixel still lies on the
surface, so pixel noise moves the point along it; depth noise moves it along the ray:

    p(u, v) = z(u, v) ((u - cx) / fx, (v - cy) / fy, 1)
    cov_cam = J cov_px2 J^T + sigma_z^2 r r^T,   J = (p_u, p_v), r = p / z

What a point may be off because its patch shows what lies nearer or farther lasts: see `relief`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from akm_fg.geometry.batches import solutions
from akm_fg.interfaces import SeenPixels
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.tracking.relief import ReliefConfig, relief_m
from akm_fg.perception.tracking.track_store import SeenPoints
from akm_fg.records import BoolArray, FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class LiftingConfig:
    """Local plane fit."""

    radius_px: int = 3  # 7 x 7 readings: spans the noise's correlation, still a small patch
    min_share: float = 0.6  # of the window that agrees with the plane; an edge leaves about half
    gate_sigmas: float = 3.5  # of one reading, around the plane
    gate_m: float = 0.004  # on top: handles and mouldings are not planes
    max_slope: float = 5.0  # tangent of the angle between ray and normal; 79 deg, then depth jumps
    relief: ReliefConfig = field(default_factory=ReliefConfig)


@dataclass(frozen=True, slots=True)
class LocalDepth:
    """Depth at N sub-pixel places; NaN where there is none."""

    depth_m: FloatArray  # (N,)
    slope_m_per_px: FloatArray  # (N, 2) d depth / d (u, v)


def local_depth(
    frame: RgbdFrame, uv: FloatArray, noise: DepthNoiseModel, config: LiftingConfig | None = None
) -> LocalDepth:
    """Fit the depth of one frame around pixels (N, 2); NaN pixels give NaN."""
    config = config or LiftingConfig()
    r, camera = config.radius_px, frame.camera
    inside = np.asarray(np.isfinite(uv).all(axis=1))
    whole = np.rint(np.where(inside[:, None], uv, 0)).astype(int)
    inside &= (whole >= r).all(axis=1)
    inside &= (whole[:, 0] < camera.width - r) & (whole[:, 1] < camera.height - r)
    whole[~inside] = r
    dv, du = (d.ravel() for d in np.mgrid[-r : r + 1, -r : r + 1])
    z = frame.depth_m[whole[:, 1, None] + dv, whole[:, 0, None] + du].astype(np.float64)
    z[~inside] = np.nan
    offset = np.where(inside[:, None], whole - uv, 0.0)
    A = np.stack([np.ones(z.shape), offset[:, :1] + du, offset[:, 1:] + dv], axis=-1)
    known = np.isfinite(z) & (z > 0)
    inverse = np.where(known, 1 / np.where(known, z, 1.0), 0.0)
    plane, agree = _fit(A, inverse, known, noise, frame.camera.fx, config)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m = 1 / plane[:, 0]
        slope = -plane[:, 1:] * depth_m[:, None] ** 2
        steep = np.hypot(slope[:, 0] * camera.fx, slope[:, 1] * camera.fy) / depth_m
        lost = (agree < config.min_share * z.shape[1]) | ~(depth_m > 0)
        lost |= ~(steep < config.max_slope) | ~inside
    return LocalDepth(np.where(lost, np.nan, depth_m), np.where(lost[:, None], np.nan, slope))


def _fit(
    A: FloatArray,
    inverse: FloatArray,
    known: BoolArray,
    noise: DepthNoiseModel,
    fx: float,
    config: LiftingConfig,
) -> tuple[FloatArray, FloatArray]:
    """Planes (N, 3) through inverse depths (N, W), and how many readings agree (N,).

    Starts from the readings near the lower-median depth, widened by the steepest slope that is
    allowed, and keeps what lies within the gate twice.
    """
    ordered = np.sort(np.where(known, inverse, np.inf), axis=1)
    middle_rank = np.maximum(known.sum(axis=1) - 1, 0)[:, None] // 2
    middle = np.take_along_axis(ordered, middle_rank, axis=1)
    middle = np.where(np.isfinite(middle), middle, 1.0)
    gate_m = config.gate_sigmas * noise.sigma_m(1 / middle, fx) + config.gate_m
    per_px = config.max_slope / fx * middle  # d (1/z) / d px of the steepest plane
    reach = per_px * np.abs(A[..., 1:]).max(axis=-1) + gate_m * middle**2
    keep = known & (np.abs(inverse - middle) <= reach)
    plane: FloatArray = np.zeros((len(A), 3, 1))
    for last in (False, False, True):
        At = np.where(keep[..., None], A, 0.0).transpose(0, 2, 1)
        normal = At @ A + 1e-9 * np.eye(3)
        plane = solutions(normal, At @ inverse[..., None])
        residual = np.abs((A @ plane)[..., 0] - inverse)
        if not last:  # first shed the far half of gross outliers, then what the gate excludes
            kept = np.sort(np.where(keep, residual, np.inf), axis=1)
            middle_rank = np.maximum(keep.sum(axis=1) - 1, 0)[:, None] // 2
            spread = np.take_along_axis(kept, middle_rank, axis=1)  # inf where none is kept
            keep = known & (residual <= np.maximum(3 * spread, gate_m * middle**2))
    agree = (known & (residual <= gate_m * middle**2)).sum(axis=1)
    return plane[..., 0], np.asarray(agree, dtype=np.float64)


def lift(
    seen: SeenPixels,
    frame: RgbdFrame,
    noise: DepthNoiseModel,
    config: LiftingConfig | None = None,
) -> SeenPoints:
    """Points and covariances in the world frame of the pixels that a frame shows.

    Args:
        seen: M pixels in the frame.
        frame: its depth.
        noise: what the depth camera is assumed to do.
        config: tuning of the local plane fit.
    """
    config = config or LiftingConfig()
    local = local_depth(frame, seen.uv, noise, config)
    p_cam = frame.camera.back_project(seen.uv, local.depth_m)
    J_cam_uv = _by_pixel(frame, p_cam, local)
    cov_cam = _on_surface(J_cam_uv, seen.cov_px2) + _along_ray(frame, p_cam, noise, config)
    R = frame.T_world_cam.rotation().matrix()
    p_world = p_cam @ R.T + frame.T_world_cam.translation()
    side_px, r = 2 * config.radius_px + 1, config.radius_px
    readings = noise.independent_samples(side_px) * r * (r + 1) / 3  # times their variance, px^2
    relief = relief_m(
        frame, seen.uv, local.depth_m, local.slope_m_per_px, readings**-0.5, noise, config.relief
    )
    relief_cam = relief[:, None] * p_cam / p_cam[:, 2:]
    slip = None
    if seen.lasting_px2 is not None:
        slip = (J_cam_uv @ _longest(seen.lasting_px2)[..., None])[..., 0] @ R.T
    return SeenPoints(seen, p_world, R @ cov_cam @ R.T, slip, relief_cam @ R.T)


def _longest(cov_px2: FloatArray) -> FloatArray:
    """(N, 2) the longest axis of covariances, its length a standard deviation: along an edge."""
    variance, axes = np.linalg.eigh(cov_px2)
    return np.asarray(axes[..., -1] * np.sqrt(np.maximum(variance[..., -1:], 0.0)))


def _by_pixel(frame: RgbdFrame, p_cam: FloatArray, local: LocalDepth) -> FloatArray:
    """(N, 3, 2) how points on the surface move with their pixels."""
    z = local.depth_m
    J_cam_uv = (p_cam / z[:, None])[:, :, None] * local.slope_m_per_px[:, None, :]
    J_cam_uv[:, 0, 0] += z / frame.camera.fx
    J_cam_uv[:, 1, 1] += z / frame.camera.fy
    return np.asarray(J_cam_uv)


def _on_surface(J_cam_uv: FloatArray, cov_px2: FloatArray) -> FloatArray:
    """(N, 3, 3) in the camera frame, of what pixels (N, 2, 2) are off."""
    return np.asarray(J_cam_uv @ cov_px2 @ J_cam_uv.transpose(0, 2, 1))


def _along_ray(
    frame: RgbdFrame, p_cam: FloatArray, noise: DepthNoiseModel, config: LiftingConfig
) -> FloatArray:
    """(N, 3, 3) in the camera frame, of what the depth is off."""
    z = p_cam[:, 2]
    samples = noise.independent_samples(2 * config.radius_px + 1)
    var_z = noise.sigma_m(z, frame.camera.fx) ** 2 / samples + noise.floor_m**2
    ray = p_cam / z[:, None]
    return np.asarray(np.einsum("n,ni,nk->nik", var_z, ray, ray))
