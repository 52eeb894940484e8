"""Procedural textures: wood, painted board, brushed metal, plaster, floor.

All are band-limited (nothing finer than about 2 mm at the scale they are used), because the
software renderer picks the nearest texel and would flicker otherwise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from akm_fg.records import FloatArray

Rgb = NDArray[np.uint8]  # (S, S, 3)

SIZE_PX = 1024  # side of a square texture
TILE_M = 0.8  # side of the square it covers; larger than any front, so that nothing repeats


def smooth_noise(rng: np.random.Generator, sigma_px: tuple[float, float], size: int) -> FloatArray:
    """Unit-variance noise (size, size), smoothed along v and u, that wraps at the borders."""
    spectrum = fft.rfft2(rng.standard_normal((size, size), dtype=np.float32))
    fv = 2.0 * np.pi * fft.fftfreq(size)[:, None] * sigma_px[0]
    fu = 2.0 * np.pi * fft.rfftfreq(size)[None, :] * sigma_px[1]
    spectrum *= np.exp(-0.5 * fv**2).astype(np.float32)
    spectrum *= np.exp(-0.5 * fu**2).astype(np.float32)
    spectrum[0, 0] = 0.0
    field = fft.irfft2(spectrum, s=(size, size))
    return np.asarray(field / field.std())


def shade(base: FloatArray, value: FloatArray, gain: float) -> Rgb:
    """Base colour (3,) in 0..1, scaled by 1 + gain * value (size, size)."""
    image = base * (1.0 + gain * value)[..., None]
    return np.asarray(np.clip(image, 0.02, 1.0) * 255.0, dtype=np.uint8)


def wood(rng: np.random.Generator, size: int = SIZE_PX) -> Rgb:
    """Boards with wavy grain along u and pores."""
    base = np.array([0.66, 0.46, 0.28]) * rng.uniform(0.75, 1.25) + rng.uniform(-0.05, 0.05, 3)
    v = np.mgrid[0:size, 0:size][0] / size
    warp = smooth_noise(rng, (40.0, 160.0), size)
    rings = np.sin(2.0 * np.pi * (rng.integers(8, 14) * v + 0.5 * warp))
    fibre = smooth_noise(rng, (2.5, 30.0), size)
    pores = smooth_noise(rng, (3.0, 7.0), size)
    blotch = smooth_noise(rng, (60.0, 60.0), size)
    knots = _knots(rng, size)
    return shade(base, 0.35 * rings + 0.35 * fibre + 0.35 * pores + 0.3 * blotch - knots, 0.38)


def _knots(rng: np.random.Generator, size: int, count: int = 9) -> FloatArray:
    """Dark elliptic knots, 0..2."""
    at = np.arange(size, dtype=float)
    field = np.zeros((size, size))
    for _ in range(count):
        cu, cv, r = rng.uniform(0, size), rng.uniform(0, size), rng.uniform(6.0, 14.0)
        du = np.remainder(at - cu + size / 2, size) - size / 2
        dv = np.remainder(at - cv + size / 2, size) - size / 2
        field += 2.0 * np.outer(np.exp(-((dv / r) ** 2)), np.exp(-((du / (2.2 * r)) ** 2)))
    return field


def painted(rng: np.random.Generator, size: int = SIZE_PX) -> Rgb:
    """Matt paint with speckle of two sizes and a few scuffs."""
    hues = [[0.75, 0.72, 0.66], [0.42, 0.52, 0.60], [0.50, 0.58, 0.47], [0.66, 0.48, 0.42]]
    base = np.array(hues[int(rng.integers(len(hues)))]) * rng.uniform(0.85, 1.1)
    fine = smooth_noise(rng, (3.5, 3.5), size)
    coarse = smooth_noise(rng, (11.0, 11.0), size)
    spots = np.maximum(smooth_noise(rng, (6.0, 6.0), size) - 1.6, 0.0) * rng.choice([-2.5, 1.5])
    scuffs = np.maximum(smooth_noise(rng, (4.0, 40.0), size) - 1.8, 0.0)
    value = 0.45 * fine + 0.4 * coarse + spots - scuffs
    return shade(base, value, 0.2)


def brushed_metal(rng: np.random.Generator, size: int = SIZE_PX) -> Rgb:
    """Grey metal brushed along u."""
    base = np.full(3, rng.uniform(0.45, 0.65)) + np.array([0.0, 0.0, 0.015])
    value = 0.8 * smooth_noise(rng, (2.5, 60.0), size) + 0.6 * smooth_noise(rng, (15.0, 15.0), size)
    return shade(base, value, 0.16)


def plaster(rng: np.random.Generator, size: int = SIZE_PX) -> Rgb:
    """A wall: faint mottling."""
    base = np.array([0.82, 0.81, 0.77]) * rng.uniform(0.9, 1.05)
    value = 0.6 * smooth_noise(rng, (25.0, 25.0), size) + 0.6 * smooth_noise(rng, (5.0, 5.0), size)
    return shade(base, value, 0.05)


def floor(rng: np.random.Generator, size: int = SIZE_PX) -> Rgb:
    """Terrazzo: chips in a grey ground."""
    base = np.array([0.50, 0.49, 0.47]) * rng.uniform(0.9, 1.1)
    chips = np.maximum(smooth_noise(rng, (5.0, 5.0), size) - 1.0, 0.0)
    dark = np.maximum(smooth_noise(rng, (7.0, 7.0), size) - 1.2, 0.0)
    return shade(base, 0.3 * smooth_noise(rng, (30.0, 30.0), size) + 1.2 * chips - dark, 0.16)


def rotated(image: Rgb) -> Rgb:
    """The same texture with its grain along v."""
    return np.ascontiguousarray(np.rot90(image))


FRONT_TEXTURES: dict[str, Callable[[np.random.Generator], Rgb]] = {
    "wood": wood,
    "painted": painted,
}
