"""Where the arm stands when it should hide little of what a camera looks at."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.arm.body.silhouette import ArmSilhouette
from akm_fg.records import BoolArray, FloatArray, PinholeCamera, RgbdFrame


@dataclass(frozen=True, slots=True)
class AsideConfig:
    """The places that are considered, and how finely the picture is looked at."""

    turns_deg: tuple[float, ...] = (0.0, -30.0, 30.0, -60.0, 60.0, -90.0, 90.0)  # of the first axis
    drawn_back_rad: tuple[float, ...] = (
        0.0,
        -0.5,
        -0.9,
    )  # of the second: the arm drawn back from home
    tried: int = 4  # best places for which a way is looked for
    scale: int = 8  # the image is looked at this many times smaller
    reach_m: float = 1.3  # from the base: what a handle may be within, and the front around it
    # Beside something near a stereo camera sees nothing: f b (1/z - 1/z') pixels, 11 of a D455 at
    # 848 x 480 between 1.2 and 1.8 m; on which side hangs on the camera.
    shadow_px: float = 16.0
    floor_m: float = 0.06  # above the lowest that is seen: of no interest
    # Of the image: a place that hides so little more than the best is as good, and the one that is
    # nearer to where the arm stands is taken.
    as_good: float = 0.002


def aside(
    silhouette: ArmSilhouette,
    frame: RgbdFrame,
    q: FloatArray,
    config: AsideConfig,
    unseen: bool = False,
) -> list[FloatArray]:
    """Joint angles (7,) at which the arm hides least of what is within its reach, best first.

    Args:
        silhouette: of the arm.
        frame: of the camera that looks; the robot's own pixels carry no depth, and may hide
            anything.
        q: (7,) where the arm stands now; among equals the nearest comes first.
        config: what is considered.
        unseen: what this frame does not show counts, and nothing else.
    """
    small, wanted = _smaller(frame.camera, config.scale), _within_reach(frame, config)
    if unseen:
        wanted = _unseen(frame, config)
    shadow = np.ones((1, 2 * round(config.shadow_px / config.scale) + 1), np.uint8)
    places, hidden = [], []
    for back_rad in config.drawn_back_rad:
        for turn_deg in config.turns_deg:
            place = Q_HOME.copy()
            place[0] += np.deg2rad(turn_deg)
            place[1] += back_rad
            places.append(place)
            mask = silhouette.mask(place, 0.04, small, frame.T_world_cam)
            mask = cv2.dilate(mask.astype(np.uint8), shadow) > 0
            hidden.append(float((mask & wanted).mean()))
    best = min(hidden)
    # Hidden shares within `as_good` of each other count as one step.
    steps = np.floor((np.array(hidden) - best) / config.as_good)
    way = np.array([np.linalg.norm(place - q) for place in places])
    return [places[i] for i in np.lexsort([way, steps])]


def _unseen(frame: RgbdFrame, config: AsideConfig) -> BoolArray:
    """(h, w) of the smaller image: without depth."""
    camera, step = frame.camera, config.scale
    rows, columns = camera.height // step, camera.width // step
    depth = frame.depth_m[: rows * step : step, : columns * step : step]
    return np.asarray(~np.isfinite(depth))


def _within_reach(frame: RgbdFrame, config: AsideConfig) -> BoolArray:
    """(h, w) of the smaller image: where something stands within reach, or may be hidden."""
    camera, step = frame.camera, config.scale
    v, u = np.mgrid[: camera.height : step, : camera.width : step]
    v, u = v[: camera.height // step, : camera.width // step], u[: camera.height // step]
    u = u[:, : camera.width // step]
    depth = frame.depth_m[v, u].astype(float)
    p_cam = camera.back_project(np.stack([u, v], axis=-1).astype(float), depth)
    p = p_cam @ frame.T_world_cam.rotation().matrix().T + frame.T_world_cam.translation()
    near = np.hypot(p[..., 0], p[..., 1]) < config.reach_m
    lowest = np.nanpercentile(p[..., 2], 1.0) if np.isfinite(p).any() else 0.0
    return np.asarray(~np.isfinite(depth) | (near & (p[..., 2] > lowest + config.floor_m)))


def _smaller(camera: PinholeCamera, scale: int) -> PinholeCamera:
    """The same view with fewer pixels; their centres stay at integers."""
    size = max(camera.width // scale, 1), max(camera.height // scale, 1)
    return PinholeCamera(
        *size,
        camera.fx / scale,
        camera.fy / scale,
        (camera.cx + 0.5) / scale - 0.5,
        (camera.cy + 0.5) / scale - 0.5,
    )
