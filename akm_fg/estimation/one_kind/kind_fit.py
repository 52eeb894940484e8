"""One joint kind solved: its graph and the noise scales of its sources, in turn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import gtsam
import numpy as np

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.joint_prior import joint_prior_factors, log_joint_prior, log_state_prior
from akm_fg.estimation.one_kind.joint_chart import widest_information
from akm_fg.estimation.one_kind.joint_graph import (
    JOINT,
    initial_values,
    joint_graph,
    marquardt,
    read,
    solved,
    still_variables,
    variables_of,
)
from akm_fg.estimation.one_kind.laplace import KindFit, inverted
from akm_fg.estimation.sources.source import (
    At,
    Contribution,
    NoiseLevel,
    Term,
    information_of,
)
from akm_fg.estimation.sources.tracks import freedom_left
from akm_fg.geometry.joint_guess import JointGuess, still
from akm_fg.steps import Steps, to_end

_STILL_TOLERANCE = 1e-4  # nats; a few variables are cheap to solve well
Effort = Literal["full", "rough", "none"]
Scales = Mapping[str, float]


def fit_kind(
    guess: JointGuess,
    problem: FitProblem,
    previous: KindFit | None = None,
    effort: Effort = "full",
) -> KindFit:
    """Solve one moving kind from one start, and find its noise scales.

    Args:
        guess: kind and start.
        problem: what to fit.
        previous: an earlier fit of this kind that ended in the guess: its scales and latents.
        effort: `rough` stops early, good enough to compare starts; `none` stays at the guess
            and finds its noise scales alone, for kinds that are out of the race.

    Raises:
        AxisUnobservable: the data leave a direction open.
    """
    return to_end(kind_in_steps(guess, problem, previous, effort))


def kind_in_steps(
    guess: JointGuess,
    problem: FitProblem,
    previous: KindFit | None = None,
    effort: Effort = "full",
) -> Steps[KindFit]:
    """`fit_kind`, with a pause after every round; of tracks alone all are one short piece."""
    if guess.q.mean() < 0:  # what is known of states is counted as they grow
        guess = guess.turned()
        previous = None if previous is None else previous.pointing_forward()
    config, kind = problem.config, guess.kind
    variables, terms = variables_of(kind, guess.q.size), _terms(guess, problem, previous)
    scales: Scales = {term.name: term.start_scale(effort == "full") for term in terms}
    values = initial_values(guess, variables, terms)
    freedom = _freedom(terms, kind.coordinates + guess.q.size - 1)
    tolerance = config.scale_tolerance if effort == "full" else config.rough_scale_tolerance
    rounds = config.still_scale_iterations if effort == "none" else config.scale_iterations
    for _ in range(rounds):
        graph = joint_graph(variables, terms, scales, problem)
        if effort != "none":
            values = solved(graph, values, kind, problem, effort == "rough")
        at = read(values, variables, scales)
        new = _rescaled(terms, at, freedom)
        if _change(scales, new) < tolerance:
            break
        scales = new
        if len(terms) > 1:
            yield
    return _laplace(read(values, variables, scales), terms, problem, freedom)


def fit_rigid(problem: FitProblem) -> KindFit:
    """Nothing moved: no joint and no states, the sources' own variables and noise scales alone."""
    config, guess = problem.config, still(problem.keyframes.size)
    variables, terms = still_variables(guess.q.size), _terms(guess, problem, None)
    scales: Scales = {term.name: term.start_scale(near=False) for term in terms}
    values = initial_values(guess, variables, terms)
    freedom = _freedom(terms, 0)
    for _ in range(config.scale_iterations):
        values = _still_solved(values, guess.q.size, terms, scales, config)
        new = _rescaled(terms, read(values, variables, scales), freedom)
        change, scales = _change(scales, new), new
        if change < config.rough_scale_tolerance:  # far off or not: a nat does not matter here
            break
    at = read(values, variables, scales)
    none = np.zeros((0, 0))
    said = {term.name: term.contribution(at, freedom) for term in terms}
    return KindFit(None, guess.q, none, none, none, none, said, scales, 0.0, 0.0, none, 0.0)


def _still_solved(
    values: gtsam.Values, frames: int, terms: Sequence[Term], scales: Scales, config: FitConfig
) -> gtsam.Values:
    """The sources' own variables at their best; the joint is held, which costs nothing."""
    own = [term for term in terms if term.own]
    if not own:
        return values
    variables = still_variables(frames)
    graph = gtsam.NonlinearFactorGraph()
    for term in own:
        for factor in term.factors(variables, scales[term.name]):
            graph.push_back(factor)
    held = gtsam.noiseModel.Unit.Create(6)
    graph.push_back(gtsam.PriorFactorPose3(JOINT, values.atPose3(JOINT), held))
    parameters = marquardt(config, rough=True)
    parameters.setAbsoluteErrorTol(_STILL_TOLERANCE)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def _terms(guess: JointGuess, problem: FitProblem, previous: KindFit | None) -> list[Term]:
    """The sources in the graph of the guess' kind."""
    said: Mapping[str, Contribution] = {} if previous is None else previous.said
    part = problem.part
    terms = [source.term(guess, part, said.get(source.name)) for source in problem.sources]
    return [term for term in terms if term is not None]


def _freedom(terms: Sequence[Term], fitted: int) -> float:
    """Share of the observed numbers left after fitting the latent ones and `fitted` others."""
    numbers = [term.numbers for term in terms]
    return freedom_left(sum(n for n, _ in numbers), sum(latent for _, latent in numbers), fitted)


def _rescaled(terms: Sequence[Term], at: At, freedom: float) -> Scales:
    """All noise scales one step on, with what the terms know of each other's."""
    levels: dict[str, NoiseLevel] = {}
    for term in terms:
        levels |= term.levels
    return {term.name: term.rescaled(at, freedom, levels.get(term.name)) for term in terms}


def _change(scales: Scales, new: Scales) -> float:
    """Largest relative difference."""
    return max(abs(math.log(new[name] / scales[name])) for name in scales)


def _laplace(at: At, terms: Sequence[Term], problem: FitProblem, freedom: float) -> KindFit:
    """The Laplace approximation at the solution, from what the sources contribute there.

    Raises:
        AxisUnobservable: the data leave a direction open.
    """
    joint, q, prior = at.guess.joint, at.guess.q, problem.config.prior
    said = {term.name: term.contribution(at, freedom) for term in terms}
    priors = joint_prior_factors(at.variables, problem.centroid_world, prior)
    known, _, _ = information_of(priors, at, {})
    information = known + sum(each.information for each in said.values())
    judged = known + sum(each.judged_share * each.information for each in said.values())
    cov = inverted(joint.kind, information)
    fit = KindFit(
        joint=joint,
        q=q,
        cov=cov,
        information=information,
        prior_information=known,
        widest=widest_information(joint, problem.centroid_world),
        said=said,
        scales=at.scales,
        log_prior=log_joint_prior(joint, problem.centroid_world, prior),
        log_flat=(q.size - 1) * log_state_prior(q, problem.part.metres_per_unit(at.guess), prior),
        judged=judged,
        log_held=_log_held(list(said.values())),
    )
    return fit.tempered(1.0)


def _log_held(said: Sequence[Contribution]) -> float:
    """Log det of the information on the states, all else held."""
    held = np.sum([each.judged_share * each.held for each in said], axis=0)
    tied = [each.tied for each in said if each.tied is not None]
    if not tied:  # frame by frame
        return float(np.log(held).sum())
    return float(np.linalg.slogdet(np.diag(held) + np.sum(tied, axis=0))[1])
