"""Every pixel of the moving part in chosen frames, from the few that were tracked.

The tracks give the part's rigid motion; depth then says of each pixel whether it rests or moves
with the part (`mask_likelihood`), summed over a few other frames. A surface that slides within its
own plane fits both: there the nearest tracks decide. Neighbours on the same surface share their
likelihood, small islands and pixels at depth edges (flying pixels) are left out (`mask_cleanup`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import gtsam
import numpy as np

from akm_fg.geometry.rigid_motion import (
    MIN_POINTS,
    RigidMotion,
    RigidMotionConfig,
    free_rigid_motion,
)
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import Box, Image, bounding_box
from akm_fg.perception.depth.other_view import same_view, seen_from
from akm_fg.perception.moving_part.mask_cleanup import (
    MaskCleanupConfig,
    SurfaceNeighbours,
    refine,
    without_islands,
)
from akm_fg.perception.moving_part.mask_likelihood import (
    MaskLikelihoodConfig,
    MaskView,
    gather_likelihood,
    mask_view,
    on_background,
)
from akm_fg.perception.moving_part.mask_prior import TrackPriorConfig, nearness
from akm_fg.perception.observed import ObservedMotion
from akm_fg.records import BoolArray, Recording, RgbdFrame

_ALIKE_DIGITS = 6  # of metres; far below what any sensor tells apart


@dataclass(frozen=True, slots=True)
class PartMaskConfig:
    """Likelihood, prior and clean-up."""

    likelihood: MaskLikelihoodConfig = field(default_factory=MaskLikelihoodConfig)
    prior: TrackPriorConfig = field(default_factory=TrackPriorConfig)
    cleanup: MaskCleanupConfig = field(default_factory=MaskCleanupConfig)
    rigid_motion: RigidMotionConfig = field(default_factory=RigidMotionConfig)
    stride_px: int = 3  # of the pixels that are judged; those between follow on the same surface
    other_frames: int = 4  # asked for each keyframe
    min_motion_m: float = 0.02  # of the part between two frames that say something; else the most
    min_tracks: int = 6  # of the part, seen in a frame whose rigid motion is trusted
    background: float = 8.0  # log odds of rest for what the first frame shows off the object
    mask_error_px: int = 3  # of the object's outline
    margin_px: float = 0.06  # of the image's width, around the object, of the judged region
    min_log_odds: float = 2.0  # decides a pixel
    min_fit: float = -1.0  # mean log-likelihood ratio a frame; below, neither hypothesis holds
    seed: int = 0  # of the rigid motion's sampling: the same tracks give the same masks


@dataclass(frozen=True, slots=True)
class PartMask:
    """What is known to move with the part and what is known to rest; the rest is open."""

    frame: int  # number in the recording
    moving: BoolArray  # (H, W)
    static: BoolArray  # (H, W), within the region around the object


def propagate_masks(
    recording: Recording,
    observed: ObservedMotion,
    frames: Sequence[int],
    noise: DepthNoiseModel,
    config: PartMaskConfig | None = None,
    motion: RigidMotion | None = None,
) -> Iterator[PartMask]:
    """Masks of all pixels of the part and of what rests, in chosen frames, each as it is asked for.

    A frame in which too few tracks of the part are seen to know its motion gets empty masks.

    Args:
        recording: the clip.
        observed: its tracks and what of them moves.
        frames: numbers of the frames.
        noise: of the depth.
        config: tuning.
        motion: the part's motion over the frames, where it is known better than from the moving
            tracks alone, for instance from a fitted joint.

    Raises:
        ValueError: a frame that is not there, or no moving tracks.
    """
    config = config or PartMaskConfig()
    n = len(recording.frames)
    if any(not 0 <= k < n for k in frames):
        raise ValueError(f"frames {list(frames)}, expected some of 0..{n - 1}")
    tracks = observed.moving_tracks
    if motion is None:
        seen = tracks.observed.sum(axis=1)
        if seen.max(initial=0) < MIN_POINTS:
            raise ValueError(f"{int(seen.max(initial=0))} moving tracks, expected {MIN_POINTS}")
        motion = free_rigid_motion(tracks, np.random.default_rng(config.seed), config.rigid_motion)
        motion = replace(motion, known=motion.known & (seen >= config.min_tracks))
    scale = observed.segmentation.noise_scale
    noise = replace(noise, disparity_sigma_px=scale * noise.disparity_sigma_px)
    scene = _Scene(recording.frames, observed, motion, noise, config)
    return (scene.mask(k) for k in frames)


class _Scene:
    """What all keyframes of a recording share."""

    def __init__(
        self,
        frames: tuple[RgbdFrame, ...],
        observed: ObservedMotion,
        motion: RigidMotion,
        noise: DepthNoiseModel,
        config: PartMaskConfig,
    ) -> None:
        self._frames, self._observed = frames, observed
        self._noise, self._config = noise, config
        self._known = motion.known
        self._poses = [
            gtsam.Pose3(gtsam.Rot3(R), t)
            for R, t in zip(motion.R_world, motion.t_world, strict=True)
        ]
        shape = motion.shape_world[motion.inlier & np.isfinite(motion.shape_world).all(axis=1)]
        moved = np.einsum("tij,nj->tni", motion.R_world, shape) + motion.t_world[:, None]
        self._points_world = moved  # (T, N, 3) where the part's tracks are in every frame
        self._views: dict[int, MaskView] = {}
        self._background = self._without_object()

    def _view(self, k: int) -> MaskView:
        if k not in self._views:
            self._views[k] = mask_view(self._frames[k], self._config.likelihood)
        return self._views[k]

    def _motion(self, a: int, b: int) -> gtsam.Pose3:
        """Of the part from frame a to frame b, world."""
        return self._poses[b] * self._poses[a].inverse()

    def _without_object(self) -> MaskView:
        """The first frame with the object's depth taken out."""
        view, mask = self._view(0), self._observed.object_mask.astype(np.uint8)
        grown = cv2.dilate(mask, np.ones((2 * self._config.mask_error_px + 1,) * 2, np.uint8)) > 0
        return replace(view, depth_m=np.where(grown, np.float32(np.nan), view.depth_m))

    def mask(self, k: int) -> PartMask:
        """Judge one frame."""
        frame, c = self._frames[k], self._config
        moving, static = (np.zeros(frame.depth_m.shape, dtype=bool) for _ in range(2))
        others = self._others(k)
        if not others:
            return PartMask(k, moving, static)
        box = self._region(k)
        rows, columns = box
        step = c.stride_px
        coarse = np.s_[rows.start : rows.stop : step, columns.start : columns.stop : step]
        asked = [(self._view(j), self._motion(k, j)) for j in others]
        said = gather_likelihood(self._view(k), coarse, asked, self._noise, c.likelihood)
        z = frame.depth_m[coarse]
        near = SurfaceNeighbours(z, c.stride_px, frame.camera.fx, c.cleanup)
        odds = near.average(said.ratio + self._prior(k, coarse))
        best = near.average(np.maximum(said.moving, said.static))
        fits = best > c.min_fit * len(others)
        area = round(c.cleanup.min_area * frame.depth_m.size / step**2)
        yes, no = (without_islands((sign * odds > c.min_log_odds) & fits, area) for sign in (1, -1))
        moving[box], static[box] = refine(
            yes, no, frame.depth_m[box], c.stride_px, frame.camera.fx, c.cleanup
        )
        return PartMask(k, moving, static)

    def _others(self, k: int) -> list[int]:
        """Frames to ask about frame k: the part has moved between, by various amounts."""
        if not self._known[k]:
            return []
        c, points = self._config, self._points_world
        moved = np.sqrt(((points - points[k]) ** 2).sum(axis=-1).mean(axis=1))
        moved = moved.round(_ALIKE_DIGITS)  # alike on every machine: rounding errors decide nothing
        moved[~self._known] = 0.0
        candidates = np.flatnonzero(moved >= min(c.min_motion_m, 0.999 * moved.max()))
        candidates = candidates[moved[candidates] > 0]
        ordered = candidates[np.argsort(moved[candidates], kind="stable")]
        n = min(c.other_frames, len(ordered))
        picks = np.linspace(0, len(ordered) - 1, n + 1)[1:].round().astype(int)
        return [int(j) for j in ordered[np.unique(picks)]]

    def _region(self, k: int) -> Box:
        """Rows and columns that hold the object at rest and the part in frame k."""
        frame, mask = self._frames[k], self._observed.object_mask
        if not same_view(self._frames[0], frame):
            mask = seen_from(self._frames[0], frame.T_world_cam).carried(mask)
        region = np.zeros_like(mask)
        T_cam_world = frame.T_world_cam.inverse()
        R, t = T_cam_world.rotation().matrix(), T_cam_world.translation()
        uv = frame.camera.project(self._points_world[k] @ R.T + t)
        u, v = np.nan_to_num(uv).round().astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < frame.camera.width) & (v < frame.camera.height)
        region[v[inside], u[inside]] = True
        margin = round(self._config.margin_px * frame.camera.width)
        box = bounding_box(region | mask, margin)
        return box if box is not None else np.s_[0 : mask.shape[0], 0 : mask.shape[1]]

    def _prior(self, k: int, coarse: Box) -> Image:
        """(h, w) log odds of moving before depths are compared.

        From the nearest moving and the nearest resting track, and from the first frame: what
        was seen there beside the object does not move, and the part was no place beside it.
        """
        segmentation, c = self._observed.segmentation, self._config
        moving = self._nearness(k, coarse, segmentation.moving)
        static = self._nearness(k, coarse, segmentation.static)
        motion = self._motion(k, 0) if self._known[0] else None
        beside = on_background(
            self._view(k), coarse, self._background, motion, self._noise, c.likelihood
        )
        odds = c.prior.at_track * (moving - static) - c.background * beside
        return np.asarray(odds, dtype=np.float32)

    def _nearness(self, k: int, coarse: Box, chosen: BoolArray) -> Image:
        """To the chosen tracks that are seen in frame k."""
        seen = chosen & self._observed.tracks.observed[k]
        uv = self._observed.pixels.uv[k, seen]
        return nearness(self._frames[k], coarse, uv, self._noise, self._config.prior)
