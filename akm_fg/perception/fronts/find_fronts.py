"""One view's fronts and what sticks out of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.fronts.front_picture import front_picture
from akm_fg.perception.fronts.front_planes import (
    FrontPlanesConfig,
    ObjectCloud,
    SeenPlane,
    object_cloud,
    seen_planes,
)
from akm_fg.perception.fronts.front_records import PARALLEL, Front, Fronts
from akm_fg.perception.fronts.gaps import GapConfig, Rectangle, rectangles
from akm_fg.perception.fronts.protrusions import ProtrusionConfig, protrusions
from akm_fg.records import BoolArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class FrontsConfig:
    """How fronts are found."""

    noise: DepthNoiseModel = field(default_factory=DepthNoiseModel)
    planes: FrontPlanesConfig = field(default_factory=FrontPlanesConfig)
    gaps: GapConfig = field(default_factory=GapConfig)
    protrusions: ProtrusionConfig = field(default_factory=ProtrusionConfig)
    stray: float = 0.005  # of a plane's pixels on either side of its rectangle
    facade_m: float = 0.06  # parallel planes closer than this are of one facade
    notch_m: float = 0.08  # so wide ones in the mask are closed: handles may be missing in it
    covered: float = 0.5  # of a rectangle behind others: it is their carcass


def find_fronts(frame: RgbdFrame, mask: BoolArray, config: FrontsConfig | None = None) -> Fronts:
    """The fronts of the object in one view, and what sticks out of them; none is a result too.

    Args:
        frame: the robot's own pixels carry no depth.
        mask: (H, W) the object.
        config: tuning.

    Raises:
        ValueError: the mask has another size than the image.
    """
    config = config or FrontsConfig()
    cloud = object_cloud(frame, mask, config.noise)
    fronts: list[Front] = []
    taken = np.zeros(mask.shape, dtype=bool)
    for plane in seen_planes(frame, mask, cloud, config.noise, config.planes):
        own = _fronts_of(frame, plane, cloud, config)
        fronts.extend(own)
        if own:  # else it is a narrow strip: a ledge, or the flank of something
            taken |= plane.mask
    fronts = [front for front in fronts if not _behind_others(front, fronts, config)]
    closed = _closed(mask, cloud, config.notch_m)
    everything = object_cloud(frame, np.ones_like(mask), config.noise)
    return Fronts(tuple(fronts), protrusions(everything, fronts, closed, taken, config.protrusions))


def _closed(mask: BoolArray, cloud: ObjectCloud, width_m: float) -> BoolArray:
    """The mask without notches: segmenters lose thin handles, and what is beside them."""
    if not cloud.known.any():
        return mask
    pixel_m = float(np.sqrt(np.nanmedian(cloud.area_m2)))
    side = min(2 * round(width_m / pixel_m / 2.0) + 1, 2 * (min(mask.shape) // 4) + 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0)


def _behind_others(front: Front, others: Sequence[Front], config: FrontsConfig) -> bool:
    """Whether most of a rectangle lies behind others, as a carcass does behind its doors."""
    grid = np.stack(np.meshgrid(*(np.linspace(0.0, 1.0, 12),) * 2), axis=-1).reshape(-1, 2)
    xy = front.lower_m + grid * front.extent_m
    p_world = front.frame.world(np.column_stack([xy, np.zeros(len(xy))]))
    covered = np.zeros(len(xy), dtype=bool)
    for other in others:
        if other is not front and other.normal_world @ front.normal_world > PARALLEL:
            local = other.frame.local(p_world)
            behind = (local[:, 2] < 0.0) & (local[:, 2] > -config.facade_m)
            covered |= behind & other.holds(local[:, :2], 0.0)
    return bool(covered.mean() > config.covered)


def _fronts_of(
    frame: RgbdFrame, plane: SeenPlane, cloud: ObjectCloud, config: FrontsConfig
) -> list[Front]:
    """The rectangles of one plane."""
    picture = front_picture(frame, plane, cloud, config.gaps.cell_m, config.stray)
    if picture is None:
        return []
    xy = plane.frame.local(cloud.p_world)[..., :2]
    return [
        Front(plane.frame, piece.lower_m, piece.upper_m, plane.mask & _within(xy, piece))
        for piece in rectangles(picture, config.gaps)
    ]


def _within(xy: np.ndarray, piece: Rectangle) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray(((xy >= piece.lower_m) & (xy <= piece.upper_m)).all(axis=-1))
