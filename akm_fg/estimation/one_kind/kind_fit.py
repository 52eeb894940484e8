"""One joint kind solved: its graph and its noise scales, in turn."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import gtsam
import numpy as np

from akm_fg.estimation.given.initial_guess import TURN_ABOUT_X, JointGuess, turned
from akm_fg.estimation.given.knowledge import StatePriors, state_priors
from akm_fg.estimation.given.observations import (
    CHI2_MEDIAN,
    T_OVER_NORMAL,
    Observations,
    Scales,
    orientation_errors,
    updated_scales,
)
from akm_fg.estimation.one_kind.joint_graph import (
    JOINT,
    PITCH,
    REFERENCE,
    GraphProblem,
    grasp_variables,
    initial_values,
    joint_graph,
    solved,
    state_keys,
)
from akm_fg.estimation.one_kind.kind_laplace import Solution, guess_metres_per_unit, laplace_fit
from akm_fg.estimation.one_kind.laplace import KindFit, log_joint_prior, observable_directions
from akm_fg.estimation.sources.gripper import GraspFit, grasp_fit
from akm_fg.records import FloatArray
from factors.joint_motion import part_motion
from factors.measurements.dense_registration import DenseCost, dense_cost
from factors.measurements.point_track import point_key
from factors.measurements.track_cost import TrackCost, rough_track_cost, track_cost
from factors.student_t import twice_negative_log_kernel

Effort = Literal["full", "rough", "none"]
_RANKING_TRACKS = 40  # are enough to tell a good start from a bad one


def guess_cost(guess: JointGuess, observations: Observations) -> float:
    """How badly a start explains the tracks: the median squared error, so that few can spoil it."""
    errors = rough_track_cost(guess.kind, guess.T_world_joint, guess.q, observations.tracks)
    return float(np.median(errors))


def start_rank(guess: JointGuess, problem: GraphProblem) -> float:
    """Rough negative log posterior of a start, for choosing among those of one kind.

    At the noise level known so far, systematic part included: far hinges all look like a drawer,
    and where the noise cannot tell them apart the hinge's prior does.
    """
    observations, prior = problem.observations, problem.config.prior
    count = observations.tracks.observed.shape[1]
    some = np.unique(np.linspace(0, count - 1, min(count, _RANKING_TRACKS)).astype(int))
    d2 = rough_track_cost(
        guess.kind, guess.T_world_joint, guess.q, observations.tracks.select(some)
    )
    d2 = np.repeat(d2, -(-count // some.size))  # each stands for its neighbours
    scale2 = problem.start.track**2 + observations.min_scale**2
    cost = 0.5 * float(twice_negative_log_kernel(d2 / scale2, problem.config.dof, 3).sum())
    return cost - log_joint_prior(guess.kind, guess.T_world_joint, problem.centroid_world, prior)


def fit_kind(
    guess: JointGuess,
    problem: GraphProblem,
    previous: KindFit | None = None,
    effort: Effort = "full",
) -> KindFit:
    """Solve one moving kind from one start, and find its noise scale.

    Args:
        guess: kind and start.
        problem: what to fit.
        previous: an earlier fit of this kind near the guess, for its scales and latent points.
        effort: `rough` stops early, good enough to compare starts; `none` stays at the guess
            and finds its noise scale alone, for kinds that are out of the race.

    Raises:
        AxisUnobservable: the data leave a direction open.
    """
    observations, config = problem.observations, problem.config
    limited = problem.states is not None and problem.states.limits(guess.kind) is not None
    backward = limited and guess.q.mean() < 0
    if backward:  # limits are those of states that grow
        guess = turned(guess)
    values = initial_values(guess, observations)
    if previous is not None:
        scales = previous.scales
    elif problem.x_world is not None and effort == "full":
        scales = problem.start  # fitted to the free motions: the same noise
    else:
        scales = _start_scales(guess, values, problem)
    x = None if previous is None else previous.x_joint
    if backward and x is not None:
        x = x * TURN_ABOUT_X[:, None]
    if x is None and problem.x_world is not None:
        T = guess.T_world_joint
        x = T[:3, :3].T @ (problem.x_world - T[:3, 3:])
    directions = len(observable_directions(guess.kind)) + (guess.kind == "helical")
    fitted = directions + observations.frames - 1 + (3 if values.exists(REFERENCE) else 0)
    tolerance = config.scale_tolerance if effort == "full" else config.rough_scale_tolerance
    states = _state_priors(guess, problem)
    for _ in range(config.scale_iterations if effort != "none" else config.still_scale_iterations):
        last: dict[bytes, TrackCost] = {}
        graph = joint_graph(guess.kind, problem, scales, x, last, states)
        if effort != "none":
            values = solved(graph, values, guess.kind, problem, effort == "rough")
        solution = _evaluated(guess.kind, values, problem, scales, x, last)
        new = updated_scales(
            solution.cost.d2, solution.errors, fitted, scales, observations, config, solution.dense
        )
        x = solution.cost.x_joint
        if scales.change(new) < tolerance:
            break
        scales = new
    else:
        last = {}
        graph = joint_graph(guess.kind, problem, scales, x, last, states)
        solution = _evaluated(guess.kind, values, problem, scales, x, last)
    solution = replace(solution, states=states)
    grasp = _grasp_fit(guess.kind, values, problem)
    return laplace_fit(solution, grasp, graph.linearize(values), problem, scales, fitted)


def _state_priors(guess: JointGuess, problem: GraphProblem) -> StatePriors | None:
    """Of the kind's states; what a state is in metres is taken at the guess."""
    if problem.states is None or problem.keyframes is None:
        return None
    metres = guess_metres_per_unit(guess, problem)
    return state_priors(problem.states, guess.kind, problem.keyframes, metres)


def _grasp_fit(kind: str, values: gtsam.Values, problem: GraphProblem) -> GraspFit | None:
    observations = problem.observations
    if observations.grasp is None:
        return None
    variables = grasp_variables(kind, observations)
    return grasp_fit(kind, values, variables, observable_directions(kind), observations.grasp)


def patches_cost(guess: JointGuess, problem: GraphProblem, scales: Scales) -> DenseCost | None:
    """The dense patches' cost at a joint; None without any."""
    dense = problem.observations.dense
    if dense is None:
        return None
    R, t = part_motion(guess.kind, guess.T_world_joint, guess.q[dense.frames], guess.pitch)
    return dense_cost(R, t, dense.patches, problem.config.dof, scales.dense)


def _start_scales(guess: JointGuess, values: gtsam.Values, problem: GraphProblem) -> Scales:
    """The problem's, or larger where the guess leaves larger errors: a kind that does not fit."""
    observations, start = problem.observations, problem.start
    track = start.track
    if observations.tracks.observed.any():
        track = T_OVER_NORMAL * math.sqrt(guess_cost(guess, observations) / CHI2_MEDIAN)
    orientation = start.orientation_rad
    if observations.R_world_part is not None:
        R_ref = values.atRot3(REFERENCE).matrix()
        errors = orientation_errors(guess.kind, guess.T_world_joint, guess.q, R_ref, observations)
        assert errors is not None
        orientation = math.sqrt(float(np.median((errors**2).sum(axis=1))) / CHI2_MEDIAN)
    # A start near the noise already known begins there: its own median is the worse estimate.
    track = start.track if track < 1.2 * start.track else track
    return Scales(track, max(orientation, start.orientation_rad), start.dense)


def _evaluated(
    kind: str,
    values: gtsam.Values,
    problem: GraphProblem,
    scales: Scales,
    x_start: FloatArray | None,
    last: dict[bytes, TrackCost],
) -> Solution:
    """The solution, with the tracks' cost taken from `last` if it was evaluated there."""
    observations = problem.observations
    q = np.array([0.0, *map(values.atDouble, state_keys(observations.frames))])
    T = values.atPose3(JOINT).matrix()
    pitch = values.atDouble(PITCH) if kind == "helical" else 0.0
    guess = JointGuess(kind, T, q, pitch)
    R_ref = values.atRot3(REFERENCE).matrix() if values.exists(REFERENCE) else None
    here = point_key(T, q, pitch)
    if here not in last:
        last.clear()
        last[here] = track_cost(
            kind, T, q, observations.tracks, problem.config.dof, scales.track, x_start, pitch
        )
    cost = last[here]
    errors = orientation_errors(kind, T, q, R_ref, observations)
    return Solution(guess, R_ref, cost, errors, patches_cost(guess, problem, scales), None)
