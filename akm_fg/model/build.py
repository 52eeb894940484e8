"""From fitted recordings to the model of an object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import gtsam
import numpy as np

from akm_fg.errors import InsufficientData
from akm_fg.model.config import ModelConfig
from akm_fg.model.part_views import PartView, part_views, spread_frames
from akm_fg.model.records import Contact, ModelPart, ObjectModel, StateLimits, Surface
from akm_fg.model.surface_cloud import View, averaged, believed, in_one_piece, pixels, readings
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.measured_noise import measured_noise
from akm_fg.perception.observed import ObservedMotion
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import BoolArray, CameraCorrection, FloatArray, Recording
from akm_fg.stages import RecordingFit


@dataclass(frozen=True, slots=True)
class FittedRecording:
    """A recording, what was seen in it, and what that means."""

    recording: Recording
    observed: ObservedMotion
    posterior: ArticulationPosterior
    closed_state: float = 0.0  # where, in its own states, the part is closed
    correction: CameraCorrection | None = None  # of the camera's world against the posterior's

    @staticmethod
    def of(recording: Recording, fit: RecordingFit, closed_state: float = 0.0) -> FittedRecording:
        """A recording with its fit."""
        return FittedRecording(recording, fit.observed, fit.posterior, closed_state, fit.correction)

    def part(self, surface: Surface) -> ModelPart:
        """The part that moves, with what is known of it by this recording."""
        return ModelPart(
            "part-0", self.posterior, surface, self.closed_state, correction=self.correction
        )


def build_model(
    fitted: FittedRecording,
    more: Sequence[FittedRecording] = (),
    *,
    name: str = "part-0",
    limits: StateLimits | None = None,
    contacts: Sequence[Contact] | None = None,
    sources: Sequence[str] | None = None,
    perception: PerceptionConfig | None = None,
    config: ModelConfig | None = None,
) -> ObjectModel:
    """The model of an object with one part that moves.

    Args:
        fitted: the recording whose posterior is the model's.
        more: others of the same part and world, whose images add to the surfaces.
        name: of the part.
        limits: of the joint, where they were met.
        contacts: grasps that were tried; if not given, those that the recordings tell of.
        sources: what the recordings are called; their own names if not given.
        perception: tuning of the way from images to masks, as the fit had it.
        config: tuning of the surfaces.

    Raises:
        InsufficientData: nothing moves in the best fit, or too little of the part was seen.
        ValueError: a posterior of other frames than its recording's.
    """
    perception, config = perception or PerceptionConfig(), config or ModelConfig()
    everything = [fitted, *more]
    seen = [_seen(each, perception, config) for each in everything]
    moving = _part_surface(seen, config)
    if len(moving) < config.least_points:
        raise InsufficientData(
            f"{fitted.recording.name}: {len(moving)} points of the part's surface are known; "
            f"expected {config.least_points} for a model"
        )
    static = _static_surface(seen, config)
    if contacts is None:
        contacts = [contact for each in everything for contact in _contacts(each)]
    known = fitted.part(moving)
    part = replace(known, name=name, limits=limits, contacts=tuple(contacts))
    first = fitted.recording.frames[0]
    names = [each.recording.name for each in everything] if sources is None else sources
    return ObjectModel((part,), static, first.camera, first.T_world_cam, tuple(names))


@dataclass(frozen=True, slots=True)
class _Seen:
    """The chosen frames of one recording."""

    fitted: FittedRecording
    views: list[PartView]
    noise: DepthNoiseModel


def _seen(fitted: FittedRecording, perception: PerceptionConfig, config: ModelConfig) -> _Seen:
    best, recording = fitted.posterior.best, fitted.recording
    if best.joint is None or best.states is None:
        raise InsufficientData(f"{recording.name}: nothing moves; expected a part for a model")
    part = fitted.part(_NO_SURFACE)
    q: FloatArray = np.array([part.seen_state(float(state)) for state in best.states.mean])
    if q.size != len(recording.frames):
        raise ValueError(f"{q.size} states of {len(recording.frames)} frames")
    frames = spread_frames(q, config.frames)
    if not frames:
        raise InsufficientData(f"{recording.name}: the part is seen in no frame")
    observe = perception.observe
    noise = measured_noise(recording.frames[0], observe.noise, observe.measured_noise)
    views = part_views(
        recording,
        fitted.observed,
        part.seen_joint,
        q,
        part.seen_state(fitted.closed_state),
        frames,
        noise,
        perception,
    )
    return _Seen(fitted, views, noise)


def _part_surface(seen: Sequence[_Seen], config: ModelConfig) -> Surface:
    """Readings carried back to the closed state, less what frames look through."""
    found = [
        readings(view.part, view.moving, each.noise, config) for each in seen for view in each.views
    ]
    surface = averaged(found, config.voxel_m)
    for each in seen:
        views = [view.part for view in each.views]
        surface = surface.select(believed(surface, views, each.noise, config))
    return surface.select(in_one_piece(surface.p_world, config))


def _static_surface(seen: Sequence[_Seen], config: ModelConfig) -> Surface:
    """What rests, and which of it is the object's own."""
    at_rest = [
        [View(view.part.frame, gtsam.Pose3(), view.part.closed) for view in each.views]
        for each in seen
    ]
    found = [
        readings(view, part_view.static, each.noise, config)
        for each, views in zip(seen, at_rest, strict=True)
        for view, part_view in zip(views, each.views, strict=True)
    ]
    surface = averaged(found, config.voxel_m)
    for each, views in zip(seen, at_rest, strict=True):
        # The part in front of what rests is no contradiction; what is seen through it is one.
        surface = surface.select(believed(surface, views, each.noise, config))
    return replace(surface, on_object=_on_object(surface, seen[0], config))


def _on_object(surface: Surface, seen: _Seen, config: ModelConfig) -> BoolArray:
    """(N,) points that lie where the first frame has the object, on its surface or behind it."""
    frame = seen.fitted.recording.frames[0]
    eye = frame.T_world_cam.translation()
    p_cam = (surface.p_world - eye) @ frame.T_world_cam.rotation().matrix()
    row, column, inside = pixels(frame, p_cam)
    # At its outline it may be what is beside it.
    border = np.ones((2 * config.outline_px + 1,) * 2, np.uint8)
    mask = cv2.erode(seen.fitted.observed.object_mask.astype(np.uint8), border) > 0
    return inside & mask[row, column]


def _contacts(fitted: FittedRecording) -> list[Contact]:
    """The grasp of a recording that tells of one, if its state is known."""
    recording, best = fitted.recording, fitted.posterior.best
    if recording.T_world_gripper is None or recording.grasp_frames is None:
        return []
    assert best.joint is not None and best.states is not None
    first, last = recording.grasp_frames
    held = [t for t in range(first, last + 1) if np.isfinite(best.states.mean[t])]
    if not held:
        return []
    state = float(best.states.mean[held[0]])
    R, t = best.joint.joint.motion(np.array([state, fitted.closed_state]))
    here, closed = (gtsam.Pose3(gtsam.Rot3(R[i]), t[i]) for i in range(2))
    T_part_world = closed * here.inverse()
    return [Contact(T_part_world * recording.T_world_gripper[held[0]], state, succeeded=1)]


_NO_SURFACE = Surface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
