"""The whole way of one input: recording, tracks or poses to a posterior."""

from __future__ import annotations

import logging
import time
from dataclasses import replace

import numpy as np

from akm_fg.errors import InsufficientData
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_poses, fit_surface, fit_tracks
from akm_fg.estimation.given.surface_registration import SurfaceToRegister
from akm_fg.estimation.sources.gripper import GripperPoses
from akm_fg.estimation.sources.source import Given
from akm_fg.estimation.sources.state_knowledge import StateKnowledge
from akm_fg.estimation.sources.static_points import StaticPoints
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.geometry.rigid_motion import MIN_POINTS, free_rigid_motion
from akm_fg.io.inputs import FitInput
from akm_fg.io.tracks import TracksInput
from akm_fg.perception.change.depth_change import explained_share
from akm_fg.perception.change.depth_motion import DepthMotion, depth_motion
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.moving_part.following import following
from akm_fg.perception.observe import observe_motion
from akm_fg.perception.observed import ObservedMotion
from akm_fg.perception.surface.changed_surface import ChangedSurface
from akm_fg.perception.surface.part_surface import PartSurface
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import Recording
from akm_fg.stages import ModelSettings, RecordingFit, Sources, Stages
from akm_fg.steps import to_end

log = logging.getLogger(__name__)


def fit_recording(
    recording: Recording,
    seed: int = 0,
    perception: PerceptionConfig | None = None,
    fit_config: FitConfig | None = None,
    sources: Sources = "both",
    states: StateKnowledge | None = None,
    stages: Stages | None = None,
) -> RecordingFit:
    """Mask, track, lift, segment, and fit the moving part's joint.

    Args:
        recording: the clip.
        seed: of whatever is sampled.
        perception: tuning of the way from images to tracks and surfaces.
        fit_config: tuning of the estimator.
        sources: what enters the graph: tracks, the surfaces of keyframes (surface), or both.
        states: what is known of the joint's motion and limits.
        stages: who masks, tracks and estimates; see `akm_fg.stages`.

    Raises:
        TracksLost: no object, or nothing on it could be followed and depth shows no motion.
        NoMotionObserved: nothing moved beyond the noise.
        AxisUnobservable: no moving kind can be fitted.
    """
    stages = stages or Stages()
    config = perception or PerceptionConfig()
    settings = ModelSettings(config, fit_config or FitConfig(), sources, states, seed)
    began = time.perf_counter()
    observed = observe_motion(recording, config.observe, seed, stages.segmenter, stages.tracker)
    seen = time.perf_counter()
    fit = (stages.estimator or estimate_joint)(recording, observed, settings)
    return replace(fit, posterior=replace(fit.posterior, time_s=_times(began, seen)))


def estimate_joint(
    recording: Recording, observed: ObservedMotion, settings: ModelSettings
) -> RecordingFit:
    """Tracks and surfaces to the posterior of the joint: the default estimator.

    Raises:
        TracksLost: too little could be followed and depth shows no motion.
        NoMotionObserved: nothing moved beyond the noise.
        AxisUnobservable: no moving kind can be fitted.
    """
    config, sources = settings.fit, settings.sources
    change = None
    if sources != "tracks":
        change = _better_than_tracks(recording, observed, settings.perception)
    if change is None:
        try:
            observed.segmentation.require_motion()
        except InsufficientData as error:
            raise type(error)(f"{recording.name}: {error}; expected a part that moves") from error
    knowledge = knowledge_of(recording, observed, config)
    if settings.states is not None:
        knowledge.append(settings.states)
    if change is not None:
        return _from_change(recording, observed, change, settings, knowledge)
    noise, surface_config = settings.perception.observe.noise, settings.perception.surface
    surface = PartSurface(recording, observed, noise, settings.seed, surface_config)
    posterior = fit_tracks(
        observed.moving_tracks,
        recording.name,
        seed=settings.seed,
        config=config,
        systematic_m=config.camera_systematic_m,
        sources=[SurfaceToRegister(surface), *knowledge] if sources == "both" else knowledge,
    )
    if sources == "surface":
        posterior = _surface_alone(posterior, observed, surface, config, knowledge)
    return RecordingFit(observed, posterior)


def _times(began: float, seen: float) -> dict[str, float]:
    now = time.perf_counter()
    return {"total": now - began, "perception": seen - began, "fit": now - seen}


def _better_than_tracks(
    recording: Recording, observed: ObservedMotion, config: PerceptionConfig
) -> DepthMotion | None:
    """The motion that depth alone shows, where it explains more of what changed than the tracks'.

    Plain surfaces have few tracks, and those may follow edges and reflections instead of the part.
    """
    noise, mask = config.observe.noise, observed.object_mask
    found = to_end(depth_motion(recording, mask, noise, config.change))
    if found is None or not observed.segmentation.moving.any():
        return found
    motion = free_rigid_motion(observed.moving_tracks, np.random.default_rng(0))
    R, t = motion.from_frame(int(np.flatnonzero(motion.known)[0]))
    both = motion.known & found.known[0]
    guess = found.guesses[0]
    R_depth, t_depth = guess.motion()
    changed = found.known[0] & found.change.nearer.any(axis=(1, 2))
    told = float((both & changed).sum() / max(changed.sum(), 1))  # tracks that end early tell less
    by_tracks = told * explained_share(found.change, R, t, both)
    by_depth = explained_share(found.change, R_depth, t_depth, both)
    log.info(
        "%s: tracks explain %.2f of the change, depth %.2f", recording.name, by_tracks, by_depth
    )
    return found if not by_tracks >= by_depth - config.change.clearly_more else None


def _from_change(
    recording: Recording,
    observed: ObservedMotion,
    change: DepthMotion,
    settings: ModelSettings,
    knowledge: list[Given],
) -> RecordingFit:
    """Start from the motion that depth shows; the tracks that follow it take part."""
    perception, guess = settings.perception, change.guesses[0]
    surface = ChangedSurface(change.change, settings.seed, perception.surface)
    R, t = guess.motion()
    known = change.known[0]
    moving = following(observed.tracks, R, t, known, perception.following)
    segmentation = observed.segmentation
    observed = replace(
        observed,
        segmentation=replace(
            segmentation,
            moving=moving,
            static=segmentation.static & ~moving,
            rejected=(segmentation.rejected | segmentation.moving) & ~moving,
        ),
    )
    if moving.sum() < MIN_POINTS or settings.sources == "surface":
        moving = np.zeros_like(moving)
    posterior = fit_surface(
        surface,
        guess,
        surface.middle(R, t, known),
        observed.tracks.select(moving),
        recording.name,
        settings.fit,
        settings.fit.camera_systematic_m,
        knowledge,
    )
    return RecordingFit(observed, posterior)


def _surface_alone(
    posterior: ArticulationPosterior,
    observed: ObservedMotion,
    surface: PartSurface,
    config: FitConfig,
    knowledge: list[Given],
) -> ArticulationPosterior:
    """The surface's own posterior; the tracks say where to start, and nothing more."""
    joint, states = posterior.best.joint, posterior.best.states
    if joint is None or states is None:
        return posterior
    frames = np.arange(states.mean.size)
    known = np.isfinite(states.mean)
    q = np.interp(frames, frames[known], states.mean[known])
    guess = JointGuess(joint.joint, q - q[0])
    return fit_surface(
        surface,
        guess,
        np.nanmean(observed.moving_tracks.p_world[0], axis=0),
        observed.moving_tracks.select(np.zeros(0, dtype=int)),
        posterior.name,
        config,
        config.camera_systematic_m,
        knowledge,
    )


def knowledge_of(recording: Recording, observed: ObservedMotion, config: FitConfig) -> list[Given]:
    """What a recording tells beside the part: the static tracks' noise, and the gripper if asked.

    Args:
        recording: the clip.
        observed: what was seen in it.
        config: `grasp` says whether the gripper's poses are used.
    """
    static = StaticPoints.of(observed.tracks.select(observed.segmentation.static), config)
    known: list[Given] = [] if static is None else [static]
    poses = recording.T_world_gripper
    if config.grasp is not None:
        if poses is None or recording.grasp_frames is None:
            log.warning("%s: no gripper poses, or no frames in which it holds", recording.name)
        else:
            T_world_gripper = np.array([pose.matrix() for pose in poses])
            known.append(GripperPoses(T_world_gripper, recording.grasp_frames, config.grasp))
    return known


def fit_input(
    data: FitInput,
    name: str,
    seed: int = 0,
    config: FitConfig | None = None,
    perception: PerceptionConfig | None = None,
    stages: Stages | None = None,
) -> ArticulationPosterior:
    """The posterior of any input of `akm-fg fit`.

    Args:
        data: a recording, tracks or poses.
        name: of the posterior.
        seed: of whatever is sampled.
        config: tuning of the estimator.
        perception: of a recording, tuning of the way from images to tracks and surfaces.
        stages: of a recording, who masks, tracks and estimates.

    Raises:
        InsufficientData: the data are sound but do not suffice.
    """
    if isinstance(data, Recording):
        recording = replace(data, name=name)
        posterior = fit_recording(recording, seed, perception, config, stages=stages).posterior
    elif isinstance(data, TracksInput):
        posterior = fit_tracks(data.tracks, name, data.noise_known, seed, config)
    else:
        posterior = fit_poses(data, name, config)
    return posterior
