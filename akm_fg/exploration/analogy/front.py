"""The front that a contact is on: its axes, from the depth around it.

Columns of R_world_front: across (level, along z_world x out), up, and out of the front. Of a front
that looks up, which has no level direction of its own, across is the world's y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import depth_planes
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

LEVEL = 0.1  # sine of the angle between `out` and the vertical below which a front looks up


@dataclass(frozen=True, slots=True)
class FrontConfig:
    """Which of the surface around a contact is its front."""

    radius_m: float = 0.12  # around the contact: a handle is smaller, most fronts are larger
    places: int = 200  # looked at: enough for a direction
    alike_rad: float = float(np.deg2rad(12.0))  # between normals of one face, with depth noise
    fewest: int = 8  # places that must agree


def front_axes(out_world: FloatArray) -> FloatArray:
    """R_world_front (3, 3) of a front with this outward normal (3,)."""
    out = out_world / np.linalg.norm(out_world)
    across = np.cross([0.0, 0.0, 1.0], out)
    length = float(np.linalg.norm(across))
    across = across / length if length > LEVEL else np.array([0.0, 1.0, 0.0])
    across -= (across @ out) * out
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(out, across), out])


def front_normal(
    frame: RgbdFrame,
    mask: BoolArray,
    uv: FloatArray,
    noise: DepthNoiseModel | None = None,
    config: FrontConfig | None = None,
) -> FloatArray | None:
    """The normal (3,), unit, world, towards the camera, of the face that a contact is on.

    The face is the direction in which most of the surface within reach of the contact looks; a
    handle in front of it is small. None where the depth shows no face.

    Args:
        frame: its depth.
        mask: (H, W), True on the object.
        uv: (2,) the contact's pixel.
        noise: of a depth reading.
        config: tuning.
    """
    config = config or FrontConfig()
    depth_m = _depth_near(frame, mask, uv)
    if depth_m is None:
        return None
    reach_px = config.radius_m * frame.camera.fx / depth_m
    v, u = np.mgrid[: frame.camera.height, : frame.camera.width]
    near = mask & (np.hypot(u - uv[0], v - uv[1]) < reach_px)
    planes = depth_planes(frame, noise or DepthNoiseModel(), near)
    rows, columns = np.nonzero(near & planes.valid)
    if len(rows) < config.fewest:
        return None
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), config.places)).astype(int)
    normals = planes.at(np.column_stack([columns, rows])[chosen].astype(float)).normal_world
    normals = normals[np.isfinite(normals).all(axis=1)]
    alike = normals @ normals.T > np.cos(config.alike_rad)
    if alike.sum(axis=1).max(initial=0) < config.fewest:
        return None
    mean = normals[alike[alike.sum(axis=1).argmax()]].mean(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _depth_near(frame: RgbdFrame, mask: BoolArray, uv: FloatArray) -> float | None:
    """Of the known depth on the object, that at the nearest pixel."""
    rows, columns = np.nonzero(mask & np.isfinite(frame.depth_m))
    if not rows.size:
        return None
    nearest = np.hypot(columns - uv[0], rows - uv[1]).argmin()
    return float(frame.depth_m[rows[nearest], columns[nearest]])
