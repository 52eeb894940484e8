"""The part's surface in keyframes, brought into the fit of the tracks.

The best joint that the tracks alone give says where the part's surface lies in every keyframe;
patches are associated there, the joint is refitted to tracks and patches together, and so on with
a narrower gate. What comes out is a source for the graphs of all kinds, and the joint to
start from. Nothing is decided here: the association serves every kind alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import SurfaceConfig
from akm_fg.estimation.given.motion_fit import fit_to_motions
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.given.tied_frames import most_telling, off_the_path, tied_frames
from akm_fg.estimation.sources.source import FirstFit, LateSource
from akm_fg.estimation.sources.surface import SURFACE, SurfaceSource
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import BoolArray, FloatArray
from akm_fg.steps import Steps
from factors.joint import JointKind
from factors.measurements.dense_registration import (
    DenseCost,
    PatchCosts,
    PatchObservations,
    dense_information,
)
from factors.motion_information import MotionInformation, motion_information


class AssociatedPatches(Protocol):
    """Patches and where they were looked for."""

    @property
    def patches(self) -> PatchObservations:
        """S patches in K keyframes."""

    @property
    def uv(self) -> FloatArray:
        """(K, S, 2) pixels."""

    @property
    def seen_through(self) -> FloatArray:
        """(K,) share of the part's patches in whose place something farther is seen, or NaN."""

    @property
    def was_there(self) -> FloatArray:
        """(K,) share of a view's patches in whose place is what was there before, or NaN."""


class SurfaceViews(Protocol):
    """The part's surface in K keyframes."""

    @property
    def frames(self) -> tuple[int, ...]:
        """(K,) numbers of the keyframes."""

    def associate(
        self, R_world: FloatArray, t_world: FloatArray, gate_m: float, most: int | None = None
    ) -> AssociatedPatches:
        """Patches, `most` at most, under motions (K, 3, 3), (K, 3) from the reference pose."""


class Surface(Protocol):
    """Gives the part's surface in chosen frames once the part's motion is known."""

    def views(
        self, frames: Sequence[int], R_world: FloatArray, t_world: FloatArray, known: BoolArray
    ) -> Steps[SurfaceViews]:
        """Views of some frames, with a pause after every piece of work.

        Args:
            frames: numbers of the frames.
            R_world: (T, 3, 3) the part's motion in all frames, from the reference pose.
            t_world: (T, 3).
            known: (T,) where it is known.
        """


@dataclass(frozen=True, slots=True)
class SurfaceToRegister(LateSource):
    """The part's surface, as far as perception sees it once the part's motion is known."""

    surface: Surface

    def found(
        self, problem: FitProblem, first: FirstFit
    ) -> Steps[tuple[FitProblem, FirstFit] | None]:
        """The problem with the surface registered, and the joint that explains both best."""
        # Nothing moved, or it is the path of one point: there is no part to see.
        if problem.motions is None or problem.marker or not first.moved:
            return None
        return (yield from register(problem, first, self.surface, problem.config.surface.keyframes))


def spread_by_state(q: FloatArray, count: int) -> NDArray[np.int_]:
    """At most `count` frames, farthest apart in state, frame 0 first (the paper, sec. IV-B)."""
    chosen = [0]
    distance = np.abs(q - q[0])
    while len(chosen) < min(count, q.size) and distance.max() > 0:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.abs(q - q[chosen[-1]]))
    return np.sort(np.array(chosen))


def register(
    problem: FitProblem, first: FirstFit, surface: Surface, keyframes: int
) -> Steps[tuple[FitProblem, FirstFit] | None]:
    """Associate the surface with a joint, and refine both in turn.

    Args:
        problem: with its tracks, if any.
        first: the joint that explains them best, over the graph's frames, and their noise.
        surface: of the part.
        keyframes: at most so many.

    Returns:
        The problem with the surface as a source and the motions of the joint that explains tracks
        and patches best, and that joint; None where the surface is not seen again in enough places.
    """
    config, guess = problem.config.surface, first.guess
    chosen = spread_by_state(guess.q, keyframes)
    views = yield from surface.views(
        problem.keyframes[chosen].tolist(), *_motion_of_all_frames(problem, guess)
    )
    yield
    # A frame that neither a track nor a view sees has no state.
    seen_at = np.isin(problem.keyframes, views.frames)
    seen_at |= problem.tracks.observations.observed.any(axis=1)
    if not seen_at.all():
        kept = np.flatnonzero(seen_at)
        problem, guess = problem.restricted(kept), guess.restricted(kept)
        first = replace(first, state_sd=first.state_sd[kept])
    given, at = problem, np.flatnonzero(np.isin(problem.keyframes, views.frames))
    if at.size < 2:
        return None
    gate_m, scale = config.first_gate_m, first.scales.get(SURFACE, 1.0)
    for number in range(config.associations):
        R, t = guess.motion()
        most = config.rough_patches if number < config.rough_associations else None
        seen = views.associate(R[at], t[at], gate_m, most)
        if most and seen.patches.precision.shape[1] < config.min_patches:  # too few of so few
            seen = views.associate(R[at], t[at], gate_m)
        if seen.patches.precision.shape[1] < config.min_patches:
            return None
        yield
        source = SurfaceSource(seen.patches, at, 1.0, scale, problem.config)
        source, cost = _rescaled(source, R[at], t[at])
        scale = source.first_scale
        together = readings_as_one(cost, seen.patches, seen.uv) / first.as_one
        source = replace(source, count_as_one=max(together, 1e-3))
        problem = _about_surface(problem, cost)
        motions = _motions(problem, R, t, source, cost, first)
        guess = fit_to_motions(guess, motions, problem.centroid_world, problem.config.prior).guess
        precision = np.median(seen.patches.precision[seen.patches.seen])
        typical_m = scale / math.sqrt(float(precision))
        gate_m = max(config.gate_sigmas * typical_m, config.least_gate_m)
        yield
    followed = problem.tracks.observations.observed
    blind = np.asarray(~followed.any(axis=1))
    other = (seen.seen_through > config.opaque) | (seen.was_there > config.opaque)
    path = np.unwrap(guess.q) if guess.joint.kind == JointKind.REVOLUTE else guess.q
    other |= off_the_path(path, config, problem.keyframes)[at]
    blind[at] &= ~source.patches.seen.any(axis=1) | other
    label = tied_frames(followed, at, source.patches.seen, config)
    blind |= ~most_telling(label, guess, motions.information)
    if blind.any():  # a view that shows nothing of the part after all
        kept = np.flatnonzero(~blind)
        if kept.size < 2:
            return None
        first = replace(first, guess=guess.restricted(kept), state_sd=first.state_sd[kept])
        return (yield from register(given.restricted(kept), first, surface, keyframes))
    level = first.scales[problem.tracks.name]
    tracks = replace(problem.tracks, first_scale=level, x_world=motions.x_world)
    problem = replace(problem, motions=motions).with_source(tracks).with_source(source)
    return problem, replace(first, guess=guess)


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
    R[k], t[k] = guess.motion()
    known[k] = True
    return R, t, known


def _rescaled(
    source: SurfaceSource, R_world: FloatArray, t_world: FloatArray
) -> tuple[SurfaceSource, DenseCost]:
    """With the noise scale that maximises the likelihood at fixed motions, and the cost there."""
    config, scale = source.config, source.first_scale
    costs = PatchCosts(source.patches, config.dof)
    cost = costs.at(R_world, t_world, scale)
    for _ in range(config.scale_iterations):
        factor = source.scale_factor(cost)
        scale *= factor
        cost = costs.at(R_world, t_world, scale)
        if abs(math.log(factor)) < config.scale_tolerance:
            break
    return replace(source, first_scale=scale), cost


def _motions(
    problem: FitProblem,
    R: FloatArray,
    t: FloatArray,
    surface: SurfaceSource,
    cost: DenseCost,
    first: FirstFit,
) -> MotionInformation:
    """Tracks and patches as one quadratic form around the motions R, t."""
    tracks = problem.tracks
    motions = motion_information(
        R,
        t,
        tracks.observations,
        problem.config.dof,
        first.scales[tracks.name],
        tracks.x_world,
    )
    H, g = dense_information(cost, surface.patches)
    rows = (6 * surface.frames[:, None] + np.arange(6)).ravel()
    information, gradient = motions.information.copy(), motions.gradient.copy()
    information[np.ix_(rows, rows)] += H / surface.count_as_one
    gradient[rows] += g / surface.count_as_one
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
    size = np.sqrt(cost.d2[seen])
    e = np.sign(cost.e[seen]) * np.minimum(size, limit)
    variance, sums = float((e**2).mean()), _block_sums(e, np.nonzero(seen)[0], uv[seen])
    largest = 1.0
    for _ in SurfaceConfig.blocks_px:
        largest = max(largest, float((sums**2).sum()) / max(e.size * variance, 1e-300))
        K, columns, rows = sums.shape
        sums = sums.reshape(K, columns // 2, 2, rows // 2, 2).sum(axis=(2, 4))
    return largest


def _block_sums(e: FloatArray, view: NDArray[np.int_], uv: FloatArray) -> FloatArray:
    """(K, columns, rows) sums of values (n,) at pixels (n, 2) of K views over the smallest blocks.

    Columns and rows are so many that they can be halved for every larger size of blocks.
    """
    sizes = SurfaceConfig.blocks_px
    halved = 2 ** len(sizes)
    block = np.floor(uv / sizes[0]).astype(np.int64)
    block -= block.min(axis=0, initial=0) // halved * halved
    columns, rows = (-(-(block.max(axis=0, initial=0) + 1) // halved) * halved).tolist()
    place = (view * columns + block[:, 0]) * rows + block[:, 1]
    K = int(view.max(initial=0)) + 1
    sums = np.asarray(np.bincount(place, e, K * columns * rows), dtype=np.float64)
    return sums.reshape(K, columns, rows)
