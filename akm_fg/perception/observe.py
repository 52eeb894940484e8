"""From a recording to tracks in space that say what moved."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np

from akm_fg.errors import TracksLost
from akm_fg.interfaces import ObjectSegmenter, PointTracker
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter, DepthSegmenterConfig
from akm_fg.perception.moving_part.motion_config import MotionSegmentationConfig
from akm_fg.perception.moving_part.motion_segmentation import (
    MotionSegmentation,
    segment_motion,
)
from akm_fg.perception.tracking.flow_tracker import FlowTracker, FlowTrackerConfig
from akm_fg.perception.tracking.lifting import LiftingConfig, lift
from akm_fg.perception.tracking.seeding import SeedingConfig, track_object
from akm_fg.records import BoolArray, FloatArray, PixelTracks, PointTracks, Recording

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ObserveConfig:
    """All tuning of the way from images to segmented tracks."""

    noise: DepthNoiseModel = field(default_factory=DepthNoiseModel)
    mask: DepthSegmenterConfig = field(default_factory=DepthSegmenterConfig)
    seeding: SeedingConfig = field(default_factory=SeedingConfig)
    tracker: FlowTrackerConfig = field(default_factory=FlowTrackerConfig)
    lifting: LiftingConfig = field(default_factory=LiftingConfig)
    motion: MotionSegmentationConfig = field(default_factory=MotionSegmentationConfig)
    reseed_times: int = 3  # spread over the clip: each costs a mask; more find little new


@dataclass(frozen=True, slots=True)
class ObservedMotion:
    """What was seen of the object: N tracks over the T frames of the recording."""

    tracks: PointTracks  # all; world frame
    pixels: PixelTracks  # the same, in the image
    segmentation: MotionSegmentation
    object_mask: BoolArray  # (H, W) in the first frame

    @property
    def moving_tracks(self) -> PointTracks:
        """The tracks of the moving part."""
        return self.tracks.select(self.segmentation.moving)


def observe_motion(
    recording: Recording,
    config: ObserveConfig | None = None,
    rng: np.random.Generator | None = None,
    segmenter: ObjectSegmenter | None = None,
    tracker: PointTracker | None = None,
) -> ObservedMotion:
    """Find the object, follow points on it, lift them, and tell the moving from the resting.

    That nothing moved, or nothing could be followed, is a result too: see
    `MotionSegmentation.require_motion`.

    Args:
        recording: the clip; its object masks are used where it has them.
        config: tuning.
        rng: seeds and samples; a fixed one if not given.
        segmenter: finds the object where the recording has no masks.
        tracker: follows the points.

    Raises:
        TracksLost: no object is seen.
    """
    config = config or ObserveConfig()
    rng = rng or np.random.default_rng(0)
    segmenter = segmenter or DepthObjectSegmenter(config.mask, config.noise)
    tracker = tracker or FlowTracker(config.tracker)
    masks = _masks(recording, segmenter, config)
    pixels = track_object(recording.frames, masks, tracker, rng, config.seeding)
    tracks = lift(pixels, recording.frames, config.noise, config.lifting)
    segmentation = segment_motion(tracks, config.motion, rng, _hand(recording))
    log.info(
        "%s: %d tracks, %d moving, %d static, %d rejected",
        recording.name,
        pixels.visible.shape[1],
        segmentation.moving.sum(),
        segmentation.static.sum(),
        segmentation.rejected.sum(),
    )
    return ObservedMotion(tracks, pixels, segmentation, masks[0])


def _hand(recording: Recording) -> FloatArray | None:
    """(T, 3) where the gripper is while it holds, NaN in other frames; None if not known."""
    if recording.T_world_gripper is None or recording.grasp_frames is None:
        return None
    first, last = recording.grasp_frames
    hand_world = np.full((len(recording.frames), 3), np.nan)
    for t in range(first, last + 1):
        hand_world[t] = recording.T_world_gripper[t].translation()
    return hand_world


def _masks(
    recording: Recording, segmenter: ObjectSegmenter, config: ObserveConfig
) -> dict[int, BoolArray]:
    """The object in the first frame and in those where new points are set."""
    n = len(recording.frames)
    times = np.unique(np.linspace(0, n - 1, config.reseed_times + 2).astype(int)[:-1])
    masks: dict[int, BoolArray] = {}
    for t in (int(t) for t in times):
        if recording.object_masks is not None:
            masks[t] = recording.object_masks[t]
            continue
        try:
            masks[t] = segmenter.segment(recording.frames[t])
        except TracksLost:
            if t == 0:
                raise
            log.warning("%s: the object is not seen in frame %d", recording.name, t)
    return masks
