"""Solved kinds weighed against each other, and the answer as a record."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from akm_fg.estimation.between_kinds.evidence import (
    is_parametric,
    kind_probabilities,
    nested_screw,
    rest_is_shown,
    temper,
)
from akm_fg.estimation.given.initial_guess import TURN_ABOUT_X
from akm_fg.estimation.given.knowledge import passed_limits
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
from akm_fg.records import JointKind
from factors.priors.gauge import GAUGE_NAMES

_NOT_WORTH_SAMPLING = 1e-3  # probability of a kind beside one that is named


@dataclass(frozen=True, slots=True)
class FittedKinds:
    """The answer, and the solved graphs it was read off, for those who go on from there."""

    posterior: ArticulationPosterior
    fits: list[KindFit]
    problem: FitProblem


def weighed(
    fits: list[KindFit],
    problem: FitProblem,
    correlation: tuple[float, float],
    warnings: list[str],
    began: float,
) -> FittedKinds:
    """Weigh the kinds and write the answer.

    Args:
        fits: the solved kinds.
        problem: they were solved for.
        correlation: how many neighbouring frames err together, and how many points.
        warnings: so far.
        began: when the fit did, on the performance counter.
    """
    as_one = correlation[0] * correlation[1]
    fits = [pointing_forward(temper(fit, as_one, problem)) for fit in fits]
    fits = nested_screw(fits, problem)
    probability = kind_probabilities(fits, problem.config.prior)
    best = max(fits, key=lambda fit: probability[fit.kind])
    parametric = is_parametric(best, problem, as_one)
    warnings = warnings + [
        text for fit in fits for text in passed_limits(problem.knowledge.states, fit.kind, fit.q)
    ]
    decided = parametric and probability[best.kind] >= problem.config.undecided_below
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


def with_sampled_joints(fitted: FittedKinds) -> ArticulationPosterior:
    """The answer with the joints that the data leave vague sampled: see `sampled_posterior`."""
    answer = fitted.posterior
    alternatives = dict(answer.alternatives)
    least = 0.0 if answer.kind == "undecided" else _NOT_WORTH_SAMPLING
    for fit in fitted.fits:
        if answer.kind_probability[fit.kind] > least:
            better = sampled(fit, fitted.problem)
            if better is not fit:
                alternatives[fit.kind] = _kind_posterior(pointing_forward(better), fitted.problem)
    return replace(answer, alternatives=alternatives)


def pointing_forward(fit: KindFit) -> KindFit:
    """The same joint with its axis along growing states."""
    if fit.T_world_joint is None or fit.q.mean() >= 0:
        return fit
    T = fit.T_world_joint.copy()
    T[:3, :3] *= TURN_ABOUT_X
    turned = np.tile(TURN_ABOUT_X, 2)
    signs = np.ones(fit.cov.shape[0])
    signs[: len(fit.joint_directions)] = turned[list(fit.joint_directions)]
    signs[-(fit.q.size - 1) :] = -1
    return replace(
        fit,
        T_world_joint=T,
        q=-fit.q,
        cov=fit.cov * np.outer(signs, signs),
        x_joint=fit.x_joint * TURN_ABOUT_X[:, None],
        residual_joint=fit.residual_joint * TURN_ABOUT_X,
    )


def _kind_posterior(fit: KindFit, problem: FitProblem) -> KindPosterior:
    if fit.T_world_joint is None:
        return KindPosterior(None, None, fit.evidence)
    mean, sd = states_of_all_frames(fit, problem.points, problem.keyframes, problem.config)
    states = StatePosterior("m" if fit.kind == "prismatic" else "rad", mean, sd)
    return KindPosterior(joint_posterior(fit), states, fit.evidence)


def joint_posterior(fit: KindFit) -> JointPosterior:
    """Joint and covariance of a solved moving kind."""
    assert fit.T_world_joint is not None
    return JointPosterior(
        kind=cast(JointKind, fit.kind),
        T_world_joint=fit.T_world_joint,
        cov=fit.joint_cov,
        gauge=GAUGE_NAMES[fit.kind],
        pitch_m_per_rad=fit.pitch if fit.kind == "helical" else None,
        pitch_sd_m_per_rad=fit.pitch_sd if fit.kind == "helical" else None,
    )


def _report(
    best: KindFit,
    problem: FitProblem,
    correlation: tuple[float, float],
    parametric: bool,
    warnings: tuple[str, ...],
) -> FitReport:
    observed = problem.observations.tracks.observed
    unit = 1.0 if problem.observations.noise_known else NOMINAL_POSITION_M
    surface = _surface_report(best, problem, correlation[0] * correlation[1])
    rms_m = surface.get("patches_rms_m", 0.0)
    if observed.any():
        rms_m = float(np.sqrt(best.squared_error_m2[observed].mean()))
    return FitReport(
        log_evidence=best.log_evidence,
        tracks_used=int(observed.any(axis=0).sum()),
        tracks_rejected=problem.tracks_rejected,
        rms_m=rms_m,
        noise_scale=best.scales.track * unit,
        correlation_frames=correlation[0],
        correlation_points=correlation[1],
        parametric=parametric,
        warnings=warnings,
        holds=problem.holds,
        **surface,
    )


def _surface_report(best: KindFit, problem: FitProblem, as_one: float) -> dict[str, Any]:
    """The fields of `FitReport` on the surface; empty without one."""
    dense = problem.observations.dense
    if dense is None or best.dense_cost is None:
        return {}
    seen = dense.patches.seen
    return {
        "keyframes_registered": tuple(int(k) for k in problem.keyframes[dense.frames]),
        "patches_used": int(seen.any(axis=0).sum()),
        "patches_rms_m": float(np.sqrt((best.dense_cost.e[seen] ** 2).mean())),
        "patches_as_one": dense.count_as_one * as_one,
    }
