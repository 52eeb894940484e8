"""Planes of frames that are looked at again and again while a stream goes on."""

from __future__ import annotations

from collections.abc import Sequence

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

MOST = 28  # frames, 4 MB each of VGA size: those of one registration and a few more
_Settings = tuple[DepthNoiseModel, DepthPlanesConfig]
GROWS_PX = 24  # around what is asked for: the next time it will be a little more

AHEAD_PX = 48  # likewise, of a frame that comes before it is asked for


class RememberedPlanes:
    """Fits planes to a box of a frame, once as long as the box holds what is asked for.

    Args:
        most: frames that are remembered; the one that was not asked for longest goes.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        # By the frame's identity; it is held, so that no other takes its place.
        self._known: dict[int, tuple[RgbdFrame, _Settings, Box, DepthPlanes]] = {}
        self._last: tuple[BoolArray, _Settings] | None = None  # what was asked for last, and how

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
        self._last = around, settings
        known = self._known.pop(id(frame), None)
        if known is None or known[1] != settings or not _within(asked, known[2]):
            known = frame, settings, *_fitted(frame, noise, around, config, GROWS_PX)
        self._remember(known)
        return known[3]

    def prepare(self, kept: Sequence[RgbdFrame]) -> None:
        """Fit planes to the newest of the frames that may be asked for, where the last ones were.

        What is no longer among them is forgotten. What moved on since may need a little more: see
        `AHEAD_PX`.
        """
        there, newest = {id(frame) for frame in kept}, kept[-1]
        self._known = {key: known for key, known in self._known.items() if key in there}
        if self._last is not None and id(newest) not in self._known:
            around, (noise, config) = self._last
            fitted = _fitted(newest, noise, around, config, AHEAD_PX)
            self._remember((newest, (noise, config), *fitted))

    def _remember(self, known: tuple[RgbdFrame, _Settings, Box, DepthPlanes]) -> None:
        self._known[id(known[0])] = known
        if len(self._known) > self._most:
            del self._known[next(iter(self._known))]


def _fitted(
    frame: RgbdFrame,
    noise: DepthNoiseModel,
    around: BoolArray,
    config: DepthPlanesConfig,
    margin_px: int,
) -> tuple[Box, DepthPlanes]:
    """The box that was fitted, and its planes."""
    box = bounding_box(around, margin_px) or np.s_[0:0, 0:0]
    mask = np.zeros_like(around)
    mask[box] = True
    return box, depth_planes(frame, noise, mask, config)


def _within(box: Box | None, other: Box) -> bool:
    """Whether a box (None: empty) lies in another."""
    return box is None or all(
        outer.start <= inner.start and inner.stop <= outer.stop
        for inner, outer in zip(box, other, strict=True)
    )
