"""The state of points that are being followed, and the tracks it leaves behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.tracking.affine_match import AffineMatchConfig, Templates, empty_templates
from akm_fg.records import BoolArray, FloatArray, PixelTracks


@dataclass(slots=True)
class TrackedPoints:
    """All points at the current frame; rows are points."""

    uv: FloatArray  # (N, 2)
    shape: FloatArray  # (N, 2, 2) relative to the anchor
    cov: FloatArray  # (N, 2, 2) of uv relative to the anchor, px^2
    anchor_cov: FloatArray  # (N, 2, 2) of the anchor relative to the query, px^2
    depth_m: FloatArray  # (N,) when last seen
    alive: BoolArray  # (N,) seen in the last frame
    begun: BoolArray  # (N,) its query frame has come
    missed: NDArray[np.int_]  # (N,) frames since it was last seen; too many: given up
    templates: Templates

    @staticmethod
    def empty(n: int, config: AffineMatchConfig) -> TrackedPoints:
        """Points that have not begun."""
        return TrackedPoints(
            uv=np.zeros((n, 2)),
            shape=np.tile(np.eye(2), (n, 1, 1)),
            cov=np.zeros((n, 2, 2)),
            anchor_cov=np.zeros((n, 2, 2)),
            depth_m=np.full(n, np.nan),
            alive=np.zeros(n, dtype=bool),
            begun=np.zeros(n, dtype=bool),
            missed=np.zeros(n, dtype=int),
            templates=empty_templates(n, config),
        )

    def joined(self, other: TrackedPoints) -> TrackedPoints:
        """These points, and then the others."""
        pairs = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("uv", "shape", "cov", "anchor_cov", "depth_m", "alive", "begun", "missed")
        }
        return TrackedPoints(**pairs, templates=self.templates.joined(other.templates))

    def snapshot(self, frame: int) -> Snapshot:
        """What is seen now."""
        seen = self.alive
        cov = self.cov[seen] + self.anchor_cov[seen]
        return Snapshot(frame, np.flatnonzero(seen), self.uv[seen], cov)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The points that one frame shows."""

    frame: int
    index: NDArray[np.int_]  # (M,) of the points
    uv: FloatArray  # (M, 2)
    cov_px2: FloatArray  # (M, 2, 2)


def tracks_of(
    snapshots: Sequence[Snapshot], T: int, N: int, floor_sigma_px: float, edge_bend_rad: float
) -> PixelTracks:
    """The tracks of N points in T frames.

    Args:
        snapshots: of some of the frames.
        T: frames.
        N: points.
        floor_sigma_px: standard deviation in every direction that comes on top.
        edge_bend_rad: direction error of edges: what slips along one may be off across it, too.
    """
    uv, cov_px2 = np.full((T, N, 2), np.nan), np.full((T, N, 2, 2), np.nan)
    visible = np.zeros((T, N), dtype=bool)
    for shot in snapshots:
        along = np.linalg.eigvalsh(shot.cov_px2)[:, 1]
        every = floor_sigma_px**2 + edge_bend_rad**2 * along
        at = shot.frame, shot.index
        visible[at], uv[at] = True, shot.uv
        cov_px2[at] = shot.cov_px2 + every[:, None, None] * np.eye(2)
    return PixelTracks(uv, visible, cov_px2)
