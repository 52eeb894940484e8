"""States of the frames that are not in the graph, given the solved joint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.lasting_modes import observations_of
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.records import FloatArray, PointTracks
from factors.measurements.track_cost import TrackObservations
from factors.measurements.track_information import state_step

_ITERATIONS = 10
_SETTLED = 1e-4  # squared step in units of the state's variance that is the last


def states_of_all_frames(
    fit: KindFit, points: PointTracks, keyframes: NDArray[np.int_], config: FitConfig
) -> tuple[FloatArray, FloatArray]:
    """States and standard deviations (T,) of all frames; NaN where too little was seen.

    A frame outside the graph is solved for its state alone, joint and reference points held. Its
    variance is its own noise plus what joint and reference points add; the latter is a smooth
    function of the state, read off the keyframes on either side.

    Args:
        fit: the solved kind, over the keyframes.
        points: all T frames of the fitted tracks.
        keyframes: (K,) frames of the graph.
        config: tuning.
    """
    T = points.p_world.shape[0]
    mean, sd = np.full(T, np.nan), np.full(T, np.nan)
    mean[keyframes], sd[keyframes] = fit.q, fit.state_sd
    # Two tracks that follow something else agree with each other in any state: nothing tells.
    enough = min(MIN_POINTS, points.observed.shape[1])
    seen = np.asarray(points.observed.sum(axis=1) >= max(enough, 1))
    seen[keyframes] = False
    others = np.flatnonzero(seen)
    if others.size == 0 or fit.joint is None:
        return mean, sd
    slips = fit.tracks.slips
    none = np.zeros(0, dtype=int)
    which = none if slips is None else slips.tracks
    tracks, inside = (observations_of(points.at(f), which) for f in (others, keyframes))
    q, information = solved_states(fit, tracks, np.interp(others, keyframes, fit.q), config)
    model = model_variance(fit, inside, config)
    mean[others], sd[others] = q, state_sd_beside(fit, q, information, model)
    return mean, sd


def solved_states(
    fit: KindFit, tracks: TrackObservations, q: FloatArray, config: FitConfig
) -> tuple[FloatArray, FloatArray]:
    """States (T,) and the information on them, joint and reference points held.

    Args:
        fit: the solved kind.
        tracks: T frames of its tracks.
        q: (T,) where to start.
        config: tuning.
    """
    information = np.zeros_like(q)
    for _ in range(_ITERATIONS):
        step, information = _state_step(fit, tracks, q, config)
        q = q + step
        if (step**2 * information < _SETTLED).all():
            break
    return q, information


def state_sd_beside(
    fit: KindFit, q: FloatArray, information: FloatArray, model: FloatArray
) -> FloatArray:
    """Standard deviations (M,) of states that were solved beside the graph's K frames.

    Args:
        fit: the solved kind, over the keyframes.
        q: (M,) states.
        information: (M,) on them, from `solved_states`.
        model: (K - 1,) from `model_variance`.
    """
    known = 1 + np.flatnonzero(np.isfinite(model))
    order = known[np.argsort(fit.q[known])]
    beyond = np.interp(q, fit.q[order], model[order - 1]) if order.size else 0.0
    sd: FloatArray = np.sqrt(fit.track_variance_ratio / information + beyond)
    return sd


def model_variance(fit: KindFit, keyframes: TrackObservations, config: FitConfig) -> FloatArray:
    """Variance of the keyframes' states (K - 1,) beyond their own frame's noise.

    Frame 0 is left out: its state is zero by definition, without variance. NaN in frames that no
    track sees: what their states are known by is not noise of a frame's tracks.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        _, information = _state_step(fit, keyframes, fit.q, config)
    information = np.where(keyframes.observed.any(axis=1), information, np.nan)
    return np.maximum(fit.state_sd[1:] ** 2 - fit.track_variance_ratio / information[1:], 0.0)


def _state_step(
    fit: KindFit, tracks: TrackObservations, q: FloatArray, config: FitConfig
) -> tuple[FloatArray, FloatArray]:
    said = fit.tracks
    return state_step(fit.moving, q, said.x_joint, tracks, config.dof, said.scale, said.slips)
