"""Laplace approximation of one solved kind: covariance, information, terms of its evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.estimation.given.initial_guess import JointGuess
from akm_fg.estimation.given.knowledge import StatePriors
from akm_fg.estimation.given.observations import Scales, log_likelihood, orientation_information
from akm_fg.estimation.one_kind.joint_graph import GraphProblem, graph_information
from akm_fg.estimation.one_kind.laplace import (
    KindFit,
    inverted,
    log_joint_prior,
    log_state_prior,
    metres_per_unit,
    observable_directions,
)
from akm_fg.estimation.sources.gripper import GraspFit
from akm_fg.records import FloatArray
from factors.joint_motion import unit_twist
from factors.measurements.dense_registration import DenseCost, dense_normal_equations
from factors.measurements.track_cost import TrackCost
from factors.measurements.track_information import state_information
from factors.student_t import covariance_factor


@dataclass(frozen=True, slots=True)
class Solution:
    """Values of one kind's variables and what they cost."""

    guess: JointGuess
    R_ref: FloatArray | None  # (3, 3)
    cost: TrackCost
    errors: FloatArray | None  # (T, 3) of the orientations
    dense: DenseCost | None
    states: StatePriors | None


def laplace_fit(
    solution: Solution,
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
    log_flat = log_state_prior(q, guess_metres_per_unit(guess, problem), prior)
    log_states, log_held = _integrated_states(solution, held, log_flat)
    freedom = observations.freedom(fitted)
    d2 = cost.d2[observations.tracks.observed]
    factor = covariance_factor(d2, config.dof, 3, freedom) if d2.size else 1.0
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


def guess_metres_per_unit(guess: JointGuess, problem: GraphProblem) -> float:
    """How far the part moves when the state of a guess grows by one; see `metres_per_unit`."""
    return metres_per_unit(
        guess.kind, guess.T_world_joint, problem.centroid_world, problem.lever_m, guess.pitch
    )


def log_latents(cost: TrackCost) -> float:
    """Log of the width that the data leave the latent points (flat prior, one a cubic metre)."""
    return 1.5 * cost.x_joint.shape[1] * math.log(2 * math.pi) - 0.5 * cost.log_det_latent


def _integrated_states(
    solution: Solution, held: FloatArray, log_flat: float
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
    solution: Solution, problem: GraphProblem, scales: Scales, size: int
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
