"""The object in a later frame: where it was in the first, and what stands out before that now.

A part that opens covers what was beside the object with something nearer
and joined to it; what it uncovers is the object's inside. So the object is searched for once, in
the first frame; where the camera has moved since, that frame is carried over to where it is now.
The robot's pixels carry no depth and are never part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.other_view import same_view, seen_from
from akm_fg.records import BoolArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class ObjectNowConfig:
    """What counts as standing out."""

    sigmas: float = 4.0  # of the difference of two readings
    least_m: float = 0.02  # on top: what has moved less lies on the object as it was
    open_px: int = 5  # narrower changes are edges that flicker, at 640 pixels


def object_now(
    first: RgbdFrame,
    first_mask: BoolArray,
    frame: RgbdFrame,
    noise: DepthNoiseModel,
    config: ObjectNowConfig | None = None,
) -> BoolArray:
    """(H, W), True on the object in `frame`.

    Args:
        first: an earlier frame of the same camera, wherever it stood.
        first_mask: (H, W) the object in it.
        frame: the frame in question.
        noise: of the depth.
        config: tuning.
    """
    config = config or ObjectNowConfig()
    if not same_view(first, frame):
        before = seen_from(first, frame.T_world_cam)
        first, first_mask = before.frame, before.carried(first_mask)
    sigma = np.sqrt(2.0) * noise.sigma_m(first.depth_m.astype(np.float64), first.camera.fx)
    with np.errstate(invalid="ignore"):
        out = first.depth_m - frame.depth_m > config.sigmas * sigma + config.least_m  # NaN: False
    width = max(3, round(config.open_px * out.shape[1] / 640)) | 1
    kernel = np.ones((width, width), np.uint8)
    opened = cv2.morphologyEx((out & ~first_mask).astype(np.uint8), cv2.MORPH_OPEN, kernel)
    whole = np.asarray(opened > 0) | first_mask
    _, labels = cv2.connectedComponents(whole.astype(np.uint8), connectivity=4)
    joined = np.zeros(int(labels.max()) + 1, dtype=bool)
    joined[np.unique(labels[first_mask])] = True
    return np.asarray(joined[labels] & whole)
