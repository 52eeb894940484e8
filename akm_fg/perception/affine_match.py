"""Finds image patches again under affine change of shape: Lucas-Kanade, inverse compositional.

Baker and Matthews, "Lucas-Kanade 20 years on" (2004), section 3.2, for N patches at once. A
panel that turns away from the camera foreshortens its texture; a template of the first frame
then still fits after an affine warp, so tracks stay anchored on their first frame instead of
drifting from frame to frame.

Place and shape have a prior (the optical flow's prediction), which makes each match a Gaussian
posterior: where the patch has no texture, the prediction stays and the variance says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import FloatArray

GrayImage = NDArray[np.float32]  # (H, W), smoothed


@dataclass(frozen=True, slots=True)
class AffineMatchConfig:
    """Patches and iterations."""

    radius_px: int = 7  # 15 x 15 pixels: 3 cm at 1.2 m; larger ones straddle more edges
    iterations: int = 8
    smooth_px: float = 0.8  # blur before differentiation: widens the basin, tames sampling noise
    image_sigma: float = 2.0  # gray levels; a camera's noise at moderate light, after the blur
    texel_correlation: float = 6.0  # neighbouring residuals share blur and noise: count a sixth
    shape_sigma: float = 0.05  # how much an affine entry changes in a frame: 3 deg of turn


@dataclass(frozen=True, slots=True)
class Templates:
    """N patches as they look in their anchor frames."""

    patch: NDArray[np.float32]  # (N, P) gray levels, mean removed
    J: NDArray[np.float32]  # (N, P, 6) d gray / d (a11, a12, a21, a22, u, v)
    H: FloatArray  # (N, 6, 6) J^T J

    def put(self, index: NDArray, other: Templates) -> None:
        """Replace the patches with these indices."""
        self.patch[index], self.J[index], self.H[index] = other.patch, other.J, other.H


@dataclass(frozen=True, slots=True)
class Matches:
    """Where N patches were found."""

    uv: FloatArray  # (N, 2)
    shape: FloatArray  # (N, 2, 2) image offset = shape @ template offset
    correlation: FloatArray  # (N,) of the patch with its template, 1 is equal up to gain and bias
    sigma_px: FloatArray  # (N,) posterior standard deviation in the worst direction: along an edge


def smooth(rgb: NDArray[np.uint8], config: AffineMatchConfig) -> GrayImage:
    """Gray image (H, W) ready for matching."""
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.GaussianBlur(gray.astype(np.float32), (0, 0), config.smooth_px))


def _offsets(config: AffineMatchConfig) -> FloatArray:
    """(P, 2) pixels around the centre."""
    r = config.radius_px
    dv, du = np.mgrid[-r : r + 1, -r : r + 1]
    return np.stack([du.ravel(), dv.ravel()], axis=-1).astype(np.float64)


def _sample(image: GrayImage, places: FloatArray) -> NDArray[np.float32]:
    """Bilinear gray levels (N, P) at places (N, P, 2)."""
    maps = places.astype(np.float32)
    values = cv2.remap(
        image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE
    )
    return np.asarray(values, dtype=np.float32)


def cut_templates(image: GrayImage, uv: FloatArray, config: AffineMatchConfig) -> Templates:
    """Take templates around pixels (N, 2)."""
    offsets = _offsets(config)
    places = uv[:, None] + offsets
    patch = _sample(image, places)
    step = np.eye(2)
    gu = (_sample(image, places + step[0]) - _sample(image, places - step[0])) / 2
    gv = (_sample(image, places + step[1]) - _sample(image, places - step[1])) / 2
    x, y = offsets[:, 0], offsets[:, 1]
    J = np.stack([gu * x, gu * y, gv * x, gv * y, gu, gv], axis=-1).astype(np.float32)
    J -= J.mean(axis=1, keepdims=True)  # the patch's mean is free
    H = (J.transpose(0, 2, 1) @ J).astype(np.float64)
    return Templates(patch - patch.mean(axis=1, keepdims=True), J, H)


def match(
    image: GrayImage,
    templates: Templates,
    index: NDArray,
    uv: FloatArray,
    shape: FloatArray,
    prior_sigma_px: FloatArray,
    config: AffineMatchConfig,
) -> Matches:
    """Find the templates with these indices again.

    Args:
        image: where to look.
        templates: all templates.
        index: (N,) those to find.
        uv: (N, 2) predicted pixels.
        shape: (N, 2, 2) predicted shapes.
        prior_sigma_px: (N,) standard deviation of the prediction.
        config: tuning.
    """
    patch, J, H = templates.patch[index], templates.J[index], templates.H[index]
    offsets, spread = _offsets(config), np.maximum(patch.std(axis=1), 1e-6)
    u0, A0 = uv, shape
    weight = 1 / (config.image_sigma**2 * config.texel_correlation)
    precision_u = 1 / prior_sigma_px**2
    precision_a = 1 / config.shape_sigma**2
    correlation = np.zeros(len(index))
    for i in range(config.iterations + 1):
        seen = _sample(image, uv[:, None] + offsets @ shape.transpose(0, 2, 1))
        seen -= seen.mean(axis=1, keepdims=True)
        seen_spread = np.maximum(seen.std(axis=1), 1e-6)
        correlation = (seen * patch).mean(axis=1) / (spread * seen_spread)
        if i == config.iterations:
            break
        error = seen * (spread / seen_spread)[:, None] - patch
        # Prior terms: to first order the warp becomes shape - shape D, uv - shape d.
        AtA = shape.transpose(0, 2, 1) @ shape
        M = weight * H
        M[:, :2, :2] += precision_a * AtA[:, :1, :1] * np.eye(2)
        M[:, 2:4, 2:4] += precision_a * AtA[:, 1:, 1:] * np.eye(2)
        M[:, 4:, 4:] += precision_u[:, None, None] * AtA
        b = weight * (J.transpose(0, 2, 1) @ error[..., None])[..., 0]
        At = shape.transpose(0, 2, 1)
        b[:, :4] += precision_a * (At @ (shape - A0)).reshape(-1, 4)
        b[:, 4:] += precision_u[:, None] * (At @ (uv - u0)[..., None])[..., 0]
        d = np.linalg.solve(M, b[..., None])[..., 0]
        d[:, 4:] = np.clip(d[:, 4:], -2, 2)  # a longer step leaves the linear range
        D = np.clip(d[:, :4], -0.2, 0.2).reshape(-1, 2, 2)
        shape = shape @ np.linalg.inv(np.eye(2) + D)
        uv = uv - (shape @ d[:, 4:, None])[..., 0]
    return Matches(uv, shape, correlation, _posterior_sigma(H, shape, correlation, spread,
                                                           precision_u, config))  # fmt: skip


def _posterior_sigma(
    H: FloatArray,
    shape: FloatArray,
    correlation: FloatArray,
    spread: FloatArray,
    precision_u: FloatArray,
    config: AffineMatchConfig,
) -> FloatArray:
    """Standard deviation (N,) in the worst direction, with the residual that was really left."""
    left = spread**2 * np.clip(1 - correlation**2, 0, 1)
    variance = np.maximum(left, config.image_sigma**2) * config.texel_correlation
    M = H / variance[:, None, None]
    M[:, :4, :4] += np.eye(4) / config.shape_sigma**2
    M[:, 4:, 4:] += precision_u[:, None, None] * np.eye(2)
    cov = np.linalg.inv(M)[:, 4:, 4:]
    cov = shape @ cov @ shape.transpose(0, 2, 1)
    return np.asarray(np.sqrt(np.linalg.eigvalsh(cov)[:, 1]))
