"""Dense views of keyframes brought into the fit of the tracks.

The best joint that the tracks alone give says where the part's surface lies in every keyframe;
patches are associated there, the joint is refitted to tracks and patches together, and so on with
a narrower gate. What comes out are observations for the graphs of all kinds, and the joint to
start from. Nothing is decided here: the association serves every kind alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import DenseConfig
from akm_fg.estimation.given.initial_guess import JointGuess
from akm_fg.estimation.given.observations import DenseObservations, Scales, dense_scale_factor
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.one_kind.motion_fit import fit_to_motions
from akm_fg.records import BoolArray, FloatArray
from factors.joint_motion import part_motion
from factors.measurements.dense_registration import (
    DenseCost,
    PatchObservations,
    dense_cost,
    dense_information,
)
from factors.measurements.track_cost import TrackObservations
from factors.motion_information import MotionInformation, motion_information


class AssociatedPatches(Protocol):
    """Patches and where they were looked for."""

    @property
    def patches(self) -> PatchObservations:
        """S patches in K keyframes."""

    @property
    def uv(self) -> FloatArray:
        """(K, S, 2) pixels."""


class SurfaceViews(Protocol):
    """The part's surface in K keyframes."""

    @property
    def frames(self) -> tuple[int, ...]:
        """(K,) numbers of the keyframes."""

    def associate(
        self, R_world: FloatArray, t_world: FloatArray, gate_m: float
    ) -> AssociatedPatches:
        """Patches under motions (K, 3, 3), (K, 3) from the reference pose."""


class SurfaceSource(Protocol):
    """Gives the part's surface in chosen frames once the part's motion is known."""

    def views(
        self, frames: Sequence[int], R_world: FloatArray, t_world: FloatArray, known: BoolArray
    ) -> SurfaceViews:
        """Views of some frames.

        Args:
            frames: numbers of the frames.
            R_world: (T, 3, 3) the part's motion in all frames, from the reference pose.
            t_world: (T, 3).
            known: (T,) where it is known.
        """


@dataclass(frozen=True, slots=True)
class Registration:
    """Dense observations of a problem, and the joint that explains tracks and patches best."""

    problem: FitProblem  # with the dense observations and the motions of the joint
    guess: JointGuess


def spread_by_state(q: FloatArray, count: int) -> NDArray[np.int_]:
    """At most `count` frames, farthest apart in state, frame 0 first (the paper, sec. IV-B)."""
    chosen = [0]
    distance = np.abs(q - q[0])
    while len(chosen) < min(count, q.size) and distance.max() > 0:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.abs(q - q[chosen[-1]]))
    return np.sort(np.array(chosen))


def register(
    problem: FitProblem,
    guess: JointGuess,
    scales: Scales,
    source: SurfaceSource,
    as_one: float,
) -> Registration | None:
    """Associate the surface with a joint, and refine both in turn.

    Args:
        problem: with its tracks, if any.
        guess: the joint that explains them best, over the graph's frames.
        scales: noise levels it was fitted with.
        source: of the keyframes' surfaces.
        as_one: observations of the tracks that count as one.

    Returns:
        None where the surface is not seen again in enough places.
    """
    config = problem.config.dense
    count = config.keyframes if problem.has_tracks else config.keyframes_alone
    chosen = spread_by_state(guess.q, count)
    views = source.views(problem.keyframes[chosen].tolist(), *_motion_of_all_frames(problem, guess))
    # A frame that neither a track nor a view sees has no state.
    seen_at = np.isin(problem.keyframes, views.frames)
    seen_at |= problem.observations.tracks.observed.any(axis=1)
    if not seen_at.all():
        kept = np.flatnonzero(seen_at)
        problem, guess = restricted(problem, kept), restricted_guess(guess, kept)
    at = np.flatnonzero(np.isin(problem.keyframes, views.frames))
    if at.size < 2:
        return None
    gate_m = config.first_gate_m
    for _ in range(config.associations):
        R, t = part_motion(guess.kind, guess.T_world_joint, guess.q, guess.pitch)
        seen = views.associate(R[at], t[at], gate_m)
        if seen.patches.precision.shape[1] < config.min_patches:
            return None
        scales, cost = _dense_scale(seen.patches, R[at], t[at], scales, problem)
        together = max(readings_as_one(cost, seen.patches, seen.uv) / as_one, 1e-3)
        dense = DenseObservations(seen.patches, at, together)
        problem = _about_surface(problem, cost)
        motions = _motions(problem, R, t, dense, cost, scales)
        guess = fit_to_motions(guess, motions, problem.centroid_world, problem.config.prior).guess
        precision = np.median(seen.patches.precision[seen.patches.seen])
        typical_m = scales.dense / math.sqrt(float(precision))
        gate_m = max(config.gate_sigmas * typical_m, config.least_gate_m)
    observations = replace(problem.observations, dense=dense)
    return Registration(
        replace(problem, observations=observations, motions=motions, start=scales), guess
    )


def restricted(problem: FitProblem, frames: NDArray[np.int_]) -> FitProblem:
    """A problem over some of its graph's frames (indices, growing), those that tracks see in it."""
    tracks = problem.observations.tracks
    kept = TrackObservations(
        tracks.p_world[frames],
        tracks.information_world[frames],
        tracks.observed[frames],
        tracks.log_det_cov,
    )
    return replace(
        problem,
        keyframes=problem.keyframes[frames],
        observations=replace(problem.observations, tracks=kept),
        guesses=[restricted_guess(guess, frames) for guess in problem.guesses],
        motions=None,
    )


def restricted_guess(guess: JointGuess, frames: NDArray[np.int_]) -> JointGuess:
    """The guess over some of its frames, the first of them at state zero."""
    return replace(guess, q=guess.q[frames] - guess.q[frames[0]])


def _about_surface(problem: FitProblem, cost: DenseCost) -> FitProblem:
    """The problem with the middle and size of the part's surface instead of its tracks'."""
    x = cost.x_world[:, cost.weight.any(axis=0)]
    centroid = x.mean(axis=1)
    lever_m = math.sqrt(float(((x - centroid[:, None]) ** 2).sum(axis=0).mean()))
    return replace(problem, centroid_world=centroid, lever_m=lever_m)


def _motion_of_all_frames(
    problem: FitProblem, guess: JointGuess
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Motions of the recording's T frames; only the graph's are known."""
    T = problem.points.p_world.shape[0]
    R, t, known = np.tile(np.eye(3), (T, 1, 1)), np.zeros((T, 3)), np.zeros(T, dtype=bool)
    k = problem.keyframes
    R[k], t[k] = part_motion(guess.kind, guess.T_world_joint, guess.q, guess.pitch)
    known[k] = True
    return R, t, known


def _dense_scale(
    patches: PatchObservations,
    R: FloatArray,
    t: FloatArray,
    scales: Scales,
    problem: FitProblem,
) -> tuple[Scales, DenseCost]:
    """The patches' noise scale by expectation maximisation at fixed motions, and their cost."""
    dof, scale = problem.config.dof, scales.dense
    cost = dense_cost(R, t, patches, dof, scale)
    for _ in range(problem.config.scale_iterations):
        factor = dense_scale_factor(cost, patches, dof)
        scale *= factor
        cost = dense_cost(R, t, patches, dof, scale)
        if abs(math.log(factor)) < problem.config.scale_tolerance:
            break
    return replace(scales, dense=scale), cost


def _motions(
    problem: FitProblem,
    R: FloatArray,
    t: FloatArray,
    dense: DenseObservations,
    cost: DenseCost,
    scales: Scales,
) -> MotionInformation:
    """Tracks and patches as one quadratic form around the motions R, t."""
    config, start = problem.config, problem.motions
    motions = motion_information(
        R,
        t,
        problem.observations.tracks,
        config.dof,
        scales.track,
        None if start is None else start.x_world,
    )
    H, g = dense_information(cost, dense.patches)
    rows = (6 * dense.frames[:, None] + np.arange(6)).ravel()
    information, gradient = motions.information.copy(), motions.gradient.copy()
    information[np.ix_(rows, rows)] += H / dense.count_as_one
    gradient[rows] += g / dense.count_as_one
    return replace(motions, information=information, gradient=gradient)


def readings_as_one(cost: DenseCost, patches: PatchObservations, uv: FloatArray) -> float:
    """How many neighbouring readings err together, at least one.

    The variance of sums of residuals over image blocks, over that of independent ones: the
    design effect of cluster samples (Kish, Survey Sampling, 1965, sec. 5.4). Blocks grow until
    the errors of neighbouring blocks are independent and the ratio stops growing; its largest
    value is taken.
    """
    seen = patches.seen
    limit = 3 * np.sqrt(np.median(cost.d2[seen]))
    size = np.sqrt(np.maximum(cost.d2, 1e-300))
    e = np.where(seen, np.sign(cost.e) * np.minimum(size, limit), 0.0)
    variance = float((e[seen] ** 2).mean())
    largest = 1.0
    for side_px in DenseConfig.blocks_px:
        power = count = 0.0
        for k in range(e.shape[0]):
            s = seen[k]
            block = np.floor(uv[k, s] / side_px).astype(np.int64)
            _, index = np.unique(block[:, 0] * 100_003 + block[:, 1], return_inverse=True)
            power += float((np.bincount(index, e[k, s]) ** 2).sum())
            count += float(s.sum())
        largest = max(largest, power / max(count * variance, 1e-300))
    return largest
