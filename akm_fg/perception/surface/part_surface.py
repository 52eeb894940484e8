"""The moving part's surface in chosen frames of a recording: masks, planes, patches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from akm_fg.geometry.rigid_motion import RigidMotion
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import DepthPlanesConfig, depth_planes
from akm_fg.perception.moving_part.part_mask import PartMaskConfig, propagate_masks
from akm_fg.perception.observed import ObservedMotion
from akm_fg.perception.surface.patches import PatchConfig, PatchViews, patch_views
from akm_fg.records import BoolArray, FloatArray, Recording
from akm_fg.steps import Steps


@dataclass(frozen=True, slots=True)
class SurfaceConfig:
    """From images to surface patches."""

    mask: PartMaskConfig = field(default_factory=PartMaskConfig)
    planes: DepthPlanesConfig = field(default_factory=DepthPlanesConfig)
    patches: PatchConfig = field(default_factory=PatchConfig)
    # Around pixels whose depth changed: where the part was before it was seen to have moved.
    change_margin_px: int = 60


@dataclass(frozen=True, slots=True)
class PartSurface:
    """Fits `akm_fg.estimation.given.surface_registration.SurfaceSource`."""

    recording: Recording
    observed: ObservedMotion
    noise: DepthNoiseModel
    seed: int = 0
    config: SurfaceConfig = field(default_factory=SurfaceConfig)

    def views(
        self, frames: Sequence[int], R_world: FloatArray, t_world: FloatArray, known: BoolArray
    ) -> Steps[PatchViews]:
        """The part's surface in these frames, its motion over all T frames being known.

        Pauses after each frame.

        Args:
            frames: numbers of the frames.
            R_world: (T, 3, 3) from the reference pose.
            t_world: (T, 3).
            known: (T,) frames in which the motion is known.
        """
        tracks = self.observed.moving_tracks
        seen = tracks.observed & known[:, None]
        back = np.einsum("tji,tnj->tni", R_world, tracks.p_world - t_world[:, None])
        count = np.maximum(seen.sum(axis=0), 1)[:, None]
        shape = np.where(seen[..., None], back, 0.0).sum(axis=0) / count
        any_seen = np.asarray(seen.any(axis=0))
        motion = RigidMotion(
            R_world=R_world,
            t_world=t_world,
            shape_world=np.where(any_seen[:, None], shape, np.nan),
            known=known,
            inlier=any_seen,
            scale=1.0,
        )
        numbers = [int(k) for k in frames]
        masks = propagate_masks(
            self.recording, self.observed, numbers, self.noise, self.config.mask, motion
        )
        planes = []
        for mask in masks:
            frame = self.recording.frames[mask.frame]
            planes.append(depth_planes(frame, self.noise, mask.moving, self.config.planes))
            yield
        return patch_views(numbers, planes, np.random.default_rng(self.seed), self.config.patches)
