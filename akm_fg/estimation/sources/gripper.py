"""The gripper's poses in the graphs of all kinds: holds, their variables, what they contribute.

A first fit says where the part was in every frame, and so in which frames the gripper kept its
place in the part: those are holds, the same for all kinds. Each hold has one grasp, a variable of
the graph in GTSAM and marginalised in the Laplace approximation; its prior is flat and the same for
every kind, rigid included.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import FitConfig, GraspConfig
from akm_fg.estimation.given.initial_guess import JointGuess
from akm_fg.estimation.given.knowledge import GripperPoses
from akm_fg.records import FloatArray
from factors.measurements.grasp_pose import (
    grasp_log_normaliser,
    grasp_pose_factor,
    grasps_in_joint,
    hold_starts,
    typical_grasp,
)

_LEAST_FRAMES = 2  # one alone says only where it is itself


@dataclass(frozen=True, slots=True)
class Hold:
    """Frames in which the gripper keeps its place in the part."""

    frames: NDArray[np.int_]  # (F,) of the graph
    T_world_gripper: FloatArray  # (F, 4, 4)


@dataclass(frozen=True, slots=True)
class GraspObservations:
    """The holds of a graph's frames."""

    holds: tuple[Hold, ...]
    noise: GraspConfig
    count_as_one: float  # frames that err together, over observations of the tracks that do


@dataclass(frozen=True, slots=True)
class GraspFit:
    """What the holds contribute to one kind's Laplace approximation, counted as in the graph."""

    log_likelihood: float  # normalised Student-t, at the best grasps
    log_det: float  # of the information on the grasps, all else held
    variables: int  # six a hold
    held: FloatArray  # (T - 1,) information on each free state, all else held
    information: FloatArray  # (d, d) over (joint, pitch, reference, states), grasps marginalised
    cov_factor: float  # true variances over those of `information`


@dataclass(frozen=True, slots=True)
class GraspVariables:
    """Keys of what else the holds' factors move."""

    joint: int
    states: Sequence[int | None]  # (T,) of the graph's frames; None where the state is zero
    pitch: int | None = None  # of a helical joint
    reference: int | None = None  # of orientations, where they are seen; no hold's matter


def grasp_key(hold: int) -> int:
    """Key of T_joint_grasp of a hold."""
    return gtsam.symbol("g", hold)


def holds_of(
    gripper: GripperPoses,
    keyframes: NDArray[np.int_],
    guess: JointGuess,
    state_sd: FloatArray,
    as_one: float,
) -> GraspObservations | None:
    """Where the gripper held, judged by a fit to the camera's data; None where that is nowhere.

    Args:
        gripper: its poses in all frames.
        keyframes: (K,) frames in the graph.
        guess: the fitted joint; rigid as a prismatic joint that stays at zero.
        state_sd: (K,) standard deviations of its states.
        as_one: observations of the tracks that count as one.
    """
    first, last = gripper.grasp_frames
    held = np.flatnonzero((keyframes >= first) & (keyframes <= last))
    if held.size < _LEAST_FRAMES:
        return None
    poses, noise = gripper.T_world_gripper[keyframes[held]], gripper.noise
    grasps = grasps_in_joint(guess.kind, guess.T_world_joint, guess.q[held], poses, guess.pitch)
    turn, slide = _state_noise(guess, grasps, float(np.median(state_sd[held])))
    starts = hold_starts(
        grasps,
        math.hypot(noise.sigma_rot_rad, turn),
        math.hypot(noise.sigma_trans_m, slide),
        noise.dof,
    )
    holds = tuple(
        Hold(held[a:b], poses[a:b])
        for a, b in pairwise([*starts.tolist(), held.size])
        if b - a >= _LEAST_FRAMES
    )
    return GraspObservations(holds, noise, noise.frames_as_one / as_one) if holds else None


def _state_noise(guess: JointGuess, grasps: FloatArray, sd: float) -> tuple[float, float]:
    """What the states' noise adds to the grasps', radians and metres."""
    if guess.kind == "prismatic":
        return 0.0, sd
    lever = float(np.median(np.hypot(grasps[:, 0, 3], grasps[:, 1, 3])))
    return sd, sd * math.hypot(lever, guess.pitch)


def insert_grasps(values: gtsam.Values, guess: JointGuess, grasp: GraspObservations) -> None:
    """The grasps that the frames of each hold agree on under a guess."""
    for i, hold in enumerate(grasp.holds):
        each = grasps_in_joint(
            guess.kind, guess.T_world_joint, guess.q[hold.frames], hold.T_world_gripper, guess.pitch
        )
        start = typical_grasp(each, grasp.noise.sigma_rot_rad, grasp.noise.sigma_trans_m)
        values.insert(grasp_key(i), gtsam.Pose3(start))


def grasp_factors(
    kind: str, variables: GraspVariables, grasp: GraspObservations
) -> gtsam.NonlinearFactorGraph:
    """One factor a hold; nothing moved: a prismatic joint with no state free."""
    graph = gtsam.NonlinearFactorGraph()
    for i, hold in enumerate(grasp.holds):
        graph.push_back(
            grasp_pose_factor(
                kind,
                variables.joint,
                grasp_key(i),
                [variables.states[t] for t in hold.frames],
                hold.T_world_gripper,
                grasp.noise.sigma_rot_rad,
                grasp.noise.sigma_trans_m,
                grasp.noise.dof,
                variables.pitch,
                grasp.count_as_one,
            )
        )
    return graph


def grasp_fit(
    kind: str,
    values: gtsam.Values,
    variables: GraspVariables,
    directions: tuple[int, ...],
    grasp: GraspObservations,
) -> GraspFit:
    """What the holds contribute at a kind's solution.

    Args:
        kind: joint kind.
        values: the solution.
        variables: of the kind's graph.
        directions: tangent indices of T_world_joint that are variables.
        grasp: the holds.
    """
    graph = grasp_factors(kind, variables, grasp)
    linear, ordering = graph.linearize(values), gtsam.Ordering()
    ordering.push_back(variables.joint)
    # What touches no hold (a reference, states of other frames) gets zero rows: it keeps its place.
    states = [key for key in variables.states if key is not None]
    beside = [(key, 1) for key in (variables.pitch,) if key is not None]
    beside += [(key, 3) for key in (variables.reference,) if key is not None]
    unit = gtsam.noiseModel.Unit.Create(1)
    for key, dim in [*beside, *((key, 1) for key in states)]:
        linear.push_back(gtsam.JacobianFactor(key, np.zeros((1, dim)), np.zeros(1), unit))
        ordering.push_back(key)
    for i in range(len(grasp.holds)):
        ordering.push_back(grasp_key(i))
    H, _ = linear.hessian(ordering)
    marginal, log_det = without_grasps(H, len(grasp.holds))
    size = marginal.shape[0]
    kept = [*directions, *range(6, size)]
    return GraspFit(
        log_likelihood=_log_normaliser(grasp) - graph.error(values),
        log_det=log_det,
        variables=6 * len(grasp.holds),
        held=np.diag(H)[size - len(states) : size].copy(),
        information=marginal[np.ix_(kept, kept)],
        cov_factor=_cov_factor(grasp),
    )


def rigid_grasp_fit(grasp: GraspObservations, config: FitConfig) -> GraspFit:
    """What the holds say if nothing moved: every hold's best pose."""
    frames = 1 + max(int(hold.frames.max()) for hold in grasp.holds)
    variables = GraspVariables(gtsam.symbol("j", 0), [None] * frames)
    values = gtsam.Values()
    values.insert(variables.joint, gtsam.Pose3())
    insert_grasps(values, JointGuess("prismatic", np.eye(4), np.zeros(frames)), grasp)
    graph = grasp_factors("prismatic", variables, grasp)
    # Joint and grasps move the same poses: the joint is held, which costs nothing.
    held = gtsam.noiseModel.Unit.Create(6)
    graph.push_back(gtsam.PriorFactorPose3(variables.joint, gtsam.Pose3(), held))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(config.rough_iterations)
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(config.cost_tolerance)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return grasp_fit("prismatic", values, variables, (), grasp)


def without_grasps(information: FloatArray, holds: int) -> tuple[FloatArray, float]:
    """The information with its last variables, the grasps, marginalised, and their log det."""
    size = information.shape[0] - 6 * holds
    own, cross = information[size:, size:], information[:size, size:]
    marginal = information[:size, :size] - cross @ np.linalg.solve(own, cross.T)
    return (marginal + marginal.T) / 2, float(np.linalg.slogdet(own)[1])


def _cov_factor(grasp: GraspObservations) -> float:
    """Of the claimed noise: one in `frames_as_one` counts, whatever the graph counts.

    The weighted Gauss-Newton information of p-dimensional Student-t noise is (dof + p + 2) /
    (dof + p) times the Fisher information (Lange, Little and Taylor, 1989).
    """
    noise = grasp.noise
    return noise.frames_as_one / grasp.count_as_one * (noise.dof + 8) / (noise.dof + 6)


def _log_normaliser(grasp: GraspObservations) -> float:
    noise = grasp.noise
    frames = sum(hold.frames.size for hold in grasp.holds)
    one = grasp_log_normaliser(frames, noise.sigma_rot_rad, noise.sigma_trans_m, noise.dof)
    return one / grasp.count_as_one
