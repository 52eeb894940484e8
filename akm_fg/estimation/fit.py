"""From tracks or poses of one part to a posterior over joint kind, joint frame and states.

tracks -> free rigid motion (inliers, noise, starts) -> one graph a kind -> evidence -> kind
"""

from __future__ import annotations

import time
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import cache

import numpy as np
from threadpoolctl import ThreadpoolController

from akm_fg.errors import TracksLost
from akm_fg.estimation.between_kinds.all_kinds import fit_in_steps, fit_kinds, graph_problem
from akm_fg.estimation.between_kinds.evidence import correlated_points, correlation_frames
from akm_fg.estimation.between_kinds.weighed_kinds import weighed, with_sampled_joints
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.initial_guess import JointGuess
from akm_fg.estimation.given.knowledge import Knowledge
from akm_fg.estimation.given.problem import (
    NOMINAL_POSITION_M,
    FitProblem,
    problem_of_path,
    problem_of_surface,
    problem_of_tracks,
)
from akm_fg.estimation.given.surface_registration import SurfaceSource, register
from akm_fg.estimation.steps import to_end
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import FloatArray, PointTracks, PoseTrack


def fit_tracks(
    tracks: PointTracks,
    name: str = "tracks",
    noise_known: bool = True,
    seed: int = 0,
    config: FitConfig | None = None,
    systematic_m: float = 0.0,
    surface: SurfaceSource | None = None,
    knowledge: Knowledge | None = None,
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
        surface: dense views of the part in keyframes, registered in the same graph as the tracks.
        knowledge: what else is known: noise level, gripper, motion and limits of the states.

    Raises:
        TracksLost: fewer than two frames, or too few tracks of one rigid part.
        AxisUnobservable: no moving kind can be fitted.
        ValueError: knowledge that is not over the T frames.
    """
    config = config or FitConfig()
    began = time.perf_counter()
    usable = tracks.observed.sum(axis=0) >= 2
    if not usable.any():
        raise TracksLost(
            f"{name}: none of {usable.size} points is seen in two frames; "
            "expected at least one track of two frames"
        )
    tracks = tracks.select(usable)
    with one_blas_thread():
        if usable.sum() < MIN_POINTS:
            problem = problem_of_path(name, tracks, None, noise_known, config)
        else:
            problem = problem_of_tracks(name, tracks, noise_known, seed, config)
        problem = replace(problem, systematic_m=systematic_m).knowing(knowledge)
        return _fit(problem, began, surface)


def fit_poses(
    poses: PoseTrack, name: str = "poses", config: FitConfig | None = None
) -> ArticulationPosterior:
    """Fit all joint kinds to poses (or positions) of one part; the noise level is estimated.

    Raises:
        TracksLost: fewer than two frames.
        AxisUnobservable: no moving kind can be fitted.
    """
    began = time.perf_counter()
    p_world = poses.p_world[:, None, :]
    if p_world.shape[0] < 2:
        raise TracksLost(f"{name}: one frame only; expected at least two")
    cov = np.broadcast_to(np.eye(3) * NOMINAL_POSITION_M**2, (*p_world.shape, 3))
    tracks = PointTracks(p_world, cov)
    with one_blas_thread():
        problem = problem_of_path(name, tracks, poses.R_world_part, False, config or FitConfig())
        return _fit(problem, began)


@cache
def _threads() -> ThreadpoolController:
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[object]:
    """Matrices of a hundred rows: more than one BLAS thread makes them ten times slower."""
    return _threads().limit(limits=1, user_api="blas")


def fit_surface(
    surface: SurfaceSource,
    guess: JointGuess,
    centroid_world: FloatArray,
    tracks: PointTracks,
    name: str = "surface",
    config: FitConfig | None = None,
    systematic_m: float = 0.0,
    knowledge: Knowledge | None = None,
) -> ArticulationPosterior:
    """Fit all joint kinds to the surface of one part in keyframes, and to what tracks there are.

    States of frames that neither a track nor a keyframe sees are NaN.

    Args:
        surface: dense views of the part in keyframes.
        guess: a joint within the capture range of the registration (about 3 cm at the part).
        centroid_world: (3,) roughly the middle of the part at state zero.
        tracks: T frames of tracks of the part; N may be 0.
        name: of the input, for the result.
        config: tuning.
        systematic_m: see `fit_tracks`.
        knowledge: likewise.

    Raises:
        TracksLost: the surface is not seen again in enough places.
        AxisUnobservable: no moving kind can be fitted.
    """
    config = config or FitConfig()
    began = time.perf_counter()
    with one_blas_thread():
        problem = problem_of_surface(name, tracks, guess, centroid_world, config)
        problem = replace(problem, systematic_m=systematic_m).knowing(knowledge)
        registration = register(problem, problem.guesses[0], problem.start, surface, 1.0)
        if registration is None:
            raise TracksLost(
                f"{name}: the part's surface is not seen again in two keyframes; "
                f"expected at least {config.dense.min_patches} patches of it"
            )
        problem = registration.problem.holding(registration.guess, None, 1.0)
        fits, warnings = to_end(fit_kinds(problem, graph_problem(problem)))
        correlation = (1.0, 1.0)
        if problem.has_tracks:
            likeliest = max(fits, key=lambda fit: fit.log_likelihood)
            tau, _ = correlation_frames(likeliest, problem.observations)
            correlation = tau, correlated_points(likeliest, problem.observations)
        as_one = correlation[0] * correlation[1]
        if as_one > 1.0:  # otherwise the tracks weighed rightly beside the surface already
            problem = problem.counting(as_one)
            fits, warnings = to_end(fit_kinds(problem, graph_problem(problem)))
        return weighed(fits, problem, correlation, warnings, began).posterior


def _fit(
    problem: FitProblem, began: float, surface: SurfaceSource | None = None
) -> ArticulationPosterior:
    posterior = with_sampled_joints(to_end(fit_in_steps(problem, began, surface)))
    return replace(posterior, time_s={"total": time.perf_counter() - began})
