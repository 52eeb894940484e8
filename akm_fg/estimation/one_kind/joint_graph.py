"""One joint kind as a GTSAM graph: its variables, its factors, its solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import gtsam
import numpy as np

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.problem import FitProblem
from akm_fg.estimation.joint_prior import joint_prior_factors
from akm_fg.estimation.sources.source import At, Term
from akm_fg.geometry.joint_guess import JointGuess
from factors.joint import JointKind
from factors.joint_variables import JointVariables
from factors.priors.gauge import gauge_factor

JOINT = gtsam.symbol("j", 0)
PITCH = gtsam.symbol("h", 0)


@cache
def variables_of(kind: JointKind, frames: int) -> JointVariables:
    """Of a joint over so many frames; the state of frame 0 is zero and no variable."""
    states = (None, *(gtsam.symbol("q", frame) for frame in range(1, frames)))
    return JointVariables(kind, JOINT, states, PITCH if kind.has_pitch else None)


@cache
def still_variables(frames: int) -> JointVariables:
    """Nothing moved: a prismatic joint with no state free."""
    return JointVariables(JointKind.PRISMATIC, JOINT, (None,) * frames, None)


@cache
def _still(variables: JointVariables) -> gtsam.Values:
    """States of zero: inserting a number into Values costs fifty times what moving it does."""
    values = gtsam.Values()
    for key in variables.state_keys:
        if key is not None:
            values.insert(key, 0.0)
    return values


def initial_values(
    guess: JointGuess, variables: JointVariables, terms: Sequence[Term]
) -> gtsam.Values:
    """The variables of a guess, and the terms' own."""
    states = gtsam.VectorValues()
    for key, q in zip(variables.state_keys, guess.q[:, None], strict=True):
        if key is not None:
            states.insert(key, q)
    values = _still(variables).retract(states)
    values.insert(JOINT, gtsam.Pose3(guess.joint.T_world_joint))
    if variables.pitch_key is not None:
        values.insert(variables.pitch_key, guess.joint.pitch)
    for term in terms:
        term.insert(values)
    return values


def joint_graph(
    variables: JointVariables,
    terms: Sequence[Term],
    scales: Mapping[str, float],
    problem: FitProblem,
) -> gtsam.NonlinearFactorGraph:
    """What the sources say and the joint's priors, without the gauge."""
    graph = gtsam.NonlinearFactorGraph()
    for term in terms:
        for factor in term.factors(variables, scales[term.name]):
            graph.push_back(factor)
    prior = problem.config.prior
    for factor in joint_prior_factors(variables, problem.centroid_world, prior):
        graph.push_back(factor)
    return graph


def solved(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    kind: JointKind,
    problem: FitProblem,
    rough: bool,
) -> gtsam.Values:
    """The values that minimise the graph with the gauge held."""
    config = problem.config
    gauged = gtsam.NonlinearFactorGraph(graph)
    heading = values.atPose3(JOINT).rotation()
    gauged.push_back(gauge_factor(kind, JOINT, heading, problem.centroid_world))
    parameters = marquardt(config, rough)
    parameters.setlambdaInitial(1e-5)
    return gtsam.LevenbergMarquardtOptimizer(gauged, values, parameters).optimize()


def marquardt(config: FitConfig, rough: bool) -> gtsam.LevenbergMarquardtParams:
    """Levenberg-Marquardt that ends when a step gains too little to matter."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(config.rough_iterations if rough else config.max_iterations)
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(config.rough_cost_tolerance if rough else config.cost_tolerance)
    return parameters


def read(values: gtsam.Values, variables: JointVariables, scales: Mapping[str, float]) -> At:
    """The solution as the terms want it."""
    joint, q = variables.read(values)
    return At(JointGuess(joint, np.asarray(q)), variables, values, scales)
