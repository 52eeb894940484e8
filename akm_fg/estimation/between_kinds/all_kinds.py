"""Every joint kind solved for one problem: which are worth it, in what order, from which start."""

from __future__ import annotations

from dataclasses import replace

from akm_fg.errors import AxisUnobservable
from akm_fg.estimation.between_kinds.agreement import with_disagreement
from akm_fg.estimation.between_kinds.starts import Start, starts_of_part
from akm_fg.estimation.between_kinds.weighed_kinds import Correlation, FittedKinds, weighed
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.joint_prior import log_joint_prior
from akm_fg.estimation.one_kind.kind_fit import Effort, fit_kind, fit_rigid, kind_in_steps
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.estimation.sources.source import FirstFit
from akm_fg.estimation.sources.track_noise import correlated_points, correlation_frames
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.steps import Steps, to_end
from factors.joint import JointKind
from factors.student_t import twice_negative_log_kernel


def fit_in_steps(problem: FitProblem, began: float) -> Steps[FittedKinds]:
    """All kinds fitted and weighed, with a pause after every piece of work.

    First what is there from the start; then, with what that fit says of the part, the sources that
    need to know it (surface, gripper).

    Raises:
        AxisUnobservable: no moving kind can be fitted.
    """
    fits, warnings = yield from fit_kinds(problem)
    likeliest = _likeliest(fits)
    frames, visible = correlation_frames(likeliest.tracks)
    correlation = Correlation(frames, correlated_points(likeliest.tracks))
    if visible < 1.0:  # the noise is larger than the residuals show
        problem = problem.with_source(replace(problem.tracks, visible_share=visible))
        yield
        fits, lost = yield from _all_refitted(fits, problem)
        warnings = [*warnings, *lost]
    first = FirstFit(
        likeliest.guess,
        likeliest.state_sd,
        likeliest.scales,
        correlation.as_one,
        likeliest.joint is not None,
    )
    more, _ = yield from with_late_sources(problem, first)
    if more is not problem:
        problem, alone = more, fits
        fits, warnings = yield from fit_kinds(problem)
        fits = with_disagreement(
            fits, alone, correlation.as_one, problem.centroid_world, problem.config
        )
    return weighed(fits, problem, correlation, warnings, began)


def with_late_sources(problem: FitProblem, first: FirstFit) -> Steps[tuple[FitProblem, FirstFit]]:
    """The problem with what its late sources tell beside a first fit, each after the other."""
    for late in problem.late:
        found = yield from late.found(problem, first)
        if found is not None:
            problem, first = found
    return problem, first


def fit_kinds(problem: FitProblem) -> Steps[tuple[list[KindFit], list[str]]]:
    """Every kind that can be fitted, and why the others cannot."""
    if problem.motions is not None:
        starts = starts_of_part(problem, problem.motions)
        yield
        moving, reasons = yield from _fit_part(starts, problem)
    else:
        moving, reasons = _fit_path(problem)
    if not moving:
        raise AxisUnobservable(f"{problem.name}: " + "; ".join(reasons))
    still = fit_rigid(problem)
    if len(problem.sources) > 1:  # of tracks alone it is no piece of its own
        yield
    return [still, *moving], reasons


def _likeliest(fits: list[KindFit]) -> KindFit:
    return max(fits, key=lambda fit: fit.log_likelihood)


def _fit_part(starts: list[Start], problem: FitProblem) -> Steps[tuple[list[KindFit], list[str]]]:
    """Graphs of kinds that start at their best joint; those out of the race stay there."""
    fits, reasons = [], []
    for start in starts:
        near = problem.marker or start.nats_behind < problem.config.solve_within
        in_race = near and start.worth_it
        try:
            effort: Effort = "full" if in_race else "none"
            fit = yield from kind_in_steps(start.guess, problem, effort=effort)
            fits.append(fit)
        except AxisUnobservable as error:
            reasons.append(str(error))
        yield
    return fits, reasons


def _fit_path(problem: FitProblem) -> tuple[list[KindFit], list[str]]:
    """The path of one point has several bends to choose from: solved roughly, the best polished."""
    fits, reasons = [], []
    for kind in (JointKind.PRISMATIC, JointKind.REVOLUTE):
        starts = sorted(
            (guess for guess in problem.guesses if guess.kind is kind),
            key=lambda guess: start_rank(guess, problem),
        )
        if not starts:
            reasons.append(f"{kind} joint: too few frames for a start")
            continue
        try:
            rough = [fit_kind(guess, problem, effort="rough") for guess in starts[:2]]
            fits.append(max(rough, key=lambda fit: fit.log_evidence))
        except AxisUnobservable as error:
            reasons.append(str(error))
    if not fits:
        return [], reasons
    lead = max(fit.log_evidence for fit in fits) - problem.config.polish_within
    for i, fit in enumerate(fits):
        if fit.log_evidence > lead:
            fits[i] = to_end(_refitted(fit, problem))
    return fits, reasons


def start_rank(guess: JointGuess, problem: FitProblem) -> float:
    """Rough negative log posterior of a start, for choosing among those of one kind.

    At the noise level known so far, systematic part included: far hinges all look like a drawer,
    and where the noise cannot tell them apart the hinge's prior does.
    """
    tracks, config = problem.tracks, problem.config
    scale2 = tracks.first_scale**2 + tracks.min_scale**2
    d2 = tracks.rough_errors(guess) / scale2
    cost = 0.5 * float(twice_negative_log_kernel(d2, config.dof, 3).sum())
    return cost - log_joint_prior(guess.joint, problem.centroid_world, config.prior)


def _all_refitted(
    fits: list[KindFit], problem: FitProblem
) -> Steps[tuple[list[KindFit], list[str]]]:
    """The kinds solved again, and why some can no longer be."""
    again: list[KindFit] = []
    reasons = []
    for fit in fits:
        try:
            again.append((yield from _refitted(fit, problem)))
        except AxisUnobservable as error:
            reasons.append(str(error))
        yield
    if all(fit.joint is None for fit in again):
        raise AxisUnobservable(f"{problem.name}: " + "; ".join(reasons))
    return again, reasons


def _refitted(fit: KindFit, problem: FitProblem) -> Steps[KindFit]:
    """The kind solved again, from where it was."""
    if fit.joint is None:
        return fit_rigid(problem)
    return (yield from kind_in_steps(fit.guess, problem, fit))
