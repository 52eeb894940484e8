"""Preparing a fit: which tracks, frames and starts, how noisy. No joint kind is assumed.

Of one point's path, or one marker's poses: `akm_fg.estimation.given.path_problem`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import TracksLost
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.guesses import drawer_along, guesses_from_motion
from akm_fg.estimation.given.lasting_modes import lasting_tracks, observations_of
from akm_fg.estimation.given.path import select_keyframes
from akm_fg.estimation.sources.source import Given, LateSource, Part, Source
from akm_fg.estimation.sources.tracks import T_OVER_NORMAL, TrackSource
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.geometry.rigid_motion import MIN_POINTS, RigidMotion, free_rigid_motion
from akm_fg.records import FloatArray, PointTracks
from factors.motion_information import MotionInformation, latent_points, motion_information

# Pose logs come without a noise level: observations are whitened by these and scaled by the fit.
NOMINAL_POSITION_M = 1e-3
_FREE_SCALE_ITERATIONS = 2  # from a median within a tenth to the graph's own level


@dataclass(frozen=True, slots=True)
class FitProblem:
    """Everything that the kinds share."""

    name: str
    points: PointTracks  # all T frames of the tracks that count
    members: NDArray[np.int_]  # (N,) which of the given tracks those are
    keyframes: NDArray[np.int_]  # (K,) frames in the graph; the first is where the state is zero
    sources: tuple[Source, ...]  # over the keyframes; the tracks are the first
    guesses: list[JointGuess]  # over the keyframes
    centroid_world: FloatArray  # (3,) of the points in the first keyframe
    lever_m: float  # root mean square size of the points about it
    local_scale: float  # noise that no joint is needed to see, in given standard deviations
    travel_m: float
    tracks_rejected: int
    config: FitConfig
    motions: MotionInformation | None  # free motions over the keyframes; None for a bare path
    late: tuple[LateSource, ...] = ()  # over the T frames; read after a first fit
    marker: bool = False  # one point of the part, or its pose: nobody sees the part itself
    rows_left_out: int = 0  # of a pose log: frames whose pose jumps

    @property
    def tracks(self) -> TrackSource:
        """The tracks; there may be none in them."""
        tracks = self.sources[0]
        assert isinstance(tracks, TrackSource)
        return tracks

    @property
    def known_frames(self) -> NDArray[np.int_]:
        """Frames of the input in which the part is seen."""
        return np.flatnonzero(self.points.observed.any(axis=1))

    @property
    def part(self) -> Part:
        """What the terms of the sources may know of the part."""
        return Part(self.config, self.centroid_world, self.lever_m, self.keyframes)

    def knowing(self, given: Sequence[Given]) -> FitProblem:
        """The problem with other sources.

        Raises:
            ValueError: one is not over its frames.
        """
        for each in given:
            each.check(self.points.p_world.shape[0])
        now = tuple(each for each in given if isinstance(each, Source))
        late = tuple(each for each in given if isinstance(each, LateSource))
        return replace(self, sources=self.sources + now, late=self.late + late)

    def with_source(self, source: Source) -> FitProblem:
        """The problem with a source that takes the place of the one of its name, if any."""
        names = [each.name for each in self.sources]
        if source.name not in names:
            return replace(self, sources=(*self.sources, source))
        at = names.index(source.name)
        return replace(self, sources=(*self.sources[:at], source, *self.sources[at + 1 :]))

    def restricted(self, frames: NDArray[np.int_]) -> FitProblem:
        """Over some of its graph's frames (indices, growing); free motions are to be found anew.

        Tracks that none of them sees are left out.
        """
        seen = np.flatnonzero(self.tracks.observations.observed[frames].any(axis=0))
        sources = [
            source.restricted(frames) for source in (self.tracks.of(seen), *self.sources[1:])
        ]
        return replace(
            self,
            points=self.points.select(seen),
            members=self.members[seen],
            keyframes=self.keyframes[frames],
            sources=tuple(source for source in sources if source is not None),
            guesses=[guess.restricted(frames) for guess in self.guesses],
            motions=None,
        )

    def counting(self, as_one: float) -> FitProblem:
        """The problem with the others weighed for tracks of which so many count as one."""
        others = tuple(source.recounted(as_one) for source in self.sources[1:])
        return replace(self, sources=(self.sources[0], *others))


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
    problem = assembled(
        name=name,
        points=tracks.select(motion.inlier),
        keyframes=keyframes,
        R_world=motion.R_world,
        guesses=guesses_from_motion(motion),
        noise=Noise(
            noise_known, T_OVER_NORMAL * motion.scale, max(motion.scale, float(noise_known))
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
    tracks, config = problem.tracks, problem.config
    scale, x = tracks.first_scale, None
    freedom = tracks.freedom(6 * (R.shape[0] - 1))
    for _ in range(_FREE_SCALE_ITERATIONS):
        x, d2 = latent_points(R, t, tracks.observations, config.dof, scale, x)
        scale = tracks.rescaled(d2, scale, freedom, None)
    motions = motion_information(R, t, tracks.observations, config.dof, scale, x)
    tracks = replace(tracks, first_scale=scale, x_world=motions.x_world)
    return replace(problem, motions=motions).with_source(tracks)


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
    R, t = guess.motion()
    path = R @ centroid_world + t
    frames = np.arange(guess.q.size)
    scale = 1.0
    if tracks.p_world.shape[1] >= MIN_POINTS:  # how noisy they are needs no joint to see
        rng = np.random.default_rng(0)
        scale = max(free_rigid_motion(tracks, rng, config.rigid_motion).scale, 1.0)
    return assembled(
        name=name,
        points=tracks,
        keyframes=select_keyframes(path, frames, config.max_frames),
        R_world=R,
        guesses=[guess, drawer_along(path)],
        noise=Noise(True, T_OVER_NORMAL * scale, scale),
        centroid_world=centroid_world,
        lever_m=0.0,
        travel_m=float(np.linalg.norm(path - path[0], axis=1).max()),
        tracks_rejected=0,
        config=config,
    )


@dataclass(frozen=True, slots=True)
class Noise:
    """Of the tracks, in given standard deviations, as far as it shows without a joint."""

    known: bool  # whether those are more than nominal
    first_scale: float  # to start from
    local_scale: float
    systematic: float = 0.0  # of a path


def assembled(
    name: str,
    points: PointTracks,
    keyframes: NDArray[np.int_],
    R_world: FloatArray,
    guesses: list[JointGuess],
    noise: Noise,
    centroid_world: FloatArray,
    lever_m: float,
    travel_m: float,
    tracks_rejected: int,
    config: FitConfig,
) -> FitProblem:
    """The problem over its keyframes, with its tracks as the first source.

    `R_world` (T, 3, 3): how the part has turned, roughly.
    """
    k = keyframes
    members = np.flatnonzero(points.observed[k].any(axis=0))
    points = points.select(members)
    seen = points if k.size == points.p_world.shape[0] else points.at(k)
    tracks = TrackSource(
        observations_of(seen, lasting_tracks(seen, R_world[k])),
        noise.known,
        noise.first_scale,
        config,
        noise.systematic,
    )
    return FitProblem(
        name=name,
        points=points,
        members=members,
        keyframes=k,
        sources=(tracks,),
        guesses=[guess.restricted(k) for guess in guesses],
        centroid_world=centroid_world,
        lever_m=lever_m,
        local_scale=noise.local_scale,
        travel_m=travel_m,
        tracks_rejected=tracks_rejected,
        config=config,
        motions=None,
    )
