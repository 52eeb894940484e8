"""Where the arm stands when it should hide little of what a camera looks at."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.arm.body.silhouette import ArmSilhouette
from akm_fg.records import FloatArray, PinholeCamera


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
    # Of the image: a place that hides so little more than the best is as good, and the one that is
    # nearer to where the arm stands is taken.
    as_good: float = 0.005


def aside(
    silhouette: ArmSilhouette,
    camera: PinholeCamera,
    T_world_cam: gtsam.Pose3,
    q: FloatArray,
    config: AsideConfig,
) -> list[FloatArray]:
    """Joint angles (7,) at which the arm hides least of the picture, best first.

    Args:
        silhouette: of the arm.
        camera: that looks.
        T_world_cam: from where.
        q: (7,) where the arm stands now; among equals the nearest comes first.
        config: what is considered.
    """
    small = _smaller(camera, config.scale)
    places, hidden = [], []
    for back_rad in config.drawn_back_rad:
        for turn_deg in config.turns_deg:
            place = Q_HOME.copy()
            place[0] += np.deg2rad(turn_deg)
            place[1] += back_rad
            places.append(place)
            hidden.append(float(silhouette.mask(place, 0.04, small, T_world_cam).mean()))
    best = min(hidden)
    # Hidden shares within `as_good` of each other count as one step.
    steps = np.floor((np.array(hidden) - best) / config.as_good)
    way = np.array([np.linalg.norm(place - q) for place in places])
    return [places[i] for i in np.lexsort([way, steps])]


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
