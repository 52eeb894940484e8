"""The state of points that are being followed."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.tracking.affine_match import Templates
from akm_fg.records import BoolArray, FloatArray


@dataclass(slots=True)
class TrackedPoints:
    """All points that are not given up, at the current frame; rows are points."""

    index: NDArray[np.int_]  # (N,) growing, the caller's numbers
    uv: FloatArray  # (N, 2)
    shape: FloatArray  # (N, 2, 2) relative to the anchor
    cov: FloatArray  # (N, 2, 2) of uv relative to the anchor, px^2
    anchor_cov: FloatArray  # (N, 2, 2) of the anchor relative to the query, px^2
    lasting: FloatArray  # (N, 2, 2) of both, what came from the frames before, px^2
    depth_m: FloatArray  # (N,) when last seen
    missed: NDArray[np.int_]  # (N,) frames since it was last seen
    templates: Templates

    @staticmethod
    def at(
        index: NDArray[np.int_], uv: FloatArray, depth_m: FloatArray, templates: Templates
    ) -> TrackedPoints:
        """Points that begin here."""
        n = len(index)
        return TrackedPoints(
            index=index,
            uv=uv.copy(),
            shape=np.tile(np.eye(2), (n, 1, 1)),
            cov=np.zeros((n, 2, 2)),
            anchor_cov=np.zeros((n, 2, 2)),
            lasting=np.zeros((n, 2, 2)),
            depth_m=depth_m,
            missed=np.zeros(n, dtype=int),
            templates=templates,
        )

    @property
    def alive(self) -> BoolArray:
        """(N,) seen in the last frame."""
        return np.asarray(self.missed == 0)

    def joined(self, other: TrackedPoints) -> TrackedPoints:
        """These points, and then the others."""
        pairs = {
            f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)])
            for f in fields(self)
            if f.name != "templates"
        }
        return TrackedPoints(**pairs, templates=self.templates.joined(other.templates))

    def select(self, rows: NDArray) -> TrackedPoints:
        """Some of the points."""
        kept = {f.name: getattr(self, f.name)[rows] for f in fields(self) if f.name != "templates"}
        return replace(self, **kept, templates=self.templates.select(rows))
