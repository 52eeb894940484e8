"""Dark and shiny surfaces lose most of their depth in patches: what is left tells the rest.

Such a surface shows as islands of readings in what is unknown. A plane of the scene is linear in
inverse depth over the image, so where the islands of a window lie on one plane, and lie around a
pixel and not beside it, that plane gives the pixel's depth. Whole surfaces beside it take no part:
a bright wall behind a dark lid would be continued over the lid.

Depths that are filled in share the errors of their islands. Whoever counts readings has to measure
how many err together (`akm_fg.estimation.given.surface_registration.readings_as_one` does).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import (
    Box,
    DepthPlanesConfig,
    Image,
    bounding_box,
    plane_windows,
)
from akm_fg.perception.depth.thinning import repeated
from akm_fg.records import BoolArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class HolesConfig:
    """What is filled in; widths at 640 pixels."""

    island_px: int = 15  # what is known over a square of this side is a surface, and no island
    around_px: int = (
        21  # of a square that is judged to be lost in patches: three of a stereo camera
    )
    least_islands: float = 0.06  # of such a square
    most_known: float = 0.65  # of it: the rims of whole surfaces lose less
    only_islands: float = 0.8  # of what is known in it
    least_share: float = 0.002  # of the picture in such squares; less is no surface
    stride_px: int = 2  # of the pixels that planes are fitted to
    # Windows, the first whose readings lie on one plane counts: small ones hold one surface only,
    # large ones enough readings. The largest is 8 cm wide at 1.2 m.
    radii_px: tuple[int, ...] = (5, 7, 10)  # of such pixels
    planes: DepthPlanesConfig = field(default_factory=lambda: DepthPlanesConfig(min_share=0.08))
    least_agreeing: float = 0.85  # of a window's readings, on its plane
    most_beside: float = 0.6  # of the radius, from a pixel to the middle of its readings


def without_holes(
    frame: RgbdFrame, noise: DepthNoiseModel, config: HolesConfig | None = None
) -> RgbdFrame:
    """The frame with depth between islands of readings that lie on one plane.

    Args:
        frame: its depth; readings that are there stay as they are.
        noise: of the depth, as far as islands may lie off their plane.
        config: tuning.

    Returns:
        The same frame where it has no surface that is lost in patches.
    """
    config = config or HolesConfig()
    known = np.isfinite(frame.depth_m)
    islands, lost = _lost_in_patches(known, config)
    box = bounding_box(lost, 0)
    if box is None or lost.mean() < config.least_share:
        return frame
    inverse, good = _between(frame, box, islands[box], noise, config)
    good &= lost[box] & ~known[box]
    depth_m = frame.depth_m.copy()
    depth_m[box][good] = 1 / inverse[good]
    return replace(frame, depth_m=depth_m)


def _lost_in_patches(known: BoolArray, config: HolesConfig) -> tuple[BoolArray, BoolArray]:
    """(H, W) readings that belong to no whole surface, and where there are hardly any others."""
    scale = known.shape[1] / 640
    side, around = (max(3, round(w * scale)) | 1 for w in (config.island_px, config.around_px))
    readings = known.astype(np.uint8)
    whole = cv2.morphologyEx(readings, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    islands = known & (whole == 0)
    of_islands = cv2.boxFilter(islands.astype(np.float32), cv2.CV_32F, (around, around))
    of_known = cv2.boxFilter(readings, cv2.CV_32F, (around, around))
    lost = (of_islands > config.least_islands) & (of_known < config.most_known)
    lost &= of_islands > config.only_islands * of_known
    square = np.ones((side, side), np.uint8)  # narrower are the rims of what is masked out
    return islands, np.asarray(cv2.morphologyEx(lost.astype(np.uint8), cv2.MORPH_OPEN, square) > 0)


def _between(
    frame: RgbdFrame, box: Box, islands: BoolArray, noise: DepthNoiseModel, config: HolesConfig
) -> tuple[Image, BoolArray]:
    """Inverse depth (h, w) of the planes that islands lie on, and where these may be believed."""
    camera, step = frame.camera, max(1, round(config.stride_px * frame.camera.width / 640))
    z, on = frame.depth_m[box][::step, ::step], islands[::step, ::step]
    coarse = replace(camera, fx=camera.fx / step, fy=camera.fy / step)
    model = replace(noise, depth_focal_px=noise.depth_focal_px or camera.fx)
    inverse, good = np.zeros(islands.shape, np.float32), np.zeros(islands.shape, dtype=bool)
    v, u = (np.arange(n) % step / np.float32(step) for n in islands.shape)
    for radius_px in config.radii_px:
        planes = replace(config.planes, radius_px=radius_px)
        fit = plane_windows(z, on, coarse, model, planes)
        fits = fit.plane & (fit.count >= config.least_agreeing * fit.readings)
        fits &= fit.beside_px < config.most_beside * radius_px
        a, b, c, new = (
            repeated(image, step, islands.shape)
            for image in (fit.inverse_depth, fit.slope_u, fit.slope_v, fits)
        )
        found = a + b * u.astype(np.float32) + c * v.astype(np.float32)[:, None]
        new = new & ~good & (found > 0)
        inverse[new] = found[new]
        good |= new
    return inverse, good
