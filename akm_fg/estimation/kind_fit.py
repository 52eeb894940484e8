"""One joint kind solved: its graph, its noise scales, its Laplace approximation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import gtsam
import numpy as np

from akm_fg.estimation.grasp_fit import GraspFit, grasp_fit
from akm_fg.estimation.initial_guess import TURN_ABOUT_X, JointGuess, turned
from akm_fg.estimation.joint_graph import (
    JOINT,
    PITCH,
    REFERENCE,
    GraphProblem,
    graph_information,
    grasp_variables,
    initial_values,
    joint_graph,
    solved,
    state_key,
)
from akm_fg.estimation.knowledge import StatePriors, state_priors
from akm_fg.estimation.laplace import (
    KindFit,
    inverted,
    log_joint_prior,
    log_state_prior,
    metres_per_unit,
    observable_directions,
)
from akm_fg.estimation.observations import (
    CHI2_MEDIAN,
    T_OVER_NORMAL,
    Observations,
    Scales,
    log_likelihood,
    orientation_errors,
    orientation_information,
    updated_scales,
)
from akm_fg.records import FloatArray
from factors.dense_registration import DenseCost, dense_cost, dense_normal_equations
from factors.joint_motion import part_motion, unit_twist
from factors.point_track import (
    TrackCost,
    point_key,
    rough_track_cost,
    state_information,
    track_cost,
)
from factors.student_t import covariance_factor, twice_negative_log_kernel

Effort = Literal["full", "rough", "none"]
_RANKING_TRACKS = 40  # are enough to tell a good start from a bad one


@dataclass(frozen=True, slots=True)
class _Solution:
    """Values of one kind's variables and what they cost."""

    guess: JointGuess
    R_ref: FloatArray | None  # (3, 3)
    cost: TrackCost
    errors: FloatArray | None  # (T, 3) of the orientations
    dense: DenseCost | None
    states: StatePriors | None


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
    return _posterior(solution, grasp, graph.linearize(values), problem, scales, fitted)


def _state_priors(guess: JointGuess, problem: GraphProblem) -> StatePriors | None:
    """Of the kind's states; what a state is in metres is taken at the guess."""
    if problem.states is None or problem.keyframes is None:
        return None
    metres = _metres_per_unit(guess, problem)
    return state_priors(problem.states, guess.kind, problem.keyframes, metres)


def _metres_per_unit(guess: JointGuess, problem: GraphProblem) -> float:
    return metres_per_unit(
        guess.kind, guess.T_world_joint, problem.centroid_world, problem.lever_m, guess.pitch
    )


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
) -> _Solution:
    """The solution, with the tracks' cost taken from `last` if it was evaluated there."""
    observations = problem.observations
    states = (values.atDouble(state_key(t)) for t in range(1, observations.frames))
    q = np.array([0.0, *states])
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
    return _Solution(guess, R_ref, cost, errors, patches_cost(guess, problem, scales), None)


def _posterior(
    solution: _Solution,
    grasp: GraspFit | None,
    linear: gtsam.GaussianFactorGraph,
    problem: GraphProblem,
    scales: Scales,
    fitted: int,
) -> KindFit:
    """Laplace approximation at the solution; `linear` is the graph without the gauge there."""
    guess, cost = solution.guess, solution.cost
    kind, T, q, prior = guess.kind, guess.T_world_joint, guess.q, problem.config.prior
    observations, config = problem.observations, problem.config
    directions = observable_directions(kind)
    holds = 0 if observations.grasp is None else len(observations.grasp.holds)
    information = graph_information(
        linear, q.size, solution.R_ref is not None, directions, kind, holds
    )
    cov, log_det = inverted(kind, information)
    likelihood = log_likelihood(
        cost.d2, solution.errors, scales, observations, config, solution.dense
    )
    held, dense_information = _held_information(solution, problem, scales, information.shape[0])
    if grasp is not None:
        likelihood, held = likelihood + grasp.log_likelihood, held + grasp.held
    log_flat = log_state_prior(q, _metres_per_unit(guess, problem), prior)
    log_states, log_held = _integrated_states(solution, held, log_flat)
    freedom = observations.freedom(fitted)
    d2 = cost.d2[observations.tracks.observed] / freedom
    factor = covariance_factor(d2, config.dof, 3) if d2.size else 1.0
    return KindFit(
        kind=kind,
        T_world_joint=T,
        q=q,
        cov=cov * factor,
        information=information,
        dense_information=dense_information,
        joint_directions=directions,
        scales=scales,
        log_likelihood=likelihood,
        log_prior=log_joint_prior(kind, T, problem.centroid_world, prior, guess.pitch),
        log_frames=likelihood + log_states,
        log_latents=log_latents(cost),
        log_det=log_det - log_held,
        tau=1.0,
        cov_factor=factor,
        d2=cost.d2 * scales.track**2,
        residual_joint=(cost.z_joint - cost.x_joint).swapaxes(1, 2),
        x_joint=cost.x_joint,
        has_reference=solution.errors is not None,
        pitch=guess.pitch,
        dense_cost=solution.dense,
        freedom=freedom,
        grasp=grasp,
        log_noise=observations.log_noise(scales),
    )


def log_latents(cost: TrackCost) -> float:
    """Log of the width that the data leave the latent points (flat prior, one a cubic metre)."""
    return 1.5 * cost.x_joint.shape[1] * math.log(2 * math.pi) - 0.5 * cost.log_det_latent


def _integrated_states(
    solution: _Solution, held: FloatArray, log_flat: float
) -> tuple[float, float]:
    """Prior density of the states times the width they are left, and log det of what is known.

    Args:
        solution: the kind's.
        held: (T - 1,) information on each state, all else held.
        log_flat: log prior density of one state.
    """
    log_width = 0.5 * math.log(2 * math.pi)
    if solution.states is None:  # frame by frame
        log_held = np.log(held)
        return float(np.sum(log_flat + log_width - 0.5 * log_held)), float(log_held.sum())
    q = solution.guess.q
    log_det = float(np.linalg.slogdet(np.diag(held) + solution.states.information(q))[1])
    log_prior = solution.states.log_density(q, log_flat)
    return log_prior + held.size * log_width - 0.5 * log_det, log_det


def _held_information(
    solution: _Solution, problem: GraphProblem, scales: Scales, size: int
) -> tuple[FloatArray, FloatArray]:
    """Information (T - 1,) on each state with all else held, and the patches' share of the graph's.

    The latter over the same variables as the graph's, (size, size).
    """
    guess, observations = solution.guess, problem.observations
    held = state_information(guess.kind, solution.cost, guess.pitch)[1:]
    if solution.errors is not None:
        turn = float(np.sum(unit_twist(guess.kind)[:3] ** 2))
        held = held + turn * orientation_information(solution.errors, scales, problem.config)[1:]
    contribution = np.zeros((size, size))
    dense = observations.dense
    if dense is not None and solution.dense is not None:
        H, _ = dense_normal_equations(
            guess.kind,
            guess.T_world_joint,
            guess.q[dense.frames],
            solution.dense,
            dense.patches,
            guess.pitch,
        )
        H = H / dense.count_as_one
        directions = observable_directions(guess.kind)
        k = dense.frames.size
        first = size - (guess.q.size - 1)
        moving = dense.frames > 0
        rows = [*directions, *(6 + np.flatnonzero(moving))]
        columns = [*range(len(directions)), *(first + dense.frames[moving] - 1)]
        if guess.kind == "helical":
            rows.append(6 + k)
            columns.append(len(directions))
        contribution[np.ix_(columns, columns)] = H[np.ix_(rows, rows)]
        held = held.copy()
        held[dense.frames[moving] - 1] += H[6 + np.flatnonzero(moving), 6 + np.flatnonzero(moving)]
    return held, contribution
