"""From tracks or poses of one part to a posterior over joint kind, joint frame and states.

tracks -> free rigid motion (inliers, noise, starts) -> one graph a kind -> evidence -> kind
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import cache

import numpy as np
from threadpoolctl import ThreadpoolController

from akm_fg.errors import TracksLost
from akm_fg.estimation.between_kinds.all_kinds import fit_in_steps, fit_kinds, with_late_sources
from akm_fg.estimation.between_kinds.biased_positions import biased_probability
from akm_fg.estimation.between_kinds.weighed_kinds import (
    Correlation,
    FittedKinds,
    silenced,
    weighed,
    with_sampled_joints,
)
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.path_problem import problem_of_path, problem_of_poses
from akm_fg.estimation.given.problem import (
    FitProblem,
    problem_of_surface,
    problem_of_tracks,
)
from akm_fg.estimation.given.surface_registration import Surface, register
from akm_fg.estimation.sources.source import FirstFit, Given
from akm_fg.estimation.sources.surface import SURFACE
from akm_fg.estimation.sources.track_noise import correlated_points, correlation_frames
from akm_fg.estimation.sources.tracks import TRACKS
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import FloatArray, PointTracks, PoseTrack
from akm_fg.steps import Steps, to_end
from factors.joint import JointKind


def fit_tracks(
    tracks: PointTracks,
    name: str = "tracks",
    noise_known: bool = True,
    seed: int = 0,
    config: FitConfig | None = None,
    systematic_m: float = 0.0,
    sources: Sequence[Given] = (),
) -> ArticulationPosterior:
    """Fit all joint kinds to tracked points of one part.

    Args:
        tracks: T frames, N points; points that do not belong to the part are found and dropped.
        name: of the input, for the result.
        noise_known: False when the covariances are only nominal and the level must be found.
        seed: of the consensus sampling.
        config: tuning.
        systematic_m: errors of the sensor that no averaging removes (standard deviation, each
            coordinate).
        sources: what else tells of the part (`akm_fg.estimation.sources`): static points, state
            knowledge, the gripper's poses, its surface (`SurfaceToRegister`).

    Raises:
        TracksLost: fewer than two frames, or too few tracks of one rigid part.
        AxisUnobservable: no moving kind can be fitted.
        ValueError: a source that is not over the T frames.
    """
    with one_blas_thread():
        steps = tracks_in_steps(tracks, name, noise_known, seed, config, systematic_m, sources)
        return _sampled(to_end(steps))


def tracks_in_steps(
    tracks: PointTracks,
    name: str,
    noise_known: bool = True,
    seed: int = 0,
    config: FitConfig | None = None,
    systematic_m: float = 0.0,
    sources: Sequence[Given] = (),
) -> Steps[FittedKinds]:
    """`fit_tracks` up to its solved graphs, with a pause after every piece of work."""
    config = config or FitConfig()
    began = time.perf_counter()
    usable = tracks.observed.sum(axis=0) >= 2
    if not usable.any():
        raise TracksLost(
            f"{name}: none of {usable.size} points is seen in two frames; "
            "expected at least one track of two frames"
        )
    tracks = tracks.select(usable)
    if usable.sum() < MIN_POINTS:
        problem = problem_of_path(name, tracks, noise_known, config)
    else:
        problem = problem_of_tracks(name, tracks, noise_known, seed, config)
    problem = replace(problem, members=np.flatnonzero(usable)[problem.members])
    yield
    return (yield from fit_in_steps(_knowing(problem, systematic_m, sources), began))


def fit_poses(
    poses: PoseTrack, name: str = "poses", config: FitConfig | None = None
) -> ArticulationPosterior:
    """Fit all joint kinds to poses (or positions) of one part; the noise level is estimated.

    Raises:
        TracksLost: fewer than two frames.
        AxisUnobservable: no moving kind can be fitted.
    """
    began = time.perf_counter()
    config = config or FitConfig()
    with one_blas_thread():
        fitted = to_end(fit_in_steps(problem_of_poses(name, poses, config), began))
        answer = _sampled(fitted)
        if answer.kind in ("rigid", "undecided"):
            return answer
        biased = biased_probability(fitted)
        p = 1.0 if biased is None else _moves_alike(answer.kind, biased)
        if p < config.undecided_below:
            return silenced(
                answer,
                f"were positions biased by {config.orientation_bias_share:g} times their noise, "
                f"as a tag's orientation is, {answer.kind} would have probability {p:.2f}",
            )
        if _moves_alike(answer.kind, answer.kind_probability) > config.beyond_doubt:
            return answer
        problem = problem_of_poses(name, poses, config.doubtful)
        solved = [fit.guess for fit in fitted.fits if fit.joint is not None]
        doubted = to_end(fit_in_steps(replace(problem, guesses=solved), began))
    p = _moves_alike(answer.kind, doubted.posterior.kind_probability)
    if p >= config.undecided_below:
        return answer
    return silenced(
        answer,
        f"were the systematic errors of the poses {config.doubt:g} times as large as supposed, "
        f"{answer.kind} would have probability {p:.2f}",
    )


def _moves_alike(named: str, probability: dict[str, float]) -> float:
    """Probability, under doubt, of kinds that turn as the named one does, or slide as it does."""
    turns = JointKind(named).turns
    return sum(
        p for kind, p in probability.items() if kind != "rigid" and JointKind(kind).turns == turns
    )


@cache
def _threads() -> ThreadpoolController:
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[object]:
    """Matrices of a hundred rows: more than one BLAS thread makes them ten times slower."""
    return _threads().limit(limits=1, user_api="blas")


def fit_surface(
    surface: Surface,
    guess: JointGuess,
    centroid_world: FloatArray,
    tracks: PointTracks,
    name: str = "surface",
    config: FitConfig | None = None,
    systematic_m: float = 0.0,
    sources: Sequence[Given] = (),
) -> ArticulationPosterior:
    """Fit all joint kinds to the surface of one part in keyframes, and to what tracks there are.

    States of frames that neither a track nor a keyframe sees are NaN.

    Args:
        surface: of the part.
        guess: a joint within the capture range of the registration (about 3 cm at the part).
        centroid_world: (3,) roughly the middle of the part at state zero.
        tracks: T frames of tracks of the part; N may be 0.
        name: of the input, for the result.
        config: tuning.
        systematic_m: see `fit_tracks`.
        sources: likewise.

    Raises:
        TracksLost: the surface is not seen again in enough places.
        AxisUnobservable: no moving kind can be fitted.
    """
    with one_blas_thread():
        steps = surface_in_steps(
            surface, guess, centroid_world, tracks, name, config, systematic_m, sources
        )
        return to_end(steps).posterior


def surface_in_steps(
    surface: Surface,
    guess: JointGuess,
    centroid_world: FloatArray,
    tracks: PointTracks,
    name: str,
    config: FitConfig | None = None,
    systematic_m: float = 0.0,
    sources: Sequence[Given] = (),
) -> Steps[FittedKinds]:
    """`fit_surface` up to its solved graphs, with a pause after every piece of work."""
    config = config or FitConfig()
    began = time.perf_counter()
    problem = problem_of_surface(name, tracks, guess, centroid_world, config)
    problem = _knowing(problem, systematic_m, sources)
    start = problem.guesses[0]
    known = {TRACKS: problem.tracks.first_scale, SURFACE: 1.0}
    first = FirstFit(start, np.zeros(start.q.size), known, as_one=1.0)
    alone = config.surface.keyframes_alone
    registered = yield from register(problem, first, surface, alone)
    if registered is None:
        raise TracksLost(
            f"{name}: the part's surface is not seen again in two keyframes; "
            f"expected at least {config.surface.min_patches} patches of it"
        )
    problem, _ = yield from with_late_sources(*registered)
    fits, warnings = yield from fit_kinds(problem)
    correlation = Correlation()
    if problem.tracks.any:
        said = max(fits, key=lambda fit: fit.log_likelihood).tracks
        correlation = Correlation(correlation_frames(said)[0], correlated_points(said))
    if correlation.as_one > 1.0:  # else the tracks weighed rightly beside the surface already
        problem = problem.counting(correlation.as_one)
        fits, warnings = yield from fit_kinds(problem)
    return weighed(fits, problem, correlation, warnings, began)


def _knowing(problem: FitProblem, systematic_m: float, sources: Sequence[Given]) -> FitProblem:
    tracks = replace(problem.tracks, systematic_m=systematic_m)
    return problem.with_source(tracks).knowing(sources)


def _sampled(fitted: FittedKinds) -> ArticulationPosterior:
    """With vague joints sampled; the time that takes included."""
    began = time.perf_counter()
    posterior = with_sampled_joints(fitted)
    total_s = fitted.posterior.time_s["total"] + time.perf_counter() - began
    return replace(posterior, time_s={"total": total_s})
