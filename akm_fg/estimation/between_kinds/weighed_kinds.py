"""Solved kinds weighed against each other, and the answer as a record."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.between_kinds.agreement import disagreement_warnings
from akm_fg.estimation.between_kinds.evidence import (
    is_parametric,
    kind_probabilities,
    left_out_warnings,
    levelled,
    nested_screw,
    rest_is_shown,
    turn_warnings,
)
from akm_fg.estimation.between_kinds.vague_hinges import with_vague_hinges
from akm_fg.estimation.given.problem import NOMINAL_POSITION_M, FitProblem
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.estimation.one_kind.sampled_posterior import sampled
from akm_fg.estimation.one_kind.states import states_of_all_frames
from akm_fg.posterior import (
    ArticulationPosterior,
    FitReport,
    JointPosterior,
    KindPosterior,
    NamedKind,
    StatePosterior,
)
from akm_fg.records import PointTracks


@dataclass(frozen=True, slots=True)
class Correlation:
    """Observations of the tracks that err together."""

    frames: float = 1.0  # neighbours in time
    points: float = 1.0  # neighbours on the part

    @property
    def as_one(self) -> float:
        """How many count as one."""
        return self.frames * self.points


@dataclass(frozen=True, slots=True)
class FittedKinds:
    """The answer, and the solved graphs it was read off, for those who go on from there."""

    posterior: ArticulationPosterior
    fits: list[KindFit]
    problem: FitProblem

    def over_frames(self, points: PointTracks, numbers: NDArray[np.int_]) -> FittedKinds:
        """The answer over all frames of an input of which the fit saw some.

        Args:
            points: T frames of the tracks that count (`FitProblem.members`).
            numbers: of the frames that the fit saw, among those.
        """
        problem = replace(self.problem, points=points, keyframes=numbers[self.problem.keyframes])
        posterior = self.posterior.over_frames(numbers, points.p_world.shape[0])
        alternatives = {fit.kind: _kind_posterior(fit, problem) for fit in self.fits}
        posterior = replace(posterior, alternatives=alternatives)
        return FittedKinds(posterior, self.fits, problem)


def weighed(
    fits: list[KindFit],
    problem: FitProblem,
    correlation: Correlation,
    warnings: list[str],
    began: float,
) -> FittedKinds:
    """Weigh the kinds and write the answer.

    Args:
        fits: the solved kinds.
        problem: they were solved for.
        correlation: observations that err together.
        warnings: so far.
        began: when the fit did, on the performance counter.
    """
    as_one = correlation.as_one
    fits = [fit.tempered(as_one).pointing_forward() for fit in fits]
    fits = nested_screw(levelled(with_vague_hinges(fits, problem), problem), problem)
    probability = kind_probabilities(fits, problem.config.prior)
    best = max(fits, key=lambda fit: probability[fit.kind])
    possible = [f for f in fits if probability[f.kind] >= 1 - problem.config.undecided_below]
    explains = {fit.kind: is_parametric(fit, problem, as_one) for fit in possible}
    parametric = any(explains.values())
    warnings = warnings + left_out_warnings(problem) + turn_warnings(best, problem)
    warnings += disagreement_warnings(best)
    warnings += [
        text
        for fit in fits
        for source in problem.sources
        for text in source.warnings(fit.kind, fit.q)
    ]
    certain = probability[best.kind] >= problem.config.undecided_below
    decided = certain and explains[best.kind]
    if problem.rows_left_out > problem.config.largest_share_left_out * len(problem.points.p_world):
        decided = False
    if best.kind == "rigid" and not rest_is_shown(fits, problem.config.prior):
        decided = False
    posterior = ArticulationPosterior(
        name=problem.name,
        kind=cast(NamedKind, best.kind if decided else "undecided"),
        kind_probability=probability,
        alternatives={fit.kind: _kind_posterior(fit, problem) for fit in fits},
        fit=_report(best, problem, correlation, parametric, tuple(warnings)),
        time_s={"total": time.perf_counter() - began},
    )
    return FittedKinds(posterior, fits, problem)


def silenced(answer: ArticulationPosterior, reason: str) -> ArticulationPosterior:
    """The answer with its kind undecided, and why."""
    fit = replace(answer.fit, warnings=(*answer.fit.warnings, reason))
    return replace(answer, kind="undecided", fit=fit)


def with_sampled_joints(fitted: FittedKinds) -> ArticulationPosterior:
    """The answer with the joints that the data leave vague sampled: see `sampled_posterior`."""
    answer = fitted.posterior
    alternatives = dict(answer.alternatives)
    sampling = fitted.problem.config.sampling
    least = 0.0 if answer.kind == "undecided" else sampling.least_probability
    for fit in fitted.fits:
        if answer.kind_probability[fit.kind] > least:
            better = sampled(fit, fitted.problem)
            if better is not fit:
                alternatives[fit.kind] = _kind_posterior(better.pointing_forward(), fitted.problem)
    return replace(answer, alternatives=alternatives)


def _kind_posterior(fit: KindFit, problem: FitProblem) -> KindPosterior:
    if fit.joint is None:
        return KindPosterior(None, None, fit.evidence)
    mean, sd = states_of_all_frames(fit, problem.points, problem.keyframes, problem.config)
    states = StatePosterior(fit.joint.kind.unit, mean, sd)
    return KindPosterior(joint_posterior(fit), states, fit.evidence)


def joint_posterior(fit: KindFit) -> JointPosterior:
    """Joint and covariance of a solved moving kind."""
    joint = fit.moving
    return JointPosterior(joint, fit.joint_cov, fit.pitch_sd if joint.kind.has_pitch else None)


def _report(
    best: KindFit,
    problem: FitProblem,
    correlation: Correlation,
    parametric: bool,
    warnings: tuple[str, ...],
) -> FitReport:
    tracks = best.tracks
    unit = 1.0 if problem.tracks.noise_known else NOMINAL_POSITION_M
    reported: dict[str, Any] = {}
    for said in best.said.values():
        reported |= said.reported(correlation.as_one)
    rms_m = reported.get("patches_rms_m", 0.0)
    if tracks.observed.any():
        rms_m = float(np.sqrt(tracks.squared_error_m2[tracks.observed].mean()))
    return FitReport(
        log_evidence=best.log_evidence,
        tracks_used=int(tracks.observed.any(axis=0).sum()),
        tracks_rejected=problem.tracks_rejected,
        rms_m=rms_m,
        noise_scale=tracks.scale * unit,
        correlation_frames=correlation.frames,
        correlation_points=correlation.points,
        parametric=parametric,
        warnings=warnings,
        rows_left_out=problem.rows_left_out,
        **reported,
    )
