"""How far from a point's plane lies what its patch shows: of so much its place may be another.

What a tracker has followed need not lie where its middle is: beside a handle's post all that the
patch shows is the post, some centimetres nearer than the door around it. So long as it is followed
the point is as much too far along its ray, which looks like a slide while the part turns. The error
lasts, and is as large as the relief of what is to be seen:

    relief^2 = sum |grad I|^2 (z - z_plane)^2 / sum |grad I|^2   over the patch, beyond the gate.

The plane is that of the point, fitted anew to what lies near it in the whole patch: in its own
small window its slope is known too badly to reach so far.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from akm_fg.geometry.batches import solutions
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class ReliefConfig:
    """What counts as off the plane."""

    radius_px: int = 7  # what trackers look at: `AffineMatchConfig.radius_px`
    stride_px: int = 2  # neighbouring readings tell the same: a quarter of them will do
    gate_sigmas: float = 3.5  # of one reading, around the plane
    gate_m: float = 0.004  # on top: mouldings
    least_share: float = 0.3  # of the patch near the plane, to fit it anew


def relief_m(
    frame: RgbdFrame,
    uv: FloatArray,
    depth_m: FloatArray,
    slope_m_per_px: FloatArray,
    slope_sigmas_per_px: float,
    noise: DepthNoiseModel,
    config: ReliefConfig,
) -> FloatArray:
    """Root mean square relief (N,) along z around pixels; see the module's text.

    Args:
        frame: the image.
        uv: (N, 2) the patches' middles.
        depth_m: (N,) of the points; NaN gives NaN.
        slope_m_per_px: (N, 2) of their planes.
        slope_sigmas_per_px: standard deviation of those slopes, in readings' a pixel.
        noise: of single readings.
        config: tuning.
    """
    steps = slice(-config.radius_px, config.radius_px + 1, config.stride_px)
    dv, du = np.mgrid[steps, steps].reshape(2, -1)
    whole = np.rint(np.where(np.isfinite(uv), uv, 0.0)).astype(int)
    height, width = frame.depth_m.shape
    u = np.clip(whole[:, :1] + du, 0, width - 1)
    v = np.clip(whole[:, 1:] + dv, 0, height - 1)
    z = frame.depth_m[v, u].astype(np.float64)
    known = np.isfinite(z) & (z > 0) & np.isfinite(depth_m)[:, None]
    z = np.where(known, z, 1.0)
    middle = np.where(np.isfinite(depth_m), depth_m, 1.0)[:, None]
    # Planes are linear in inverse depth.
    A = np.stack([np.ones(z.shape), u - uv[:, :1], v - uv[:, 1:]], axis=-1)
    A = np.where(known[..., None], A, 0.0)
    slope = np.where(known.any(axis=1)[:, None], slope_m_per_px, 0.0)
    plane = np.concatenate([1 / middle, -slope / middle**2], axis=1)
    sigma = noise.sigma_m(middle, frame.camera.fx)
    reach = np.sqrt(1 + slope_sigmas_per_px**2 * (A[..., 1:] ** 2).sum(axis=-1))
    gate = config.gate_sigmas * sigma + config.gate_m
    near = known & (np.abs(_off_m(z, A, plane)) < gate + config.gate_sigmas * sigma * (reach - 1))
    enough = near.sum(axis=1) >= config.least_share * known.shape[1]
    kept = np.where(near[..., None], A, 0.0).transpose(0, 2, 1)
    anew = solutions(kept @ A + 1e-9 * np.eye(3), kept @ (1 / z)[..., None])[..., 0]
    off = _off_m(z, A, np.where(enough[:, None], anew, plane))
    square = np.where(np.abs(off) > gate, off**2, 0.0)
    gray = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)
    along_u, along_v = (cv2.Sobel(gray, cv2.CV_32F, *d, ksize=3)[v, u] for d in ((1, 0), (0, 1)))
    weight = np.where(known, along_u**2 + along_v**2, 0.0)
    mean = (weight * square).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-12)
    return np.where(np.isfinite(depth_m), np.sqrt(mean), np.nan)


def _off_m(z: FloatArray, A: FloatArray, plane: FloatArray) -> FloatArray:
    """(N, W) how far readings lie behind planes (N, 3) over pixels A (N, W, 3), along z."""
    inverse = np.einsum("nwi,ni->nw", A, plane)
    return np.where(inverse > 0, z - 1 / np.where(inverse > 0, inverse, 1.0), 0.0)
