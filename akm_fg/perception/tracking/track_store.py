"""What was followed, frame by frame: rows of what each shows, dense arrays on demand.

In a long stream points come and go, each seen in a small part of the frames: rows take a fraction
of (T, N) arrays, and grow at their end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from akm_fg.interfaces import SeenPixels
from akm_fg.records import FloatArray, LastingErrors, PixelTracks, PointTracks

Frames: TypeAlias = Sequence[int] | NDArray[np.int_]


@dataclass(frozen=True, slots=True)
class SeenPoints:
    """The followed points that one frame shows, in the image and in space."""

    pixels: SeenPixels  # M
    p_world: FloatArray  # (M, 3) metres; NaN where there is no depth to lift them with
    cov_world: FloatArray  # (M, 3, 3) m^2; NaN likewise
    slip_world: FloatArray | None = None  # (M, 3) metres, either way; see `LastingErrors`
    relief_world: FloatArray | None = None  # (M, 3) metres, likewise


class TrackStore:
    """N points in T frames; both grow."""

    def __init__(self) -> None:
        """Nothing yet."""
        self._rows: list[SeenPoints] = []
        self._points = 0
        self._slips = np.zeros((0, 3))  # (N, 3) the last of each point

    def __len__(self) -> int:
        """T."""
        return len(self._rows)

    def __getitem__(self, frame: int) -> SeenPoints:
        """What one frame shows."""
        return self._rows[frame]

    @property
    def points(self) -> int:
        """N, those that were given up included."""
        return self._points

    def add(self, seen: SeenPoints) -> None:
        """The next frame. A slip goes on as it was: of its two signs the one nearer the last."""
        self._points = max(self._points, int(seen.pixels.index.max(initial=-1)) + 1)
        if seen.slip_world is not None:
            new = np.zeros((self._points - len(self._slips), 3))
            self._slips = np.concatenate([self._slips, new])
            index = seen.pixels.index
            slip = seen.slip_world
            against = (slip * self._slips[index]).sum(axis=1) < 0
            slip = np.where(against[:, None], -slip, slip)
            known = np.nan_to_num(slip).any(axis=1)
            self._slips[index[known]] = slip[known]
            seen = replace(seen, slip_world=slip)
        self._rows.append(seen)

    def pixel_tracks(self, frames: Frames | None = None) -> PixelTracks:
        """All N points in the image, in some of the frames or in all."""
        return pixel_tracks([row.pixels for row in self._chosen(frames)], self._points)

    def point_tracks(self, frames: Frames | None = None) -> PointTracks:
        """All N points in space, in some of the frames or in all."""
        rows = self._chosen(frames)
        p_world = np.full((len(rows), self._points, 3), np.nan)
        cov_world = np.full((*p_world.shape, 3), np.nan)
        lasting = LastingErrors(np.zeros(p_world.shape), np.zeros(p_world.shape))
        for t, row in enumerate(rows):
            at = t, row.pixels.index
            p_world[at], cov_world[at] = row.p_world, row.cov_world
            if row.slip_world is not None:
                lasting.slip_world[at] = row.slip_world
            if row.relief_world is not None:
                lasting.relief_world[at] = row.relief_world
        return PointTracks(p_world, cov_world, lasting)

    def _chosen(self, frames: Frames | None) -> list[SeenPoints]:
        return self._rows if frames is None else [self._rows[t] for t in frames]


def pixel_tracks(rows: Sequence[SeenPixels], points: int) -> PixelTracks:
    """What T frames show, as the tracks of so many points."""
    uv = np.full((len(rows), points, 2), np.nan)
    cov_px2 = np.full((*uv.shape, 2), np.nan)
    visible = np.zeros(uv.shape[:2], dtype=bool)
    for t, row in enumerate(rows):
        at = t, row.index
        visible[at], uv[at], cov_px2[at] = True, row.uv, row.cov_px2
    return PixelTracks(uv, visible, cov_px2)
