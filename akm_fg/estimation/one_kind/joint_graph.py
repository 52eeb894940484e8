"""One joint kind as a GTSAM graph: its variables, its factors, its solution."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.initial_guess import JointGuess
from akm_fg.estimation.given.knowledge import StateKnowledge, StatePriors
from akm_fg.estimation.given.observations import Observations, Scales
from akm_fg.estimation.sources.gripper import (
    GraspVariables,
    grasp_factors,
    grasp_key,
    insert_grasps,
    without_grasps,
)
from akm_fg.records import FloatArray
from factors.measurements.dense_registration import dense_registration_factor
from factors.measurements.orientation_track import orientation_track_factor
from factors.measurements.point_track import point_track_factor
from factors.measurements.track_cost import TrackCost
from factors.priors.gauge import gauge_factor
from factors.priors.hinge_distance import hinge_distance_factor
from factors.priors.pitch_prior import pitch_prior_factor

JOINT = gtsam.symbol("j", 0)
REFERENCE = gtsam.symbol("r", 0)
PITCH = gtsam.symbol("h", 0)


@cache
def state_keys(frames: int) -> tuple[int, ...]:
    """Keys of q_1 .. q_T-1; that of frame 0 is zero and no variable."""
    return tuple(gtsam.symbol("q", frame) for frame in range(1, frames))


@dataclass(frozen=True, slots=True)
class GraphProblem:
    """What every kind's graph is built from."""

    observations: Observations
    centroid_world: FloatArray  # (3,) of the moving points at state zero
    lever_m: float  # root mean square size of the moving points about it
    start: Scales
    config: FitConfig
    x_world: FloatArray | None = None  # (3, N) where the latent points start, state zero
    states: StateKnowledge | None = None  # over the frames of the input
    keyframes: NDArray[np.int_] | None = None  # (T,) the graph's among them


@cache
def _still(frames: int) -> gtsam.Values:
    """States of zero: inserting a number into Values costs fifty times what moving it does."""
    values = gtsam.Values()
    for key in state_keys(frames):
        values.insert(key, 0.0)
    return values


def initial_values(guess: JointGuess, observations: Observations) -> gtsam.Values:
    """The variables of a guess."""
    states = gtsam.VectorValues()
    for key, q in zip(state_keys(guess.q.size), guess.q[1:, None], strict=True):
        states.insert(key, q)
    values = _still(guess.q.size).retract(states)
    values.insert(JOINT, gtsam.Pose3(guess.T_world_joint))
    if guess.kind == "helical":
        values.insert(PITCH, guess.pitch)
    if observations.R_world_part is not None:
        values.insert(REFERENCE, gtsam.Rot3(observations.R_world_part[0]))
    if observations.grasp is not None:
        insert_grasps(values, guess, observations.grasp)
    return values


def grasp_variables(kind: str, observations: Observations) -> GraspVariables:
    """Keys of what the factors of the grasps move."""
    keys = [None, *state_keys(observations.frames)]
    reference = None if observations.R_world_part is None else REFERENCE
    return GraspVariables(JOINT, keys, PITCH if kind == "helical" else None, reference)


def joint_graph(
    kind: str,
    problem: GraphProblem,
    scales: Scales,
    x_start: FloatArray | None,
    last: dict[bytes, TrackCost],
    states: StatePriors | None = None,
) -> gtsam.NonlinearFactorGraph:
    """Observations and priors, without the gauge; `last` keeps the tracks' last evaluation."""
    observations, config = problem.observations, problem.config
    keys = [None, *state_keys(observations.frames)]
    pitch_key = PITCH if kind == "helical" else None
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(
        point_track_factor(
            kind,
            JOINT,
            keys,
            observations.tracks,
            config.dof,
            scales.track,
            x_start,
            last,
            pitch_key,
        )
    )
    dense = observations.dense
    if dense is not None:
        graph.push_back(
            dense_registration_factor(
                kind,
                JOINT,
                [keys[t] for t in dense.frames],
                dense.patches,
                config.dof,
                scales.dense,
                dense.count_as_one,
                pitch_key,
            )
        )
    R = observations.R_world_part
    if R is not None:
        graph.push_back(
            orientation_track_factor(
                kind, JOINT, REFERENCE, keys, R, scales.orientation_rad, config.dof
            )
        )
    if kind != "prismatic":
        median_m, sigma_log = config.prior.hinge_distance_m, config.prior.hinge_distance_sigma_log
        graph.push_back(hinge_distance_factor(JOINT, problem.centroid_world, median_m, sigma_log))
    if pitch_key is not None:
        graph.push_back(pitch_prior_factor(pitch_key, config.prior.pitch_sigma_m_per_rad))
    for factor in [] if states is None else states.factors(keys):
        graph.push_back(factor)
    if observations.grasp is not None:
        graph.push_back(
            grasp_factors(kind, grasp_variables(kind, observations), observations.grasp)
        )
    return graph


def solved(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    kind: str,
    problem: GraphProblem,
    rough: bool,
) -> gtsam.Values:
    """The values that minimise the graph with the gauge held."""
    config = problem.config
    gauged = gtsam.NonlinearFactorGraph(graph)
    heading = values.atPose3(JOINT).rotation()
    gauged.push_back(gauge_factor(kind, JOINT, heading, problem.centroid_world))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(config.rough_iterations if rough else config.max_iterations)
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(config.rough_cost_tolerance if rough else config.cost_tolerance)
    parameters.setlambdaInitial(1e-5)
    return gtsam.LevenbergMarquardtOptimizer(gauged, values, parameters).optimize()


@cache
def _ordering(frames: int, has_pitch: bool, has_reference: bool, holds: int) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    ordering.push_back(JOINT)
    if has_pitch:
        ordering.push_back(PITCH)
    if has_reference:
        ordering.push_back(REFERENCE)
    for key in (*state_keys(frames), *(grasp_key(i) for i in range(holds))):
        ordering.push_back(key)
    return ordering


def graph_information(
    linear: gtsam.GaussianFactorGraph,
    frames: int,
    has_reference: bool,
    directions: tuple[int, ...],
    kind: str,
    holds: int = 0,
) -> FloatArray:
    """Dense information over (observable joint directions, pitch, reference, states).

    Latent grasps, one a hold, are marginalised.
    """
    ordering = _ordering(frames, kind == "helical", has_reference, holds)
    information, _ = linear.hessian(ordering)
    if holds:
        information, _ = without_grasps(information, holds)
    kept = [*directions, *range(6, information.shape[0])]
    return information[np.ix_(kept, kept)]
