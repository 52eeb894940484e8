"""From what was seen of an object's motion to its joint: the default estimator, piece by piece.

what explains the change, tracks or depth -> what else is known -> all kinds, surface registered
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InsufficientData
from akm_fg.estimation.between_kinds.weighed_kinds import (
    FittedKinds,
    with_sampled_joints,
)
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import one_blas_thread, surface_in_steps, tracks_in_steps
from akm_fg.estimation.given.surface_registration import SurfaceToRegister
from akm_fg.estimation.sources.gripper import GripperPoses
from akm_fg.estimation.sources.source import Given
from akm_fg.estimation.sources.static_points import StaticPoints
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.geometry.rigid_motion import free_rigid_motion
from akm_fg.perception.change.depth_change import explained_share
from akm_fg.perception.change.depth_motion import DepthMotion, depth_motion
from akm_fg.perception.config import PerceptionConfig
from akm_fg.perception.depth.other_view import stands_still
from akm_fg.perception.observed import ObservedMotion
from akm_fg.perception.surface.part_surface import PartSurface
from akm_fg.perception.surface.remembered_planes import RememberedPlanes
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import Recording
from akm_fg.stages import ModelSettings, RecordingFit
from akm_fg.steps import Steps, to_end
from akm_fg.stream.change_estimate import by_change_in_steps

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """What was seen, in the light of the answer, and all kinds fitted to it."""

    observed: ObservedMotion
    fitted: FittedKinds
    members: NDArray[np.int_]  # (N,) of the observed tracks, those that count
    by_tracks: bool  # whether tracks led: then vague joints are sampled

    def posterior(self) -> ArticulationPosterior:
        """The answer; it takes longer where the data leave a joint vague."""
        return with_sampled_joints(self.fitted) if self.by_tracks else self.fitted.posterior


def estimate_joint(
    recording: Recording, observed: ObservedMotion, settings: ModelSettings
) -> RecordingFit:
    """Tracks and surfaces to the posterior of the joint: the default estimator.

    Raises:
        TracksLost: too little could be followed and depth shows no motion.
        NoMotionObserved: nothing moved beyond the noise.
        AxisUnobservable: no moving kind can be fitted.
    """
    with one_blas_thread():
        estimate = to_end(estimate_in_steps(recording, observed, settings))
        return RecordingFit(estimate.observed, estimate.posterior())


def estimate_in_steps(
    recording: Recording,
    observed: ObservedMotion,
    settings: ModelSettings,
    planes: RememberedPlanes | None = None,
) -> Steps[JointEstimate]:
    """`estimate_joint`, with a pause after every piece of work.

    Args:
        recording: what was seen.
        observed: in it.
        settings: of the fit.
        planes: of its frames, as far as they were fitted before.
    """
    change = None
    if settings.sources != "tracks" and stands_still(recording.frames):  # pixels are compared
        change = yield from better_than_tracks(recording, observed, settings.perception)
    if change is None:
        try:
            observed.segmentation.require_motion()
        except InsufficientData as error:
            raise type(error)(f"{recording.name}: {error}; expected a part that moves") from error
    knowledge = knowledge_of(recording, observed, settings.fit)
    if settings.states is not None:
        knowledge.append(settings.states)
    yield
    by_tracks = partial(_by_tracks, recording, observed, settings, knowledge)
    if change is None:
        return (yield from by_tracks())
    try:
        found = yield from by_change_in_steps(
            recording, observed, change, settings, knowledge, planes
        )
    except InsufficientData as error:  # the tracks explain less of the change, but have a joint
        if not observed.segmentation.moving.any():
            raise
        log.info("%s: by depth: %s; the tracks are asked", recording.name, error)
        return (yield from by_tracks())
    estimate = JointEstimate(*found, by_tracks=False)
    if _rests_on_enough(estimate, settings) or not observed.segmentation.moving.any():
        return estimate
    return (yield from _in_accord(estimate, by_tracks))


def _rests_on_enough(estimate: JointEstimate, settings: ModelSettings) -> bool:
    """Whether an answer by depth is one, and needs no other."""
    answer, rig = estimate.fitted.posterior, settings.perception.rig
    few = answer.fit.tracks_used < rig.least_tracks and answer.fit.patches_used < rig.least_patches
    return answer.kind != "undecided" and not few


def _in_accord(
    by_depth: JointEstimate, by_tracks: Callable[[], Steps[JointEstimate]]
) -> Steps[JointEstimate]:
    """The tracks' answer where it is of the kind that depth alone holds most probable."""
    try:
        other = yield from by_tracks()
    except InsufficientData:
        return by_depth
    kinds = [each.fitted.posterior.best.joint for each in (by_depth, other)]
    if any(joint is None for joint in kinds):
        return by_depth
    return other if len({joint.turns for joint in kinds if joint is not None}) == 1 else by_depth


def better_than_tracks(
    recording: Recording, observed: ObservedMotion, config: PerceptionConfig
) -> Steps[DepthMotion | None]:
    """The motion that depth alone shows, where it explains more of what changed than the tracks'.

    Plain surfaces have few tracks, and those may follow edges and reflections instead of the part.
    """
    noise, mask = config.observe.noise, observed.object_mask
    found = yield from depth_motion(recording, mask, noise, config.change)
    if found is None or not observed.segmentation.moving.any():
        return found
    motion = free_rigid_motion(
        observed.moving_tracks, np.random.default_rng(0), config.observe.motion.rigid_motion
    )
    if not motion.known.any():  # never three tracks in one frame
        return found
    R, t = motion.from_frame(int(np.flatnonzero(motion.known)[0]))
    both = motion.known & found.known[0]
    guess = found.guesses[0]
    R_depth, t_depth = guess.motion()
    changed = found.known[0] & found.change.nearer.any(axis=(1, 2))
    told = float((both & changed).sum() / max(changed.sum(), 1))  # tracks that end early tell less
    yield
    by_tracks = told * explained_share(found.change, R, t, both)
    by_depth = explained_share(found.change, R_depth, t_depth, found.known[0])
    log.info(
        "%s: tracks explain %.2f of the change, depth %.2f", recording.name, by_tracks, by_depth
    )
    return found if not by_tracks >= by_depth - config.change.clearly_more else None


def _by_tracks(
    recording: Recording, observed: ObservedMotion, settings: ModelSettings, knowledge: list[Given]
) -> Steps[JointEstimate]:
    """The moving tracks and, unless they are to be alone, the part's surface."""
    config = settings.fit
    moving = np.flatnonzero(observed.segmentation.moving)
    noise = settings.perception.observe.noise
    surface = PartSurface(recording, observed, noise, settings.seed, settings.perception.surface)
    registered = [SurfaceToRegister(surface)] if settings.sources == "both" else []
    fitted = yield from tracks_in_steps(
        observed.moving_tracks,
        recording.name,
        seed=settings.seed,
        config=config,
        systematic_m=config.camera_systematic_m,
        sources=[*registered, *knowledge],
    )
    estimate = JointEstimate(observed, fitted, moving[fitted.problem.members], True)
    if settings.sources == "surface":
        return (yield from _surface_alone(estimate, surface, config, knowledge))
    return estimate


def _surface_alone(
    by_tracks: JointEstimate, surface: PartSurface, config: FitConfig, knowledge: list[Given]
) -> Steps[JointEstimate]:
    """The surface's own answer; the tracks say where to start, and nothing more."""
    observed, posterior = by_tracks.observed, by_tracks.posterior()
    joint, states = posterior.best.joint, posterior.best.states
    if joint is None or states is None:
        return by_tracks
    frames = np.arange(states.mean.size)
    known = np.isfinite(states.mean)
    q = np.interp(frames, frames[known], states.mean[known])
    none = np.zeros(0, dtype=int)
    fitted = yield from surface_in_steps(
        surface,
        JointGuess(joint.joint, q - q[0]),
        np.nanmean(observed.moving_tracks.p_world[0], axis=0),
        observed.moving_tracks.select(none),
        posterior.name,
        config,
        config.camera_systematic_m,
        knowledge,
    )
    return JointEstimate(observed, fitted, none, False)


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
