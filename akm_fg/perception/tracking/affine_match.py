"""Finds image patches again under affine change of shape: Lucas-Kanade, inverse compositional.

Baker and Matthews, "Lucas-Kanade 20 years on" (2004), section 3.2, for N patches at once. A
panel that turns away from the camera foreshortens its texture; a template of the first frame
then still fits after an affine warp, so tracks stay anchored on their first frame instead of
drifting from frame to frame.

Place and shape have a prior (the optical flow's prediction), which makes each match a Gaussian
posterior: where the patch has no texture, the prediction stays and the variance says so.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.geometry.batches import eigensystems, eigenvalues, inverses, solutions
from akm_fg.records import FloatArray

GrayImage = NDArray[np.float32]  # (H, W), smoothed
_NOISE_ROWS = 4  # every fourth row tells the noise to a percent
_NORMAL_OVER_MEDIAN = 1.4826  # sd over median absolute value of a Gaussian


@dataclass(frozen=True, slots=True)
class AffineMatchConfig:
    """Patches and iterations."""

    radius_px: int = 7  # 15 x 15 pixels: 3 cm at 1.2 m; larger ones straddle more edges
    iterations: int = 8
    rest_px: float = 0.01  # a step that moves no pixel of the patch by more ends the iterations
    smooth_px: float = 0.8  # blur before differentiation: widens the basin, tames sampling noise
    image_sigma: float = 2.0  # gray levels; a camera's noise at moderate light, after the blur
    texel_correlation: float = 3.0  # neighbouring residuals share blur and noise: count a third
    misfit_correlation: float = 30.0  # what is left beyond noise, a second surface, is shared by so
    shape_sigma: float = 0.05  # how much an affine entry changes in a frame: 3 deg of turn
    noise_margin: float = 1.5  # gradients from noise alone, allowed for: their sum scatters by 20 %
    edge_leak: float = 0.04  # of an edge's squared gradient, that shows along it: stairs of pixels


@dataclass(frozen=True, slots=True)
class Templates:
    """N patches as they look in their anchor frames."""

    patch: NDArray[np.float32]  # (N, P) gray levels, mean removed
    J: NDArray[np.float32]  # (N, P, 6) d gray / d (a11, a12, a21, a22, u, v)
    H: FloatArray  # (N, 6, 6) J^T J
    information: FloatArray  # (N, 2, 2) of the place, 1 / px^2, shape unknown; none from noise

    def put(self, index: NDArray, other: Templates) -> None:
        """Replace the patches with these indices."""
        self.patch[index], self.J[index], self.H[index] = other.patch, other.J, other.H
        self.information[index] = other.information

    def joined(self, other: Templates) -> Templates:
        """These patches, and then the others."""
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return Templates(*(np.concatenate(pair) for pair in pairs))

    def select(self, rows: NDArray) -> Templates:
        """Some of the patches."""
        return Templates(*(getattr(self, f.name)[rows] for f in fields(self)))

    def under_noise(self, gradient_noise: float, config: AffineMatchConfig) -> Templates:
        """The patches, cut before the noise of their image's gradient was known."""
        n = self.patch.shape[1]
        return replace(self, information=_place_information(self.H, n, gradient_noise, config))


@dataclass(frozen=True, slots=True)
class Matches:
    """Where N patches were found; NaN for one whose equations are singular."""

    uv: FloatArray  # (N, 2)
    shape: FloatArray  # (N, 2, 2) image offset = shape @ template offset
    correlation: FloatArray  # (N,) of the patch with its template, 1 is equal up to gain and bias
    cov_px2: FloatArray  # (N, 2, 2) posterior; that of the prediction along an edge


def smooth(rgb: NDArray[np.uint8], config: AffineMatchConfig) -> GrayImage:
    """Gray image (H, W) ready for matching."""
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.GaussianBlur(gray.astype(np.float32), (0, 0), config.smooth_px))


def _offsets(config: AffineMatchConfig) -> FloatArray:
    """(P, 2) pixels around the centre."""
    r = config.radius_px
    dv, du = np.mgrid[-r : r + 1, -r : r + 1]
    return np.stack([du.ravel(), dv.ravel()], axis=-1).astype(np.float64)


def _sample(
    image: GrayImage, uv: FloatArray, offsets: FloatArray, shape: FloatArray | None = None
) -> NDArray[np.float32]:
    """Bilinear gray levels (N, P) at offsets (P, 2) from pixels (N, 2), in these shapes."""
    x, y = offsets.T.astype(np.float32)
    u, v = uv.T.astype(np.float32)[..., None]
    if shape is None:
        u, v = u + x, v + y
    else:
        a = shape.astype(np.float32)[..., None]
        u = u + a[:, 0, 0] * x + a[:, 0, 1] * y
        v = v + a[:, 1, 0] * x + a[:, 1, 1] * y
    values = cv2.remap(image, u, v, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    return np.asarray(values, dtype=np.float32)


def _standing(
    image: GrayImage, uv: FloatArray, shape: FloatArray, offsets: FloatArray
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Gray levels (N, P) of patches at their places, mean removed, and their spread (N,)."""
    seen = _sample(image, uv, offsets, shape)
    seen -= seen.mean(axis=1, keepdims=True)
    return seen, np.maximum(seen.std(axis=1), 1e-6)


def gradient_noise(a: GrayImage, b: GrayImage) -> float:
    """Standard deviation of the gray gradient by the camera's noise alone, gray levels a pixel.

    From two smoothed images (H, W) that mostly show the same: the median forgets what moved.
    """
    change = a[::_NOISE_ROWS] - b[::_NOISE_ROWS]
    difference = np.abs(change[:, 2:] - change[:, :-2]) / 2
    return float(np.median(difference)) * _NORMAL_OVER_MEDIAN / np.sqrt(2.0)


def cut_templates(
    image: GrayImage, uv: FloatArray, config: AffineMatchConfig, gradient_noise: float = 0.0
) -> Templates:
    """Take templates around pixels (N, 2).

    Args:
        image: where they are.
        uv: their centres.
        config: tuning.
        gradient_noise: see the function of this name.
    """
    offsets = _offsets(config)
    patch = _sample(image, uv, offsets)
    gu, gv = (
        (_sample(image, uv, offsets + step) - _sample(image, uv, offsets - step)) / 2
        for step in np.eye(2)
    )
    x, y = offsets[:, 0], offsets[:, 1]
    J = np.stack([gu * x, gu * y, gv * x, gv * y, gu, gv], axis=-1).astype(np.float32)
    J -= J.mean(axis=1, keepdims=True)  # the patch's mean is free
    H = (J.transpose(0, 2, 1) @ J).astype(np.float64)
    information = _place_information(H, len(offsets), gradient_noise, config)
    return Templates(patch - patch.mean(axis=1, keepdims=True), J, H, information)


def _place_information(
    H: FloatArray, pixels: int, gradient_noise: float, config: AffineMatchConfig
) -> FloatArray:
    """Information (N, 2, 2) on the place at the assumed image noise, the shape marginalised.

    Noise has gradients too, in all directions, and the stairs of pixels on a slanted straight edge
    have some along it, which stay behind when the edge slides on. What they add to J^T J on
    average says nothing of the place and is taken off.
    """
    steepest = eigenvalues(H[:, 4:, 4:])[:, 1] / pixels
    false = config.noise_margin * gradient_noise**2 + config.edge_leak * steepest
    weight = 1 / (config.image_sigma**2 * config.texel_correlation)
    shape = weight * H[:, :4, :4] + np.eye(4) / config.shape_sigma**2
    across = weight * H[:, :4, 4:]
    known = weight * H[:, 4:, 4:] - across.transpose(0, 2, 1) @ solutions(shape, across)
    return _semidefinite(known - (weight * pixels * false)[:, None, None] * np.eye(2))


def _semidefinite(M: FloatArray) -> FloatArray:
    """Symmetric matrices (N, n, n) without their negative eigenvalues."""
    w, V = eigensystems(M)
    return np.asarray((V * np.maximum(w, 0.0)[:, None, :]) @ V.transpose(0, 2, 1))


def no_more_than(information: FloatArray, limit: FloatArray) -> FloatArray:
    """Information (N, n, n), in no direction more than another one: the smaller where they vie."""
    w, V = eigensystems(information)
    w = np.maximum(w, 1e-9 * w[:, -1:] + 1e-12)
    Vt = V.transpose(0, 2, 1)
    root, inverse = (V * w[:, None] ** 0.5) @ Vt, (V * w[:, None] ** -0.5) @ Vt
    share, U = eigensystems(inverse @ limit @ inverse)
    held = (U * np.clip(share, 0.0, 1.0)[:, None]) @ U.transpose(0, 2, 1)
    return np.asarray(root @ held @ root)


def place_information(templates: Templates, index: NDArray, shape: FloatArray) -> FloatArray:
    """Information (N, 2, 2) of templates on their place when seen in these shapes (N, 2, 2)."""
    back = inverses(shape)
    return np.asarray(back.transpose(0, 2, 1) @ templates.information[index] @ back)


def match(
    image: GrayImage,
    templates: Templates,
    index: NDArray,
    uv: FloatArray,
    shape: FloatArray,
    prior_cov_px2: FloatArray,
    config: AffineMatchConfig,
) -> Matches:
    """Find the templates with these indices again.

    Args:
        image: where to look.
        templates: all templates.
        index: (N,) those to find.
        uv: (N, 2) predicted pixels.
        shape: (N, 2, 2) predicted shapes.
        prior_cov_px2: (N, 2, 2) covariance of the prediction.
        config: tuning.
    """
    patch, J, H = templates.patch[index], templates.J[index], templates.H[index]
    offsets, spread = _offsets(config), np.maximum(patch.std(axis=1), 1e-6)
    weight = 1 / (config.image_sigma**2 * config.texel_correlation)
    precision_u = inverses(prior_cov_px2)
    precision_a = 1 / config.shape_sigma**2
    uv, shape = uv.copy(), shape.copy()
    u0, A0 = uv.copy(), shape.copy()
    going = np.arange(len(index))  # those that have not come to rest
    for _ in range(config.iterations):
        if not going.size:
            break
        A = shape[going]
        seen, seen_spread = _standing(image, uv[going], A, offsets)
        error = seen * (spread[going] / seen_spread)[:, None] - patch[going]
        # Prior terms: to first order the warp becomes shape - shape D, uv - shape d.
        At = A.transpose(0, 2, 1)
        AtA, held = At @ A, At @ precision_u[going]
        M = weight * H[going]
        M[:, :2, :2] += precision_a * AtA[:, :1, :1] * np.eye(2)
        M[:, 2:4, 2:4] += precision_a * AtA[:, 1:, 1:] * np.eye(2)
        M[:, 4:, 4:] += held @ A
        b = weight * (J[going].transpose(0, 2, 1) @ error[..., None])[..., 0]
        b[:, :4] += precision_a * (At @ (A - A0[going])).reshape(-1, 4)
        b[:, 4:] += (held @ (uv[going] - u0[going])[..., None])[..., 0]
        d = solutions(M, b[..., None])[..., 0]
        d[:, 4:] = np.clip(d[:, 4:], -2, 2)  # a longer step leaves the linear range
        D = np.clip(d[:, :4], -0.2, 0.2).reshape(-1, 2, 2)
        shape[going] = A = A @ inverses(np.eye(2) + D)
        uv[going] -= (A @ d[:, 4:, None])[..., 0]
        step_px = np.abs(d) * ([config.radius_px] * 4 + [1, 1])
        going = going[step_px.max(axis=1) > config.rest_px]
    seen, seen_spread = _standing(image, uv, shape, offsets)
    correlation = (seen * patch).mean(axis=1) / (spread * seen_spread)
    left = spread**2 * np.clip(1 - correlation**2, 0, 1) / config.image_sigma**2
    misfit = 1 + config.misfit_correlation / config.texel_correlation * np.maximum(left - 1, 0)
    seen_well = place_information(templates, index, shape) / misfit[:, None, None]
    return Matches(uv, shape, correlation, inverses(seen_well + precision_u))
