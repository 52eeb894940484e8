"""Preparing a fit of one marker: its path, or its poses. No joint kind is assumed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import NoMotionObserved, TracksLost
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.guesses import guesses_from_path, hinges_of_motions
from akm_fg.estimation.given.jumps import jumping_rows
from akm_fg.estimation.given.path import local_noise, select_keyframes
from akm_fg.estimation.given.problem import NOMINAL_POSITION_M, FitProblem, Noise, assembled
from akm_fg.estimation.sources.orientations import OrientationSource
from akm_fg.estimation.sources.slow_errors import SlowErrors, slow_correlations
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import FloatArray, PointTracks, PoseTrack
from factors.measurements.orientation_track import log_so3
from factors.motion_information import motion_information

_LEAST_RAD = 1e-4  # of independent orientation noise: printed quaternions are rounded


def problem_of_poses(name: str, poses: PoseTrack, config: FitConfig) -> FitProblem:
    """A marker's poses, or its positions alone; rows that jump are left out.

    Raises:
        TracksLost: fewer than two frames are left.
    """
    known = np.isfinite(poses.p_world).all(axis=1)
    if poses.R_world_part is not None:
        known &= np.isfinite(poses.R_world_part).all(axis=(1, 2))
    jumps = jumping_rows(poses)
    if (known & ~jumps).sum() < 2:
        raise TracksLost(f"{name}: one frame only; expected at least two")
    p_world = np.where((known & ~jumps)[:, None], poses.p_world, np.nan)[:, None]
    cov = np.broadcast_to(np.eye(3) * NOMINAL_POSITION_M**2, (*p_world.shape, 3))
    problem = problem_of_path(name, PointTracks(p_world, cov), False, config)
    problem = replace(problem, rows_left_out=int(jumps.sum()))
    if poses.R_world_part is None:
        return problem
    return _with_orientations(problem, poses, known & ~jumps)


def problem_of_path(
    name: str, tracks: PointTracks, noise_known: bool, config: FitConfig
) -> FitProblem:
    """One or two points: no rigid motion to be had from them, only a path.

    Args:
        name: of the input.
        tracks: T frames, one or two points.
        noise_known: whether the covariances are more than nominal.
        config: tuning.

    Raises:
        NoMotionObserved: all positions are the same.
    """
    seen = np.asarray(tracks.observed.any(axis=1))
    path = np.full((seen.size, 3), np.nan)
    path[seen] = np.nanmean(tracks.p_world[seen], axis=1)
    known = np.flatnonzero(seen)
    new = known[_new_rows(path[known])]
    variances = tracks.cov_world[tracks.observed][:, range(3), range(3)]
    sigma_m = float(np.sqrt(np.median(variances)))
    noise = local_noise(path[known]) / sigma_m
    travel_m = float(np.linalg.norm(path[known] - path[known[0]], axis=1).max())
    if travel_m == 0.0:
        raise NoMotionObserved(f"{name}: all {known.size} positions are the same; expected a path")
    systematic = 0.0 if noise_known else config.systematic_share * travel_m / sigma_m
    # A single marker sits on the handle, not in the middle of the part.
    prior = replace(config.prior, hinge_distance_m=config.prior.handle_distance_m)
    problem = assembled(
        name=name,
        points=tracks,
        keyframes=select_keyframes(path[new], new, config.max_frames),
        R_world=np.tile(np.eye(3), (seen.size, 1, 1)),
        guesses=guesses_from_path(path, seen),
        noise=Noise(noise_known, max(noise, 1e-3), max(noise, float(noise_known)), systematic),
        centroid_world=path[known[0]],
        lever_m=0.0,
        travel_m=travel_m,
        tracks_rejected=0,
        config=replace(config, prior=prior),
    )
    return replace(problem, marker=True)


def _with_orientations(problem: FitProblem, poses: PoseTrack, known: NDArray) -> FitProblem:
    """With the orientations, the motions that the poses show, and the hinges that explain those."""
    R_world_part, config = poses.R_world_part, problem.config
    assert R_world_part is not None
    rows, k = np.flatnonzero(known), problem.keyframes
    sigma = max(local_noise(_turns(R_world_part[rows])), _LEAST_RAD)
    errors = SlowErrors(
        slow_correlations(poses.p_world[k], R_world_part[k]),
        sigma,
        max(config.orientation_systematic_rad, config.orientation_bias_share * sigma),
    )
    source = OrientationSource(R_world_part[k], errors, config)
    problem = problem.with_source(source)
    R = R_world_part @ R_world_part[k[0]].T
    p = poses.p_world
    t = p - np.einsum("tij,j->ti", R, p[k[0]])
    hinges = [
        JointGuess(guess.joint, guess.q[k] - guess.q[k[0]])
        for guess in hinges_of_motions(R, t, p, known)
    ]
    tracks = problem.tracks
    scale = float(np.hypot(tracks.first_scale, tracks.min_scale))
    motions = motion_information(R[k], t[k], tracks.observations, config.dof, scale)
    information = motions.information + _of_turns(k.size, source.typical_rad)
    return replace(
        problem,
        guesses=[*problem.guesses, *hinges],
        motions=replace(motions, information=information),
    )


def _new_rows(path: FloatArray) -> NDArray[np.int_]:
    """Rows of a path (K, 3) that do not repeat the one before to the last digit; two at least.

    A log that is written faster than it is measured repeats itself; that is no new measurement.
    """
    new = np.append(True, np.any(np.diff(path, axis=0) != 0, axis=1))
    new[-1] = True
    return np.flatnonzero(new)


def _turns(R: FloatArray) -> FloatArray:
    """Rotation vectors (T, 3), radians, summed from row to row: a path whose noise is that of R."""
    steps = log_so3(R[:-1].swapaxes(1, 2) @ R[1:])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def _of_turns(frames: int, sigma_rad: float) -> FloatArray:
    """Information (6 T, 6 T) of measured orientations on the motions, their reference marginal."""
    over_frames = (np.eye(frames) - 1 / frames) / sigma_rad**2
    about = np.zeros((6, 6))
    about[:3, :3] = np.eye(3)
    return np.asarray(np.kron(over_frames, about))
