"""A plane of the object as if seen from straight before it: a picture in metres."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from akm_fg.perception.fronts.front_planes import ObjectCloud, SeenPlane, wide_blind
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

IN_FRONT_M = 0.012  # of the plane: a handle, not what is seen through a gap


@dataclass(frozen=True, slots=True)
class FrontPicture:
    """Rows from below upwards, columns from the left, as the axes of the plane's frame."""

    lower_m: FloatArray  # (2,) the corner of cell (0, 0), in the plane's frame
    cell_m: float
    grey: FloatArray  # (h, w) 0..255
    own: BoolArray  # (h, w) cells whose pixel shows the plane itself
    unknown: BoolArray  # (h, w) cells hidden by what is in front, or wide ones without depth

    @property
    def upper_m(self) -> FloatArray:
        """(2,) the far corner of the last cell."""
        h, w = self.own.shape
        return np.asarray(self.lower_m + self.cell_m * np.array([w, h]))


def front_picture(
    frame: RgbdFrame, plane: SeenPlane, cloud: ObjectCloud, cell_m: float, share: float
) -> FrontPicture | None:
    """The picture of a plane's rectangle.

    Args:
        frame: colours.
        plane: what is pictured.
        cloud: its points.
        cell_m: side of a cell.
        share: of the plane's pixels that may lie outside of the rectangle, on either side.

    Returns:
        None where the rectangle is smaller than a few cells.
    """
    xy = plane.frame.local(cloud.p_world[plane.mask])[:, :2]
    lower, upper = np.quantile(xy, [share, 1.0 - share], axis=0)
    count = np.ceil((upper - lower) / cell_m).astype(int)
    if (count < 4).any():
        return None
    x = lower[0] + cell_m * (np.arange(count[0]) + 0.5)
    y = lower[1] + cell_m * (np.arange(count[1]) + 0.5)
    flat = np.stack([*np.meshgrid(x, y), np.zeros((count[1], count[0]))], axis=-1)
    p_cam = frame.T_world_cam.transformTo(plane.frame.world(flat).reshape(-1, 3).T).T
    uv = np.nan_to_num(frame.camera.project(p_cam), nan=-1.0)
    u, v = (uv[:, i].reshape(count[1], count[0]).astype(np.float32) for i in (0, 1))
    grey = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)
    seen = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    wide = wide_blind(frame.depth_m)
    with np.errstate(invalid="ignore"):
        wide[plane.frame.local(cloud.p_world)[..., 2] > IN_FRONT_M] = 1
    unknown = cv2.remap(wide, u, v, cv2.INTER_NEAREST) > 0
    closed = cv2.morphologyEx(
        plane.mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)
    )
    own = cv2.remap(closed, u, v, cv2.INTER_NEAREST) > 0
    return FrontPicture(lower, cell_m, np.asarray(seen, dtype=float), own, unknown & ~own)
