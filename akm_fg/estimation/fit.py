"""From tracks or poses of one part to a posterior over joint kind, joint frame and states.

    tracks -> free rigid motion (inliers, noise, starts) -> one graph a kind -> evidence -> kind
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from akm_fg.errors import AxisUnobservable, InsufficientData, TracksLost
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.evidence import (
    correlation_frames,
    is_parametric,
    kind_probabilities,
    temper,
)
from akm_fg.estimation.initial_guess import JointGuess, guesses_from_motion, guesses_from_path
from akm_fg.estimation.joint_graph import (
    KindFit,
    Observations,
    Scales,
    fit_kind,
    fit_rigid,
    guess_cost,
)
from akm_fg.estimation.path import local_noise, select_keyframes
from akm_fg.estimation.posterior import (
    ArticulationPosterior,
    FitReport,
    JointPosterior,
    KindPosterior,
    StatePosterior,
)
from akm_fg.estimation.rigid_motion import MIN_POINTS, free_rigid_motion
from akm_fg.estimation.states import states_of_all_frames
from akm_fg.records import BoolArray, FloatArray, PointTracks, PoseTrack
from factors.gauge import GAUGE_NAMES
from factors.point_track import TrackObservations

# Pose logs come without a noise level: observations are whitened by these and scaled by the fit.
_NOMINAL_POSITION_M = 1e-3
_START_ORIENTATION_RAD = 0.02


@dataclass(frozen=True, slots=True)
class _Problem:
    """Everything that the kinds share."""

    name: str
    points: PointTracks  # (T, N) all frames, inlier tracks
    R_world_part: FloatArray | None  # (T, 3, 3)
    keyframes: FloatArray  # (K,) indices of the frames in the graph; the first is the reference
    guesses: list[JointGuess]  # over all frames
    centroid_world: FloatArray  # (3,) of the points at the reference frame
    lever_m: float
    start: Scales
    noise_known: bool
    local_scale: float  # noise that no joint is needed to see, in given standard deviations
    min_scale: float  # systematic errors of a path, in given standard deviations
    travel_m: float
    tracks_rejected: int


def fit_tracks(
    tracks: PointTracks,
    name: str = "tracks",
    noise_known: bool = True,
    seed: int = 0,
    config: FitConfig | None = None,
) -> ArticulationPosterior:
    """Fit all joint kinds to tracked points of one part.

    Args:
        tracks: T frames, N points; points that do not belong to the part are found and dropped.
        name: of the input, for the result.
        noise_known: False when the covariances are only nominal and the level must be found.
        seed: of the consensus sampling.
        config: tuning.

    Raises:
        TracksLost: fewer than two frames, or no track seen in two of them.
        AxisUnobservable: no kind can be fitted.
    """
    config = config or FitConfig()
    began = time.perf_counter()
    usable = tracks.observed.sum(axis=0) >= 2
    if not usable.any() or tracks.p_world.shape[0] < 2:
        raise TracksLost(f"{name}: no point is seen in two frames; expected at least one track")
    tracks = tracks.select(usable)
    if tracks.p_world.shape[1] < MIN_POINTS:
        problem = _problem_of_path(name, tracks, None, noise_known, config)
        return _fit(problem, began, _for_paths(config))
    return _fit(_problem_of_tracks(name, tracks, noise_known, seed, config), began, config)


def fit_poses(
    poses: PoseTrack, name: str = "poses", config: FitConfig | None = None
) -> ArticulationPosterior:
    """Fit all joint kinds to poses (or positions) of one part; the noise level is estimated.

    Raises:
        TracksLost: fewer than two frames.
        AxisUnobservable: no kind can be fitted.
    """
    config = config or FitConfig()
    began = time.perf_counter()
    p = poses.p_world[:, None, :]
    if p.shape[0] < 2:
        raise TracksLost(f"{name}: one frame only; expected at least two")
    cov = np.broadcast_to(np.eye(3) * _NOMINAL_POSITION_M**2, (*p.shape, 3)).copy()
    problem = _problem_of_path(name, PointTracks(p, cov), poses.R_world_part, False, config)
    return _fit(problem, began, _for_paths(config))


def _for_paths(config: FitConfig) -> FitConfig:
    """A single marker sits on the handle, not in the middle of the part."""
    prior = replace(config.prior, hinge_distance_m=config.prior.handle_distance_m)
    return replace(config, prior=prior)


def _problem_of_tracks(
    name: str, tracks: PointTracks, noise_known: bool, seed: int, config: FitConfig
) -> _Problem:
    motion = free_rigid_motion(tracks, np.random.default_rng(seed), config.rigid_motion)
    if motion.inlier.sum() < MIN_POINTS:
        raise TracksLost(
            f"{name}: {int(motion.inlier.sum())} of {motion.inlier.size} tracks move as one rigid "
            f"part; expected at least {MIN_POINTS}"
        )
    shape = motion.shape_world[motion.inlier]
    first = motion.R_world[0] @ shape.T + motion.t_world[0][:, None]
    centroid = first.mean(axis=1)
    path = (motion.R_world @ shape.mean(axis=0) + motion.t_world)[motion.known]
    lever = float(np.sqrt(((shape - shape.mean(axis=0)) ** 2).sum(axis=1).mean()))
    moved = motion.R_world @ shape.T + motion.t_world[:, :, None]
    spread = np.linalg.norm(moved[motion.known] - first, axis=1)
    keyframes = select_keyframes(path, np.flatnonzero(motion.known), config.max_frames)
    return _Problem(
        name=name,
        points=tracks.select(motion.inlier),
        R_world_part=None,
        keyframes=keyframes,
        guesses=guesses_from_motion(motion),
        centroid_world=centroid,
        lever_m=lever,
        start=Scales(motion.scale, _START_ORIENTATION_RAD),
        noise_known=noise_known,
        local_scale=motion.scale,
        min_scale=0.0,
        travel_m=float(spread.max()),
        tracks_rejected=int((~motion.inlier).sum()),
    )


def _problem_of_path(
    name: str,
    tracks: PointTracks,
    R_world_part: FloatArray | None,
    noise_known: bool,
    config: FitConfig,
) -> _Problem:
    """One or two points: no rigid motion to be had from them, only paths."""
    path = np.nanmean(tracks.p_world, axis=1)
    known = np.isfinite(path).all(axis=1)
    sigma = float(np.sqrt(np.nanmedian(tracks.cov_world[..., range(3), range(3)])))
    noise = local_noise(path[known]) / sigma
    first = path[known][0]
    travel = float(np.linalg.norm(path[known] - first, axis=1).max())
    return _Problem(
        name=name,
        points=tracks,
        R_world_part=R_world_part,
        keyframes=select_keyframes(path[known], np.flatnonzero(known), config.max_frames),
        guesses=guesses_from_path(path, known),
        centroid_world=first,
        lever_m=0.0,
        start=Scales(max(noise, 1e-3), _START_ORIENTATION_RAD),
        noise_known=noise_known,
        local_scale=max(noise, 1.0 if noise_known else 0.0),
        min_scale=0.0 if noise_known else config.systematic_share * travel / sigma,
        travel_m=travel,
        tracks_rejected=0,
    )


def _fit(problem: _Problem, began: float, config: FitConfig) -> ArticulationPosterior:
    k = problem.keyframes
    R = problem.R_world_part
    seen = problem.points.observed[k].any(axis=0)
    starts = [replace(g, q=g.q[k] - g.q[k[0]]) for g in problem.guesses]
    points = problem.points.select(seen)
    observations = Observations(
        TrackObservations.from_points(points.p_world[k], points.cov_world[k]),
        None if R is None else R[k],
        problem.noise_known,
        problem.min_scale,
    )
    fits, warnings = _fit_kinds(problem, starts, observations, config)
    likeliest = max(fits, key=lambda fit: fit.log_likelihood)
    tau, visible = correlation_frames(likeliest, observations)
    if visible < 1.0:
        observations = replace(observations, visible_share=visible)
        solved = [JointGuess(f.kind, f.T_world_joint, f.q) for f in fits if f.T_world_joint is not None]
        fits, _ = _fit_kinds(problem, solved, observations, config)
    fits = [temper(fit, tau) for fit in fits]
    fits = [_pointing_forward(fit) for fit in fits]
    probability = kind_probabilities(fits, config.prior)
    best = max(fits, key=lambda fit: probability[fit.kind])
    parametric = is_parametric(best, observations, problem.local_scale, problem.travel_m, tau, config)
    decided = parametric and probability[best.kind] >= config.undecided_below
    return ArticulationPosterior(
        name=problem.name,
        kind=best.kind if decided else "undecided",  # type: ignore[arg-type]
        kind_probability=probability,
        alternatives={
            fit.kind: _kind_posterior(fit, points, R, k, observations) for fit in fits
        },
        fit=_report(best, problem, observations, tau, parametric, tuple(warnings)),
        time_s={"total": time.perf_counter() - began},
    )


def _fit_kinds(
    problem: _Problem, guesses: list[JointGuess], observations: Observations, config: FitConfig
) -> tuple[list[KindFit], list[str]]:
    """Every kind that can be fitted, and why the others cannot."""
    fits = [fit_rigid(observations, problem.start, config)]
    warnings = []
    for kind in ("prismatic", "revolute"):
        try:
            fits.append(_best_start(kind, problem, guesses, observations, config))
        except AxisUnobservable as error:
            warnings.append(str(error))
    if len(fits) == 1:
        raise InsufficientData(f"{problem.name}: " + "; ".join(warnings))
    return fits, warnings


def _best_start(
    kind: str,
    problem: _Problem,
    guesses: list[JointGuess],
    observations: Observations,
    config: FitConfig,
) -> KindFit:
    starts = [guess for guess in guesses if guess.kind == kind]
    starts.sort(key=lambda guess: guess_cost(guess, observations, problem.start, config))
    fits = []
    # Paths of one point have several bends to choose from; whole parts have one screw.
    for guess in starts[: 1 if problem.lever_m else 2]:
        fits.append(
            fit_kind(
                observations, guess, problem.centroid_world, problem.lever_m, problem.start, config
            )
        )
    return max(fits, key=lambda fit: fit.log_evidence)


def _pointing_forward(fit: KindFit) -> KindFit:
    """The same joint with its axis along growing states."""
    if fit.T_world_joint is None or fit.q.mean() >= 0:
        return fit
    half_turn = np.diag([1.0, -1.0, -1.0])  # about x of the joint
    T = fit.T_world_joint.copy()
    T[:3, :3] = T[:3, :3] @ half_turn
    signs = np.ones(fit.cov.shape[0])
    turned = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
    signs[: len(fit.joint_directions)] = turned[list(fit.joint_directions)]
    signs[-(fit.q.size - 1) :] = -1
    return replace(fit, T_world_joint=T, q=-fit.q, cov=fit.cov * np.outer(signs, signs))


def _kind_posterior(
    fit: KindFit,
    points: PointTracks,
    R_world_part: FloatArray | None,
    keyframes: FloatArray,
    observations: Observations,
) -> KindPosterior:
    if fit.T_world_joint is None:
        return KindPosterior(None, None, fit.log_evidence)
    mean, sd = states_of_all_frames(fit, points, keyframes, observations)
    joint = JointPosterior(
        kind=fit.kind,  # type: ignore[arg-type]
        T_world_joint=fit.T_world_joint,
        cov=fit.joint_cov,
        gauge=GAUGE_NAMES[fit.kind],
    )
    unit = "rad" if fit.kind == "revolute" else "m"
    return KindPosterior(joint, StatePosterior(unit, mean, sd), fit.log_evidence)


def _report(
    best: KindFit,
    problem: _Problem,
    observations: Observations,
    tau: float,
    parametric: bool,
    warnings: tuple[str, ...],
) -> FitReport:
    observed: BoolArray = observations.tracks.observed
    error2 = best.squared_error_m2[observed]
    scale = best.scales.track * (1.0 if problem.noise_known else _NOMINAL_POSITION_M)
    return FitReport(
        log_evidence=best.log_evidence,
        tracks_used=int(observed.any(axis=0).sum()),
        tracks_rejected=problem.tracks_rejected,
        rms_m=float(np.sqrt(error2.mean())),
        noise_scale=scale,
        correlation_frames=tau,
        parametric=parametric,
        warnings=warnings,
    )
