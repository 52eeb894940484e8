"""The moving part's surface where depth changed: no track is needed to find it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from akm_fg.perception.change.depth_change import DepthChange, surface_points
from akm_fg.perception.surface.part_cloud import sample_cloud
from akm_fg.perception.surface.part_surface import SurfaceConfig
from akm_fg.perception.surface.patches import PatchViews
from akm_fg.perception.surface.remembered_planes import RememberedPlanes
from akm_fg.records import BoolArray, FloatArray
from akm_fg.steps import Steps


@dataclass(frozen=True, slots=True)
class ChangedSurface:
    """Fits `akm_fg.estimation.given.surface_registration.SurfaceSource`.

    Patches are set where a frame shows a surface nearer than frame 0 does: the part, wherever it
    stands in front of what was there. They are looked up in all depth, so frame 0 is seen too.
    """

    change: DepthChange
    seed: int = 0
    config: SurfaceConfig = field(default_factory=SurfaceConfig)
    planes: RememberedPlanes = field(default_factory=RememberedPlanes)

    def views(
        self, frames: Sequence[int], R_world: FloatArray, t_world: FloatArray, known: BoolArray
    ) -> Steps[PatchViews]:
        """The part's surface in these frames; the motion is not needed to find it."""
        del R_world, t_world, known
        around = self._around()
        rng = np.random.default_rng(self.seed)
        numbers = tuple(int(t) for t in frames)
        fitted, clouds = [], []
        for t in numbers:
            frame = self.change.recording.frames[t]
            planes = self.planes.of(frame, self.change.noise, around, self.config.planes)
            fitted.append(planes)
            on_part = replace(planes, valid=planes.valid & self.change.mask(t))
            clouds.append(sample_cloud(on_part, t, rng, stride_px=self.config.patches.stride_px))
            yield
        return PatchViews(numbers, tuple(fitted), tuple(clouds), self.config.patches, True)

    def middle(self, R_world: FloatArray, t_world: FloatArray, known: BoolArray) -> FloatArray:
        """(3,) roughly the middle of the part at state zero, for motions from frame 0."""
        far = int(np.argmax(np.where(known, self.change.area_m2, -1.0)))
        points = surface_points(self.change, far, self.change.nearer[far])
        return np.asarray(R_world[far].T @ (points.mean(axis=0) - t_world[far]))

    def _around(self) -> BoolArray:
        """(H, W) the changed pixels of all frames and their surroundings."""
        any_change = np.asarray((self.change.nearer | self.change.farther).any(axis=0))
        side = 2 * self.config.change_margin_px + 1
        mask = self.change.full_size(any_change).astype(np.uint8)
        return np.asarray(cv2.dilate(mask, np.ones((side, side), np.uint8)) > 0)
