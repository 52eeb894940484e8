"""The whole way of one input: recording, tracks or poses to a posterior."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from akm_fg.errors import InsufficientData
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_poses, fit_surface, fit_tracks
from akm_fg.estimation.initial_guess import JointGuess
from akm_fg.estimation.posterior import ArticulationPosterior
from akm_fg.io.inputs import FitInput
from akm_fg.io.tracks import TracksInput
from akm_fg.perception.observe import ObserveConfig, ObservedMotion, observe_motion
from akm_fg.perception.part_surface import PartSurface
from akm_fg.records import Recording

Sources = Literal["tracks", "dense", "both"]


@dataclass(frozen=True, slots=True)
class RecordingFit:
    """What was seen in a recording, and what it means."""

    observed: ObservedMotion
    posterior: ArticulationPosterior


def fit_recording(
    recording: Recording,
    seed: int = 0,
    observe_config: ObserveConfig | None = None,
    fit_config: FitConfig | None = None,
    sources: Sources = "both",
) -> RecordingFit:
    """Mask, track, lift, segment, and fit the moving part's joint.

    Args:
        recording: the clip.
        seed: of whatever is sampled.
        observe_config: tuning of the way from images to tracks.
        fit_config: tuning of the estimator.
        sources: what enters the graph: tracks, the surfaces of keyframes (dense), or both.

    Raises:
        TracksLost: no object, or nothing on it could be followed.
        NoMotionObserved: nothing moved beyond the noise.
        AxisUnobservable: no moving kind can be fitted.
    """
    began = time.perf_counter()
    observed = observe_motion(recording, observe_config, np.random.default_rng(seed))
    seen = time.perf_counter()
    try:
        observed.segmentation.require_motion()
    except InsufficientData as error:
        raise type(error)(f"{recording.name}: {error}; expected a part that moves") from error
    config = fit_config or FitConfig()
    noise = (observe_config or ObserveConfig()).noise
    surface = PartSurface(recording, observed, noise, seed)
    posterior = fit_tracks(
        observed.moving_tracks,
        recording.name,
        seed=seed,
        config=config,
        systematic_m=config.camera_systematic_m,
        surface=surface if sources == "both" else None,
    )
    if sources == "dense":
        posterior = _surface_alone(posterior, observed, surface, config)
    now = time.perf_counter()
    times = {"total": now - began, "perception": seen - began, "fit": now - seen}
    return RecordingFit(observed, replace(posterior, time_s=times))


def _surface_alone(
    posterior: ArticulationPosterior,
    observed: ObservedMotion,
    surface: PartSurface,
    config: FitConfig,
) -> ArticulationPosterior:
    """The surface's own posterior; the tracks say where to start, and nothing more."""
    joint, states = posterior.best.joint, posterior.best.states
    if joint is None or states is None:
        return posterior
    frames = np.arange(states.mean.size)
    known = np.isfinite(states.mean)
    q = np.interp(frames, frames[known], states.mean[known])
    guess = JointGuess(joint.kind, joint.T_world_joint, q - q[0], joint.pitch_m_per_rad or 0.0)
    return fit_surface(
        surface,
        guess,
        np.nanmean(observed.moving_tracks.p_world[0], axis=0),
        observed.moving_tracks.select(np.zeros(0, dtype=int)),
        posterior.name,
        config,
        config.camera_systematic_m,
    )


def fit_input(
    data: FitInput, name: str, seed: int = 0, config: FitConfig | None = None
) -> ArticulationPosterior:
    """The posterior of any input of `akm-fg fit`.

    Raises:
        InsufficientData: the data are sound but do not suffice.
    """
    if isinstance(data, Recording):
        posterior = fit_recording(replace(data, name=name), seed, fit_config=config).posterior
    elif isinstance(data, TracksInput):
        posterior = fit_tracks(data.tracks, name, data.noise_known, seed, config)
    else:
        posterior = fit_poses(data, name, config)
    return posterior
