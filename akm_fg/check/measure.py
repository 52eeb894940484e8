"""Looks at a recording without a fit: some frames are compared with the first."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from akm_fg.check.hints import HintConfig, Looked, hints_of
from akm_fg.check.records import Changes, FloorSeen, RecordingCheck
from akm_fg.errors import TracksLost
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.measured_noise import noise_scale
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter, Floor
from akm_fg.perception.depth.other_view import seen_from, stands_still
from akm_fg.perception.tracking.seeding import seed_points
from akm_fg.records import BoolArray, FloatArray, Recording, RgbdFrame

UP_WORLD = (0.0, 0.0, 1.0)  # unless somebody says otherwise


@dataclass(frozen=True, slots=True)
class CheckConfig:
    """How closely one looks."""

    compared: int = 16  # frames, spread over the recording
    change_sigmas: float = 5.0  # of depth noise
    change_m: float = 0.012  # on top: moving by less is not looked for here
    speckle_px: int = 5  # changes that are narrower are edges that flicker
    first_share: float = 0.002  # of the picture, from which something has changed
    hints: HintConfig = field(default_factory=HintConfig)


def check_recording(
    recording: Recording,
    perception: PerceptionConfig | None = None,
    up_world: FloatArray | None = None,
    config: CheckConfig | None = None,
) -> RecordingCheck:
    """What a recording shows, and what will hinder a fit.

    Args:
        recording: as `fit` reads it.
        perception: the settings that a fit would have.
        up_world: (3,) unit, where up is in the world; z if not given.
        config: tuning.
    """
    config, perception = config or CheckConfig(), perception or PerceptionConfig()
    frames, observe = recording.frames, perception.observe
    picks = np.unique(np.linspace(0, len(frames) - 1, config.compared).round().astype(int))
    first = frames[0]
    times = noise_scale(first, observe.noise, observe.measured_noise)
    segmenter = DepthObjectSegmenter(observe.mask, observe.noise)
    mask = _object_mask(recording, segmenter)
    floor = segmenter.floor(first)
    up = np.array(UP_WORLD) if up_world is None else up_world
    corners = 0
    if mask is not None:
        corners = len(seed_points(first, mask, np.random.default_rng(0), observe.seeding))
    stamps_s = np.array([frame.stamp_s for frame in frames])
    steps_s = np.diff(stamps_s)
    middle_s = float(np.median(steps_s)) if steps_s.size else 0.0
    changes = _changes(recording, picks, perception, config)
    looked = Looked(recording, picks, mask, changes, perception, times)
    found = RecordingCheck(
        name=recording.name,
        frames=len(frames),
        compared=tuple(picks.tolist()),
        seconds=float(stamps_s[-1] - stamps_s[0]),
        rate_hz=1.0 / middle_s if middle_s > 0 else None,
        longest_gap_s=float(steps_s.max()) if steps_s.size else 0.0,
        camera=first.camera,
        depth_share=float(np.median([np.isfinite(frames[i].depth_m).mean() for i in picks])),
        depth_m=_range_m(first),
        noise_times=times if np.isfinite(times) else None,
        brightness=float(np.median(cv2.cvtColor(first.rgb, cv2.COLOR_RGB2GRAY))),
        object_mask=mask,
        object_share=0.0 if mask is None else float(mask.mean()),
        object_corners=corners,
        floor=None if floor is None else _floor_seen(first, floor, up),
        floor_mask=None if floor is None else floor.mask,
        changes=changes,
        camera_moves=not stands_still(frames),
        gripper_frames=None if recording.T_world_gripper is None else recording.grasp_frames,
        hints=(),
    )
    return hints_of(found, looked, config.hints)


def _object_mask(recording: Recording, segmenter: DepthObjectSegmenter) -> BoolArray | None:
    if recording.object_masks is not None:
        return recording.object_masks[0]
    try:
        return segmenter.segment(recording.frames[0])
    except TracksLost:
        return None


def _range_m(frame: RgbdFrame) -> tuple[float, float, float] | None:
    known = frame.depth_m[np.isfinite(frame.depth_m)]
    if not known.size:
        return None
    low, middle, high = np.percentile(known, (5.0, 50.0, 95.0)).tolist()
    return low, middle, high


def _floor_seen(frame: RgbdFrame, floor: Floor, up: FloatArray) -> FloorSeen:
    up_world = frame.T_world_cam.rotation().matrix() @ floor.up_cam
    x, y, z = floor.up_cam
    cosine = float(np.clip(up_world @ up, -1.0, 1.0))
    return FloorSeen(
        up_world=up_world,
        height_m=floor.height_m,
        tilt_deg=float(np.rad2deg(np.arcsin(np.clip(-z, -1.0, 1.0)))),
        roll_deg=float(np.rad2deg(np.arctan2(x, -y))),
        off_up_deg=float(np.rad2deg(np.arccos(cosine))),
        share=float(floor.mask.sum() / max(np.isfinite(frame.depth_m).sum(), 1)),
    )


def _changes(
    recording: Recording, picks: np.ndarray, perception: PerceptionConfig, config: CheckConfig
) -> Changes:
    """Depth of some frames against that of the first, as seen from where that was taken."""
    first, shape = recording.frames[0], recording.frames[0].depth_m.shape
    told, moved = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    kernel = np.ones((config.speckle_px, config.speckle_px), np.uint8)
    first_frame = None
    for i in picks[1:].tolist():
        frame = recording.frames[i]
        if not frame.T_world_cam.equals(first.T_world_cam, 0.0):
            frame = seen_from(frame, first.T_world_cam).frame
        off = np.abs(frame.depth_m - first.depth_m)
        sigma = perception.observe.noise.sigma_m(first.depth_m.astype(float), first.camera.fx)
        gate = config.change_m + config.change_sigmas * np.sqrt(2.0) * sigma
        changed = cv2.morphologyEx((off > gate).astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0
        told |= np.isfinite(off)
        moved |= changed
        if first_frame is None and changed.mean() > config.first_share:
            first_frame = i
    return Changes(np.asarray(told & ~moved), np.asarray(moved), first_frame)
