"""Planes of frames that are looked at again and again while a stream goes on."""

from __future__ import annotations

import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import (
    Box,
    DepthPlanes,
    DepthPlanesConfig,
    bounding_box,
    depth_planes,
)
from akm_fg.records import BoolArray, RgbdFrame

MOST = 24  # frames, 4 MB each of VGA size: those of one registration and a few more
GROWS_PX = 24  # around what is asked for: the next time it will be a little more


class RememberedPlanes:
    """Fits planes to a box of a frame, once as long as the box holds what is asked for.

    Args:
        most: frames that are remembered; the one that was not asked for longest goes.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        # By the frame's identity; it is held, so that no other takes its place.
        self._known: dict[int, tuple[RgbdFrame, object, Box, DepthPlanes]] = {}

    def of(
        self,
        frame: RgbdFrame,
        noise: DepthNoiseModel,
        around: BoolArray,
        config: DepthPlanesConfig,
    ) -> DepthPlanes:
        """Planes of a frame, at least where it is asked for.

        Args:
            frame: its depth.
            noise: of single readings.
            around: (H, W) where planes are needed.
            config: of the fits.
        """
        asked = bounding_box(around, 0)
        settings = noise, config
        known = self._known.pop(id(frame), None)
        if known is None or known[1] != settings or not _within(asked, known[2]):
            known = frame, settings, *_fitted(frame, noise, around, config)
        self._known[id(frame)] = known
        if len(self._known) > self._most:
            del self._known[next(iter(self._known))]
        return known[3]


def _fitted(
    frame: RgbdFrame, noise: DepthNoiseModel, around: BoolArray, config: DepthPlanesConfig
) -> tuple[Box, DepthPlanes]:
    """The box that was fitted, and its planes."""
    box = bounding_box(around, GROWS_PX) or np.s_[0:0, 0:0]
    mask = np.zeros_like(around)
    mask[box] = True
    return box, depth_planes(frame, noise, mask, config)


def _within(box: Box | None, other: Box) -> bool:
    """Whether a box (None: empty) lies in another."""
    return box is None or all(
        outer.start <= inner.start and inner.stop <= outer.stop
        for inner, outer in zip(box, other, strict=True)
    )
