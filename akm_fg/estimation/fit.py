"""From tracks or poses of one part to a posterior over joint kind, joint frame and states.

tracks -> free rigid motion (inliers, noise, starts) -> one graph a kind -> evidence -> kind
"""

from __future__ import annotations

import time
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, cast

import numpy as np
from threadpoolctl import ThreadpoolController

from akm_fg.errors import AxisUnobservable, TracksLost
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.dense_fit import SurfaceSource, register
from akm_fg.estimation.evidence import (
    correlated_points,
    correlation_frames,
    is_parametric,
    kind_probabilities,
    motion_is_significant,
    nested_screw,
    temper,
)
from akm_fg.estimation.initial_guess import JointGuess
from akm_fg.estimation.joint_graph import GraphProblem
from akm_fg.estimation.kind_fit import fit_kind, start_rank
from akm_fg.estimation.knowledge import Knowledge, passed_limits
from akm_fg.estimation.laplace import KindFit
from akm_fg.estimation.posterior import (
    ArticulationPosterior,
    FitReport,
    JointPosterior,
    KindPosterior,
    NamedKind,
    StatePosterior,
)
from akm_fg.estimation.problem import (
    NOMINAL_POSITION_M,
    FitProblem,
    problem_of_path,
    problem_of_surface,
    problem_of_tracks,
)
from akm_fg.estimation.rigid_fit import fit_rigid
from akm_fg.estimation.rigid_motion import MIN_POINTS
from akm_fg.estimation.starts import Start, starts_of_part
from akm_fg.estimation.states import states_of_all_frames
from akm_fg.estimation.steps import Steps, to_end
from akm_fg.records import FloatArray, JointKind, PointTracks, PoseTrack
from factors.gauge import GAUGE_NAMES


@dataclass(frozen=True, slots=True)
class FittedKinds:
    """The answer, and the solved graphs it was read off, for those who go on from there."""

    posterior: ArticulationPosterior
    fits: list[KindFit]
    problem: FitProblem


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
        fits, warnings = to_end(_fit_kinds(problem, graph_problem(problem)))
        correlation = (1.0, 1.0)
        if problem.has_tracks:
            likeliest = max(fits, key=lambda fit: fit.log_likelihood)
            tau, _ = correlation_frames(likeliest, problem.observations)
            correlation = tau, correlated_points(likeliest, problem.observations)
        as_one = correlation[0] * correlation[1]
        if as_one > 1.0:  # otherwise the tracks weighed rightly beside the surface already
            problem = problem.counting(as_one)
            fits, warnings = to_end(_fit_kinds(problem, graph_problem(problem)))
        return _posterior(fits, problem, correlation, warnings, began).posterior


def _fit(
    problem: FitProblem, began: float, surface: SurfaceSource | None = None
) -> ArticulationPosterior:
    return to_end(fit_in_steps(problem, began, surface)).posterior


def fit_in_steps(
    problem: FitProblem, began: float, surface: SurfaceSource | None = None
) -> Steps[FittedKinds]:
    """All kinds fitted and weighed, with a pause after every piece of work.

    Raises:
        AxisUnobservable: no moving kind can be fitted.
    """
    graph = graph_problem(problem)
    fits, warnings = yield from _fit_kinds(problem, graph)
    likeliest = max(fits, key=lambda fit: fit.log_likelihood)
    tau, visible = correlation_frames(likeliest, problem.observations)
    together = correlated_points(likeliest, problem.observations)
    if visible < 1.0:
        observations = replace(problem.observations, visible_share=visible)
        graph = replace(graph, observations=observations)
        for i, fit in enumerate(fits):
            fits[i] = _refitted(fit, graph)
            yield
        problem = replace(problem, observations=observations)
    guess = _guess_of(likeliest)
    held = problem.holding(guess, likeliest.state_sd, tau * together)
    more, problem = held is not problem, held
    if surface is not None and likeliest.T_world_joint is not None and problem.motions is not None:
        registration = register(problem, guess, likeliest.scales, surface, tau * together)
        if registration is not None:
            more, problem = True, registration.problem
    if more:
        fits, warnings = yield from _fit_kinds(problem, graph_problem(problem))
    return _posterior(fits, problem, (tau, together), warnings, began)


def _posterior(
    fits: list[KindFit],
    problem: FitProblem,
    correlation: tuple[float, float],
    warnings: list[str],
    began: float,
) -> FittedKinds:
    """Weigh the kinds; `correlation` is what errs together, in frames and in points."""
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
    if best.kind == "rigid" and motion_is_significant(fits):
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


def graph_problem(problem: FitProblem) -> GraphProblem:
    """What the graphs of all kinds are built from."""
    return GraphProblem(
        problem.observations,
        problem.centroid_world,
        problem.lever_m,
        problem.start,
        problem.config,
        None if problem.motions is None else problem.motions.x_world,
        problem.knowledge.states,
        problem.keyframes,
    )


def _fit_kinds(problem: FitProblem, graph: GraphProblem) -> Steps[tuple[list[KindFit], list[str]]]:
    """Every kind that can be fitted, and why the others cannot."""
    if problem.motions is not None:
        starts = starts_of_part(problem, problem.motions)
        yield
        moving, reasons = yield from _fit_part(starts, graph)
    else:
        moving, reasons = _fit_path(problem.guesses, graph)
    if not moving:
        raise AxisUnobservable(f"{problem.name}: " + "; ".join(reasons))
    return [fit_rigid(graph), *moving], reasons


def _fit_part(starts: list[Start], graph: GraphProblem) -> Steps[tuple[list[KindFit], list[str]]]:
    """Graphs of kinds that start at their best joint; those out of the race stay there."""
    fits, reasons = [], []
    for start in starts:
        in_race = start.nats_behind < graph.config.solve_within and start.worth_it
        try:
            fits.append(fit_kind(start.guess, graph, effort="full" if in_race else "none"))
        except AxisUnobservable as error:
            reasons.append(str(error))
        yield
    return fits, reasons


def _fit_path(guesses: list[JointGuess], graph: GraphProblem) -> tuple[list[KindFit], list[str]]:
    """The path of one point has several bends to choose from: solved roughly, the best polished."""
    fits, reasons = [], []
    for kind in ("prismatic", "revolute"):
        starts = sorted(
            (guess for guess in guesses if guess.kind == kind),
            key=lambda guess: start_rank(guess, graph),
        )
        if not starts:
            reasons.append(f"{kind} joint: too few frames for a start")
            continue
        try:
            rough = [fit_kind(guess, graph, effort="rough") for guess in starts[:2]]
            fits.append(max(rough, key=lambda fit: fit.log_evidence))
        except AxisUnobservable as error:
            reasons.append(str(error))
    if not fits:
        return [], reasons
    lead = max(fit.log_evidence for fit in fits) - graph.config.polish_within
    return [_refitted(fit, graph) if fit.log_evidence > lead else fit for fit in fits], reasons


def _refitted(fit: KindFit, graph: GraphProblem) -> KindFit:
    """The kind solved again, from where it was."""
    return fit_rigid(graph) if fit.T_world_joint is None else fit_kind(_guess_of(fit), graph, fit)


def _guess_of(fit: KindFit) -> JointGuess:
    """Where a fit ended; rigid as a prismatic joint that stays at zero."""
    if fit.T_world_joint is None:
        return JointGuess("prismatic", np.eye(4), fit.q)
    return JointGuess(fit.kind, fit.T_world_joint, fit.q, fit.pitch)


def pointing_forward(fit: KindFit) -> KindFit:
    """The same joint with its axis along growing states."""
    if fit.T_world_joint is None or fit.q.mean() >= 0:
        return fit
    T = fit.T_world_joint.copy()
    T[:3, :3] = T[:3, :3] @ np.diag([1.0, -1.0, -1.0])  # half a turn about x of the joint
    turned = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
    signs = np.ones(fit.cov.shape[0])
    signs[: len(fit.joint_directions)] = turned[list(fit.joint_directions)]
    signs[-(fit.q.size - 1) :] = -1
    x_joint = fit.x_joint * np.array([1.0, -1.0, -1.0])[:, None]
    residual = fit.residual_joint * np.array([1.0, -1.0, -1.0])
    return replace(
        fit,
        T_world_joint=T,
        q=-fit.q,
        cov=fit.cov * np.outer(signs, signs),
        x_joint=x_joint,
        residual_joint=residual,
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
