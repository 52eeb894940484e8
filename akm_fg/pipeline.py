"""The whole way of one input: recording, tracks or poses to a posterior."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from akm_fg.errors import InsufficientData, NoMotionObserved, TracksLost
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_poses
from akm_fg.estimation.sources.state_knowledge import StateKnowledge
from akm_fg.io.inputs import FitInput
from akm_fg.io.tracks import TracksInput
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.observed import ObservedMotion
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import Recording
from akm_fg.stages import ModelSettings, RecordingFit, Sources, Stages
from akm_fg.stream.config import StreamConfig
from akm_fg.stream.seen_so_far import SeenSoFar, hands_of
from akm_fg.track_parts import fit_parts

Watched = Callable[[int, int], None]
"""Is told after each frame of a recording: how many are done, of how many."""
log = logging.getLogger(__name__)


def fit_recording(
    recording: Recording,
    seed: int = 0,
    perception: PerceptionConfig | None = None,
    fit_config: FitConfig | None = None,
    sources: Sources = "both",
    states: StateKnowledge | None = None,
    stages: Stages | None = None,
    watched: Watched | None = None,
    stream: StreamConfig | None = None,
) -> RecordingFit:
    """Mask, track and lift frame by frame; then segment, and fit the moving part's joint.

    Where nothing moves on what was taken for the object, all that is seen is looked at.

    Args:
        recording: the clip.
        seed: of whatever is sampled.
        perception: tuning of the way from images to tracks and surfaces.
        fit_config: tuning of the estimator.
        sources: what enters the graph: tracks, the surfaces of keyframes (surface), or both.
        states: what is known of the joint's motion and limits.
        stages: who masks, tracks and estimates; see `akm_fg.stages`.
        watched: is told after each frame how many of how many are done.
        stream: tuning of the states that are found beside the graph.

    Raises:
        TracksLost: no object, or nothing on it could be followed and depth shows no motion.
        NoMotionObserved: nothing moved beyond the noise.
        AxisUnobservable: no moving kind can be fitted.
    """
    perception, fit_config = perception or PerceptionConfig(), fit_config or FitConfig()
    stream = stream or StreamConfig()
    settings = ModelSettings(perception, fit_config, sources, states, seed, stream)
    try:
        return _answer(recording, settings, stages, watched)
    except (TracksLost, NoMotionObserved):
        if recording.object_masks is not None or (stages is not None and stages.segmenter):
            raise
        log.info("%s: nothing moves on what was taken for the object", recording.name)
        try:
            return _answer(_all_as_object(recording), settings, stages, watched)
        except InsufficientData:
            pass
        raise  # of the object's own failure


def _answer(
    recording: Recording, settings: ModelSettings, stages: Stages | None, watched: Watched | None
) -> RecordingFit:
    """Watch to the end, then ask."""
    seen = SeenSoFar(recording.name, settings, stages, recording.calibration)
    masks = recording.object_masks or [None] * len(recording.frames)
    hands = hands_of(recording)
    for i, (frame, hand, mask) in enumerate(zip(recording.frames, hands, masks, strict=True), 1):
        seen.watch(frame, hand, mask)
        if watched is not None:
            watched(i, len(recording.frames))
    return seen.answer()


@dataclass(frozen=True, slots=True)
class InputFit:
    """The posterior of an input, and of a recording what was seen in it."""

    posterior: ArticulationPosterior
    observed: ObservedMotion | None = None


def _all_as_object(recording: Recording) -> Recording:
    """With masks of all pixels: what rests is told from what moves in any case."""
    everything = np.ones(recording.frames[0].depth_m.shape, dtype=bool)
    return replace(recording, object_masks=(everything,) * len(recording.frames))


def fit_input(
    data: FitInput,
    name: str,
    seed: int = 0,
    config: FitConfig | None = None,
    perception: PerceptionConfig | None = None,
    stages: Stages | None = None,
    stream: StreamConfig | None = None,
) -> ArticulationPosterior:
    """The posterior of any input of `akm-fg fit`; see `observe_and_fit`."""
    return observe_and_fit(data, name, seed, config, perception, stages, stream=stream).posterior


def observe_and_fit(
    data: FitInput,
    name: str,
    seed: int = 0,
    config: FitConfig | None = None,
    perception: PerceptionConfig | None = None,
    stages: Stages | None = None,
    watched: Watched | None = None,
    stream: StreamConfig | None = None,
) -> InputFit:
    """The posterior of any input of `akm-fg fit`, and of a recording what was seen.

    Args:
        data: a recording, tracks or poses.
        name: of the posterior.
        seed: of whatever is sampled.
        config: tuning of the estimator.
        perception: of a recording, tuning of the way from images to tracks and surfaces.
        stages: of a recording, who masks, tracks and estimates.
        watched: of a recording, is told after each frame how many of how many are done.
        stream: of a recording, tuning of the states that are found beside the graph.

    Raises:
        InsufficientData: the data are sound but do not suffice.
    """
    if isinstance(data, Recording):
        recording = replace(data, name=name)
        fit = fit_recording(
            recording, seed, perception, config, stages=stages, watched=watched, stream=stream
        )
        return InputFit(_noted(fit.posterior, data.notes), fit.observed)
    if isinstance(data, TracksInput):
        posterior = fit_parts(data.tracks, name, data.noise_known, seed, config)
    else:
        posterior = fit_poses(data, name, config)
    return InputFit(_noted(posterior, data.notes))


def _noted(posterior: ArticulationPosterior, notes: tuple[str, ...]) -> ArticulationPosterior:
    """The posterior with what reading its input had to guess, before the fit's own warnings."""
    fit = replace(posterior.fit, warnings=(*notes, *posterior.fit.warnings))
    return replace(posterior, fit=fit)
