"""The whole way of one input: recording, tracks or poses to a posterior."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from akm_fg.errors import InsufficientData
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_poses, fit_tracks
from akm_fg.estimation.posterior import ArticulationPosterior
from akm_fg.io.inputs import FitInput
from akm_fg.io.tracks import TracksInput
from akm_fg.perception.observe import ObserveConfig, ObservedMotion, observe_motion
from akm_fg.records import Recording


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
) -> RecordingFit:
    """Mask, track, lift, segment, and fit the moving part's joint.

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
    posterior = fit_tracks(
        observed.moving_tracks,
        recording.name,
        seed=seed,
        config=config,
        systematic_m=config.camera_systematic_m,
    )
    now = time.perf_counter()
    times = {"total": now - began, "perception": seen - began, "fit": now - seen}
    return RecordingFit(observed, replace(posterior, time_s=times))


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
