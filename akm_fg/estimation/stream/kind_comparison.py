"""All kinds fitted to a stream's keyframes of one moment, in steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import TracksLost
from akm_fg.estimation.between_kinds.all_kinds import fit_in_steps
from akm_fg.estimation.between_kinds.weighed_kinds import FittedKinds
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.problem import problem_of_tracks
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.posterior import ArticulationPosterior, KindPosterior
from akm_fg.records import FloatArray, PointTracks
from akm_fg.steps import Steps, every
from factors.measurements.track_cost import TrackObservations
from factors.measurements.track_information import state_step


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """What every fit to a stream shares; see `fit_tracks`."""

    name: str
    noise_known: bool
    seed: int
    systematic_m: float
    config: FitConfig
    pieces_together: int  # of comparing, without a pause


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A stream's keyframes at one moment."""

    tracks: PointTracks  # K keyframes
    ids: NDArray[np.int_]  # (N,) of the tracks
    numbers: NDArray[np.int_]  # (K,) of the frames
    counts: NDArray[np.int_]  # (K,) frames pooled into each
    version: int


Compare: TypeAlias = "Callable[[bool], Steps[Comparison]]"
"""Whether a kind leads already -> all kinds, fitted in steps to what is known when it begins."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """All kinds, fitted to a snapshot."""

    fitted: FittedKinds
    ids: NDArray[np.int_]  # (M,) of the part's tracks
    numbers: NDArray[np.int_]  # (K,) of the graph's frames
    counts: NDArray[np.int_]  # (K,)
    version: int | None  # of the snapshot, if it was one
    whole: bool = True  # False: by a part of what is known; it may lead, but names no kind

    def posterior(self) -> ArticulationPosterior:
        """The answer, with the states of pooled keyframes as uncertain as they are.

        The graph takes their own noise for that of a mean of `counts` frames; it is that of one.
        """
        problem, posterior = self.fitted.problem, self.fitted.posterior
        alternatives = dict(posterior.alternatives)
        for fit in self.fitted.fits:
            kind = alternatives[fit.kind]
            if kind.states is None:
                continue
            sd = kind.states.sd.copy()
            own = _own_variance(fit, problem.tracks.observations, problem.config.dof)
            sd[problem.keyframes] = np.sqrt(sd[problem.keyframes] ** 2 + (self.counts - 1) * own)
            states = replace(kind.states, sd=sd)
            alternatives[fit.kind] = KindPosterior(kind.joint, states, kind.evidence)
        return replace(posterior, alternatives=alternatives)


def compare_kinds(snapshot: Snapshot, settings: StreamSettings) -> Steps[Comparison]:
    """Fit all kinds to the keyframes as `fit_tracks` does, with a pause after every piece of work.

    Raises:
        TracksLost: fewer than two frames, or too few tracks of one rigid part.
        AxisUnobservable: no moving kind can be fitted.
    """
    began = time.perf_counter()
    usable = np.flatnonzero(snapshot.tracks.observed.sum(axis=0) >= 2)
    if usable.size < MIN_POINTS:
        raise TracksLost(
            f"{settings.name}: {usable.size} tracks are seen in two of {snapshot.numbers.size} "
            f"keyframes; expected at least {MIN_POINTS}"
        )
    tracks, config = snapshot.tracks.select(usable), settings.config
    problem = problem_of_tracks(settings.name, tracks, settings.noise_known, settings.seed, config)
    yield
    source = replace(problem.tracks, systematic_m=settings.systematic_m)
    problem = problem.with_source(source)
    fitted = yield from every(settings.pieces_together, fit_in_steps(problem, began))
    k = problem.keyframes
    return Comparison(
        fitted,
        snapshot.ids[usable][problem.members],
        snapshot.numbers[k],
        snapshot.counts[k],
        snapshot.version,
    )


def _own_variance(fit: KindFit, tracks: TrackObservations, dof: float) -> FloatArray:
    """Variance (K,) that the keyframes' own noise gives their states, by the graph."""
    said = fit.tracks
    _, information = state_step(
        fit.moving, fit.q, said.x_joint, tracks, dof, said.scale, said.slips
    )
    return fit.track_variance_ratio / information
