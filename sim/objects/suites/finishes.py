"""What a piece of furniture looks like: textures for its front, carcass, handle and window."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from sim.objects.suites.furniture_spec import FurnitureSpec
from sim.objects.textures import (
    SIZE_PX,
    Rgb,
    brushed_metal,
    painted,
    rotated,
    shade,
    smooth_noise,
    wood,
)

TEXTURES = {
    "wood": wood,
    "painted": painted,
    "brushed": brushed_metal,
}


def veneer(rng: np.random.Generator, size: int = SIZE_PX) -> Rgb:
    """Straight fine grain along u, from white oak to walnut."""
    base = np.array([0.78, 0.66, 0.50]) * rng.uniform(0.35, 1.1) + rng.uniform(-0.04, 0.04, 3)
    fibre = smooth_noise(rng, (2.5, 90.0), size)
    bands = smooth_noise(rng, (14.0, 300.0), size)
    pores = np.maximum(smooth_noise(rng, (2.5, 12.0), size) - 1.2, 0.0)
    return shade(base, 0.5 * fibre + 0.6 * bands - pores, 0.16)


def stone(rng: np.random.Generator, size: int = SIZE_PX) -> Rgb:
    """Speckled laminate: grains of two sizes in a ground of any grey or earth colour."""
    base = rng.uniform(0.3, 0.8) * np.array([1.0, 0.97, 0.93]) + rng.uniform(-0.03, 0.03, 3)
    fine = smooth_noise(rng, (3.0, 3.0), size)
    coarse = np.maximum(smooth_noise(rng, (6.0, 6.0), size) - 1.0, 0.0)
    return shade(base, 0.4 * fine + coarse * rng.choice([-1.0, 1.0]), 0.18)


def plain(rng: np.random.Generator, size: int = SIZE_PX) -> Rgb:
    """Even paint: one colour, shaded by one or two grey levels, which is all that it has."""
    hue = rng.uniform(0.75, 1.0, 3) * rng.uniform(0.3, 0.9)
    grey = 255.0 * hue.mean()
    return shade(hue, smooth_noise(rng, (60.0, 60.0), size), 1.0 / grey)


def muted(image: Rgb, contrast: float) -> Rgb:
    """The image with its contrast scaled around its mean colour."""
    mean = image.reshape(-1, 3).mean(axis=0)
    return np.asarray(np.clip(mean + contrast * (image - mean), 0.0, 255.0), dtype=np.uint8)


def textures(spec: FurnitureSpec) -> dict[str, Rgb]:
    """One image for each material, from the spec's key alone."""
    rng = np.random.default_rng([*spec.key, 77])
    draw = {**TEXTURES, "veneer": veneer, "stone": stone, "plain": plain}[spec.finish]
    contrast = 1.0 if spec.plain else rng.uniform(0.4, 1.0)
    front, upright = muted(draw(rng), contrast), rng.random() < 0.5
    same = rng.random() < 0.5  # front and carcass of the same board
    carcass = front if same else muted((plain if spec.plain else draw)(rng), contrast)
    handle = plain(rng) if rng.random() < 0.4 else brushed_metal(rng)
    return {
        "front": rotated(front) if upright else front,
        "carcass": carcass,
        "handle": handle,
        "glass": muted(plain(rng), 0.5) // 3,
    }


def write_textures(spec: FurnitureSpec, folder: Path) -> None:
    """Writes MATERIAL.png for each material."""
    for name, image in textures(spec).items():
        cv2.imwrite(str(folder / f"{name}.png"), image[..., ::-1])
