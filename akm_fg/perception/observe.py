"""From frames to tracks in space that say what moved."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from akm_fg.interfaces import ObjectSegmenter, PointTracker, SeenPixels
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.holes import HolesConfig, without_holes
from akm_fg.perception.depth.measured_noise import MeasuredNoiseConfig, measured_noise
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter, DepthSegmenterConfig
from akm_fg.perception.depth.object_now import ObjectNowConfig, object_now
from akm_fg.perception.kept_frames import KeptFrames, KeptFramesConfig
from akm_fg.perception.moving_part.motion_config import MotionSegmentationConfig
from akm_fg.perception.moving_part.motion_segmentation import segment_motion
from akm_fg.perception.observed import ObservedMotion
from akm_fg.perception.tracking.flow_tracker import FlowTracker, FlowTrackerConfig
from akm_fg.perception.tracking.lifting import LiftingConfig, lift
from akm_fg.perception.tracking.seeding import SeedingConfig, SeedingSchedule, seed_points
from akm_fg.perception.tracking.track_store import Frames, SeenPoints, TrackStore
from akm_fg.records import BoolArray, FloatArray, Recording, RgbdFrame
from akm_fg.steps import Steps, to_end

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ObserveConfig:
    """All tuning of the way from images to segmented tracks."""

    noise: DepthNoiseModel = field(default_factory=DepthNoiseModel)
    measured_noise: MeasuredNoiseConfig = field(default_factory=MeasuredNoiseConfig)
    holes: HolesConfig = field(default_factory=HolesConfig)
    mask: DepthSegmenterConfig = field(default_factory=DepthSegmenterConfig)
    mask_later: ObjectNowConfig = field(default_factory=ObjectNowConfig)
    seeding: SeedingConfig = field(default_factory=SeedingConfig)
    tracker: FlowTrackerConfig = field(default_factory=FlowTrackerConfig)
    lifting: LiftingConfig = field(default_factory=LiftingConfig)
    motion: MotionSegmentationConfig = field(default_factory=MotionSegmentationConfig)
    kept: KeptFramesConfig = field(default_factory=KeptFramesConfig)


class MotionObserver:
    """Watches an object frame by frame, and says at any time what of it moved.

    A frame is looked at once, when it comes; what comes later changes nothing of what was seen in
    it. So a recording that is watched to its end and a stream that has got as far tell the same.

    Args:
        config: tuning; where the first frame shows that its depth is noisier than `noise` says,
            what it shows takes its place.
        seed: of what is sampled.
        segmenter: finds the object in the first frame, if that comes without a mask.
        tracker: follows the points.
    """

    def __init__(
        self,
        config: ObserveConfig | None = None,
        seed: int = 0,
        segmenter: ObjectSegmenter | None = None,
        tracker: PointTracker | None = None,
    ) -> None:
        self.config = config = config or ObserveConfig()
        self._segmenter = segmenter
        self._session = (tracker or FlowTracker(config.tracker)).begin()
        self._schedule = SeedingSchedule(config.seeding)
        self._seed, self._rng = seed, np.random.default_rng(seed)
        self._first: RgbdFrame | None = None
        self._mask: BoolArray | None = None  # (H, W) the object in the first frame
        self._hands: list[FloatArray] = []  # (3,) each, NaN where it is not known to hold
        self.store = TrackStore()
        self.kept = KeptFrames(config.kept)

    @property
    def object_mask(self) -> BoolArray:
        """(H, W) the object in the first frame.

        Raises:
            ValueError: no frame yet.
        """
        if self._mask is None:
            raise ValueError("no frame was watched yet")
        return self._mask

    def watch(
        self,
        frame: RgbdFrame,
        object_mask: BoolArray | None = None,
        hand_world: FloatArray | None = None,
    ) -> SeenPoints:
        """Follow the object into the next frame.

        Args:
            frame: of a camera that stands still, or whose pose in every frame is known.
            object_mask: (H, W) the object in it, where that is known.
            hand_world: (3,) where the gripper is, while it holds the part.

        Raises:
            TracksLost: no object is seen in the first frame; the next one is the first again.
        """
        if self._mask is None:
            noise = measured_noise(frame, self.config.noise, self.config.measured_noise)
            frame = without_holes(frame, noise, self.config.holes)
            if object_mask is None:
                segmenter = self._segmenter or DepthObjectSegmenter(self.config.mask, noise)
                object_mask = segmenter.segment(frame)
            self._believe(noise)
            self._first, self._mask = frame, object_mask
        else:
            frame = without_holes(frame, self.config.noise, self.config.holes)
        pixels = self._session.advance(frame)
        if self._schedule.due(len(pixels.index)):
            pixels = self._seeded(frame, object_mask, pixels)
        seen = lift(pixels, frame, self.config.noise, self.config.lifting)
        self.store.add(seen)
        self.kept.add(frame, seen)
        self._hands.append(np.full(3, np.nan) if hand_world is None else hand_world)
        return seen

    def _believe(self, noise: DepthNoiseModel) -> None:
        """What the first frame shows; depth steps that count as edges grow with it."""
        config = self.config
        scale = noise.disparity_sigma_px / config.noise.disparity_sigma_px
        seeding = replace(config.seeding, edge_m=scale * config.seeding.edge_m)
        self.config = replace(config, noise=noise, seeding=seeding)

    def _seeded(
        self, frame: RgbdFrame, object_mask: BoolArray | None, pixels: SeenPixels
    ) -> SeenPixels:
        """With new points where the object is and none is followed."""
        config, mask = self.config, object_mask
        if mask is None:
            assert self._first is not None and self._mask is not None
            mask = object_now(self._first, self._mask, frame, config.noise, config.mask_later)
        new_uv = seed_points(frame, mask, self._rng, config.seeding, pixels.uv)
        new = self._session.follow(new_uv)
        self._schedule.seeded(len(pixels.index) + len(new.index))
        return pixels.joined(new)

    def observed(self, frames: Frames | None = None) -> ObservedMotion:
        """What was seen so far; what moved is judged by the frames that are kept.

        That nothing moved, or nothing could be followed, is a result too: see
        `MotionSegmentation.require_motion`.

        Args:
            frames: whose tracks are given; all if not said.

        Raises:
            ValueError: no frame yet.
        """
        return to_end(self.observed_in_steps(frames))

    def observed_in_steps(self, frames: Frames | None = None) -> Steps[ObservedMotion]:
        """`observed`, with a pause after every piece of work: what came until it began."""
        object_mask = self.object_mask
        kept, config = self.kept.numbers, self.config.motion
        tracks, pixels = self.store.point_tracks(frames), self.store.pixel_tracks(frames)
        hands = np.array(self._hands)[kept]
        held = hands if np.isfinite(hands).any() else None
        rng = np.random.default_rng([self._seed, 1])  # asking does not change what is asked next
        judged = self.store.point_tracks(kept)
        segmentation = yield from segment_motion(judged, config, rng, held)
        log.info(
            "%d tracks, %d moving, %d static, %d rejected",
            segmentation.moving.size,
            segmentation.moving.sum(),
            segmentation.static.sum(),
            segmentation.rejected.sum(),
        )
        return ObservedMotion(tracks, pixels, segmentation, object_mask)


def observe_motion(
    recording: Recording,
    config: ObserveConfig | None = None,
    seed: int = 0,
    segmenter: ObjectSegmenter | None = None,
    tracker: PointTracker | None = None,
) -> ObservedMotion:
    """Watch a recording to its end: find the object, follow points on it, tell what moved.

    Args:
        recording: the clip; its object masks are used where it has them.
        config: tuning.
        seed: of what is sampled.
        segmenter: finds the object where the recording has no masks.
        tracker: follows the points.

    Raises:
        TracksLost: no object is seen.
    """
    observer = MotionObserver(config, seed, segmenter, tracker)
    masks = recording.object_masks or (None,) * len(recording.frames)
    for frame, mask, hand in zip(recording.frames, masks, hands_of(recording), strict=True):
        observer.watch(frame, mask, hand)
    return observer.observed()


def hands_of(recording: Recording) -> Sequence[FloatArray | None]:
    """Where the gripper is in each frame, (3,); None where it is not known to hold."""
    n = len(recording.frames)
    if recording.T_world_gripper is None or recording.grasp_frames is None:
        return [None] * n
    first, last = recording.grasp_frames
    return [
        pose.translation() if first <= t <= last else None
        for t, pose in enumerate(recording.T_world_gripper)
    ]
