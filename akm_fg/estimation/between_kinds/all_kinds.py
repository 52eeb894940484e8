"""Every joint kind solved for one problem: which are worth it, in what order, from which start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from akm_fg.errors import AxisUnobservable
from akm_fg.estimation.between_kinds.evidence import correlated_points, correlation_frames
from akm_fg.estimation.between_kinds.starts import Start, starts_of_part
from akm_fg.estimation.between_kinds.weighed_kinds import FittedKinds, weighed
from akm_fg.estimation.given.initial_guess import JointGuess
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.given.surface_registration import SurfaceSource, register
from akm_fg.estimation.one_kind.joint_graph import GraphProblem
from akm_fg.estimation.one_kind.kind_fit import fit_kind, start_rank
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.estimation.one_kind.rigid_fit import fit_rigid
from akm_fg.estimation.steps import Steps


def fit_in_steps(
    problem: FitProblem, began: float, surface: SurfaceSource | None = None
) -> Steps[FittedKinds]:
    """All kinds fitted and weighed, with a pause after every piece of work.

    Raises:
        AxisUnobservable: no moving kind can be fitted.
    """
    graph = graph_problem(problem)
    fits, warnings = yield from fit_kinds(problem, graph)
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
        fits, warnings = yield from fit_kinds(problem, graph_problem(problem))
    return weighed(fits, problem, (tau, together), warnings, began)


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


def fit_kinds(problem: FitProblem, graph: GraphProblem) -> Steps[tuple[list[KindFit], list[str]]]:
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
