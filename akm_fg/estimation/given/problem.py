"""Preparing a fit: which tracks, frames and starts, how noisy. No joint kind is assumed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import TracksLost
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.initial_guess import (
    JointGuess,
    drawer_along,
    guesses_from_motion,
    guesses_from_path,
)
from akm_fg.estimation.given.knowledge import Knowledge
from akm_fg.estimation.given.observations import (
    T_OVER_NORMAL,
    Observations,
    Scales,
    updated_scales,
)
from akm_fg.estimation.given.path import local_noise, select_keyframes
from akm_fg.estimation.sources.gripper import holds_of
from akm_fg.geometry.rigid_motion import MIN_POINTS, RigidMotion, free_rigid_motion
from akm_fg.records import FloatArray, PointTracks
from factors.joint_motion import part_motion
from factors.measurements.track_cost import TrackObservations
from factors.motion_information import MotionInformation, latent_points, motion_information

# Pose logs come without a noise level: observations are whitened by these and scaled by the fit.
NOMINAL_POSITION_M = 1e-3
_START_ORIENTATION_RAD = 0.02
_FREE_SCALE_ITERATIONS = 2  # from a median within a tenth to the graph's own level


@dataclass(frozen=True, slots=True)
class FitProblem:
    """Everything that the kinds share."""

    name: str
    points: PointTracks  # all T frames of the tracks that count
    keyframes: NDArray[np.int_]  # (K,) frames in the graph; the first is where the state is zero
    observations: Observations  # the keyframes'
    guesses: list[JointGuess]  # over the keyframes
    centroid_world: FloatArray  # (3,) of the points in the first keyframe
    lever_m: float  # root mean square size of the points about it
    start: Scales
    local_scale: float  # noise that no joint is needed to see, in given standard deviations
    travel_m: float
    tracks_rejected: int
    config: FitConfig
    motions: MotionInformation | None  # free motions over the keyframes; None for a path
    systematic_m: float = 0.0  # errors of the tracks that no averaging removes
    members: NDArray[np.int_] | None = None  # (N,) which of the given tracks count; None: all
    knowledge: Knowledge = field(default_factory=Knowledge)  # over the T frames

    def knowing(self, knowledge: Knowledge | None) -> FitProblem:
        """The problem with what else is known.

        Raises:
            ValueError: that is not over its frames.
        """
        if knowledge is None:
            return self
        knowledge.check(self.points.p_world.shape[0])
        observations = replace(self.observations, noise_level=knowledge.noise_level)
        return replace(self, knowledge=knowledge, observations=observations)

    def holding(self, guess: JointGuess, state_sd: FloatArray | None, as_one: float) -> FitProblem:
        """The problem with the gripper's holds, if any, judged by a fitted joint."""
        gripper = self.knowledge.gripper
        if gripper is None:
            return self
        sd = np.zeros_like(guess.q) if state_sd is None else state_sd
        grasp = holds_of(gripper, self.keyframes, guess, sd, as_one)
        if grasp is None:
            return self
        return replace(self, observations=replace(self.observations, grasp=grasp))

    def counting(self, as_one: float) -> FitProblem:
        """The problem with the others weighed for tracks of which so many count as one."""
        dense, grasp = self.observations.dense, self.observations.grasp
        if dense is not None:
            dense = replace(dense, count_as_one=max(dense.count_as_one / as_one, 1e-3))
        if grasp is not None:
            grasp = replace(grasp, count_as_one=grasp.count_as_one / as_one)
        return replace(self, observations=replace(self.observations, dense=dense, grasp=grasp))

    @property
    def holds(self) -> tuple[tuple[int, int], ...]:
        """First and last frame of each hold in the graph."""
        grasp = self.observations.grasp
        holds = () if grasp is None else grasp.holds
        ends = (self.keyframes[hold.frames[[0, -1]]] for hold in holds)
        return tuple((int(first), int(last)) for first, last in ends)

    @property
    def has_tracks(self) -> bool:
        """Whether any point track counts."""
        return self.observations.tracks.observed.shape[1] > 0


def problem_of_tracks(
    name: str, tracks: PointTracks, noise_known: bool, seed: int, config: FitConfig
) -> FitProblem:
    """Three or more tracks: free rigid motions tell members, noise and starts.

    Raises:
        TracksLost: too few tracks move as one rigid part.
    """
    motion = free_rigid_motion(tracks, np.random.default_rng(seed), config.rigid_motion)
    inliers = int(motion.inlier.sum())
    if inliers < MIN_POINTS or motion.known.sum() < 2:
        raise TracksLost(
            f"{name}: {inliers} of {motion.inlier.size} tracks move as one rigid part, in "
            f"{int(motion.known.sum())} frames; expected at least {MIN_POINTS} tracks in 2 frames"
        )
    shape = motion.shape_world[motion.inlier]
    moved = motion.R_world @ shape.T + motion.t_world[:, :, None]  # (T, 3, N)
    known = np.flatnonzero(motion.known)
    first = moved[known[0]]
    keyframes = select_keyframes(moved[known].mean(axis=2), known, config.max_frames)
    problem = _problem(
        name=name,
        points=tracks.select(motion.inlier),
        R_world_part=None,
        keyframes=keyframes,
        guesses=guesses_from_motion(motion),
        noise=(
            noise_known,
            T_OVER_NORMAL * motion.scale,
            max(motion.scale, float(noise_known)),
            0.0,
        ),
        centroid_world=first.mean(axis=1),
        lever_m=float(np.sqrt(((shape - shape.mean(axis=0)) ** 2).sum(axis=1).mean())),
        travel_m=float(np.linalg.norm(moved[known] - first, axis=1).max()),
        tracks_rejected=int((~motion.inlier).sum()),
        config=config,
    )
    members = np.flatnonzero(motion.inlier & tracks.observed[keyframes].any(axis=0))
    return _with_motions(replace(problem, members=members), motion)


def _with_motions(problem: FitProblem, motion: RigidMotion) -> FitProblem:
    """The problem with its free motions from the first keyframe, at the noise level they show."""
    R, t = (each[problem.keyframes] for each in motion.from_frame(int(problem.keyframes[0])))
    observations, config, scales = problem.observations, problem.config, problem.start
    x = None
    for _ in range(_FREE_SCALE_ITERATIONS):
        x, d2 = latent_points(R, t, observations.tracks, config.dof, scales.track, x)
        scales = updated_scales(d2, None, 6 * (R.shape[0] - 1), scales, observations, config)
    motions = motion_information(R, t, observations.tracks, config.dof, scales.track, x)
    return replace(problem, motions=motions, start=scales)


def problem_of_path(
    name: str,
    tracks: PointTracks,
    R_world_part: FloatArray | None,
    noise_known: bool,
    config: FitConfig,
) -> FitProblem:
    """One or two points: no rigid motion to be had from them, only a path.

    Args:
        name: of the input.
        tracks: T frames, one or two points.
        R_world_part: (T, 3, 3) measured orientations, or None.
        noise_known: whether the covariances are more than nominal.
        config: tuning.
    """
    path = np.nanmean(tracks.p_world, axis=1)
    seen = np.isfinite(path).all(axis=1)
    known = np.flatnonzero(seen)
    variances = tracks.cov_world[tracks.observed][:, range(3), range(3)]
    sigma_m = float(np.sqrt(np.median(variances)))
    noise = local_noise(path[known]) / sigma_m
    travel_m = float(np.linalg.norm(path[known] - path[known[0]], axis=1).max())
    systematic = 0.0 if noise_known else config.systematic_share * travel_m / sigma_m
    # A single marker sits on the handle, not in the middle of the part.
    prior = replace(config.prior, hinge_distance_m=config.prior.handle_distance_m)
    return _problem(
        name=name,
        points=tracks,
        R_world_part=R_world_part,
        keyframes=select_keyframes(path[known], known, config.max_frames),
        guesses=guesses_from_path(path, seen),
        noise=(noise_known, max(noise, 1e-3), max(noise, float(noise_known)), systematic),
        centroid_world=path[known[0]],
        lever_m=0.0,
        travel_m=travel_m,
        tracks_rejected=0,
        config=replace(config, prior=prior),
    )


def problem_of_surface(
    name: str, tracks: PointTracks, guess: JointGuess, centroid_world: FloatArray, config: FitConfig
) -> FitProblem:
    """A joint known roughly, and what tracks there are of its part (may be none): for `register`.

    Args:
        name: of the input.
        tracks: T frames of the part's tracks.
        guess: over the T frames.
        centroid_world: (3,) roughly the middle of the part at state zero.
        config: tuning.
    """
    R, t = part_motion(guess.kind, guess.T_world_joint, guess.q, guess.pitch)
    path = R @ centroid_world + t
    frames = np.arange(guess.q.size)
    scale = 1.0
    if tracks.p_world.shape[1] >= MIN_POINTS:  # how noisy they are needs no joint to see
        rng = np.random.default_rng(0)
        scale = max(free_rigid_motion(tracks, rng, config.rigid_motion).scale, 1.0)
    return _problem(
        name=name,
        points=tracks,
        R_world_part=None,
        keyframes=select_keyframes(path, frames, config.max_frames),
        guesses=[guess, drawer_along(path)],
        noise=(True, T_OVER_NORMAL * scale, scale, 0.0),
        centroid_world=centroid_world,
        lever_m=0.0,
        travel_m=float(np.linalg.norm(path - path[0], axis=1).max()),
        tracks_rejected=0,
        config=config,
    )


def _problem(
    name: str,
    points: PointTracks,
    R_world_part: FloatArray | None,
    keyframes: NDArray[np.int_],
    guesses: list[JointGuess],
    noise: tuple[bool, float, float, float],
    centroid_world: FloatArray,
    lever_m: float,
    travel_m: float,
    tracks_rejected: int,
    config: FitConfig,
) -> FitProblem:
    """Restrict to the keyframes; `noise` is (known, start scale, local scale, systematic)."""
    known, start, local, systematic = noise
    k = keyframes
    points = points.select(np.asarray(points.observed[k].any(axis=0)))
    seen = points
    if k.size < points.p_world.shape[0]:
        seen = PointTracks(points.p_world[k], points.cov_world[k])
    return FitProblem(
        name=name,
        points=points,
        keyframes=k,
        observations=Observations(
            TrackObservations.from_points(seen.p_world, seen.cov_world),
            None if R_world_part is None else R_world_part[k],
            known,
            systematic,
        ),
        guesses=[replace(guess, q=guess.q[k] - guess.q[k[0]]) for guess in guesses],
        centroid_world=centroid_world,
        lever_m=lever_m,
        start=Scales(start, _START_ORIENTATION_RAD),
        local_scale=local,
        travel_m=travel_m,
        tracks_rejected=tracks_rejected,
        config=config,
        motions=None,
    )
