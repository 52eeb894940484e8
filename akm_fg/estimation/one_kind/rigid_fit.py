"""The hypothesis that nothing moved: latent points alone, no joint and no graph."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from akm_fg.estimation.given.initial_guess import JointGuess
from akm_fg.estimation.given.observations import (
    CHI2_MEDIAN,
    T_OVER_NORMAL,
    log_likelihood,
    orientation_errors,
    orientation_information,
    robust_mean_orientation,
    updated_scales,
)
from akm_fg.estimation.one_kind.joint_graph import GraphProblem
from akm_fg.estimation.one_kind.kind_fit import guess_cost, patches_cost
from akm_fg.estimation.one_kind.kind_laplace import log_latents
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.estimation.sources.gripper import rigid_grasp_fit
from factors.measurements.track_cost import track_cost


def fit_rigid(problem: GraphProblem) -> KindFit:
    """Nothing moved: the latent points alone, with their own noise scale."""
    observations, config = problem.observations, problem.config
    q, still = np.zeros(observations.frames), np.eye(4)
    R = observations.R_world_part
    R_ref = None if R is None else robust_mean_orientation(R)
    errors = orientation_errors("prismatic", still, q, R_ref, observations)
    still_guess = JointGuess("prismatic", still, q)
    scales, x = problem.start, None
    if observations.tracks.observed.any():
        track = T_OVER_NORMAL * math.sqrt(guess_cost(still_guess, observations) / CHI2_MEDIAN)
        scales = replace(scales, track=max(track, scales.track))
    for _ in range(config.scale_iterations):
        cost = track_cost("prismatic", still, q, observations.tracks, config.dof, scales.track, x)
        dense = patches_cost(still_guess, problem, scales)
        new = updated_scales(cost.d2, errors, 0, scales, observations, config, dense)
        change, scales, x = scales.change(new), new, cost.x_joint
        if change < config.rough_scale_tolerance:  # far off or not: a nat does not matter here
            break
    cost = track_cost("prismatic", still, q, observations.tracks, config.dof, scales.track, x)
    dense = patches_cost(still_guess, problem, scales)
    likelihood = log_likelihood(cost.d2, errors, scales, observations, config, dense)
    grasp = None
    if observations.grasp is not None:
        grasp = rigid_grasp_fit(observations.grasp, config)
        likelihood += grasp.log_likelihood
    log_det = 0.0
    if errors is not None:
        log_det = 3 * math.log(orientation_information(errors, scales, config).sum())
    return KindFit(
        kind="rigid",
        T_world_joint=None,
        q=q,
        cov=np.zeros((q.size - 1, q.size - 1)),
        information=np.zeros((q.size - 1, q.size - 1)),
        dense_information=np.zeros((q.size - 1, q.size - 1)),
        joint_directions=(),
        scales=scales,
        log_likelihood=likelihood,
        log_prior=0.0,
        log_frames=likelihood,
        log_latents=log_latents(cost),
        log_det=log_det,
        tau=1.0,
        cov_factor=1.0,
        d2=cost.d2 * scales.track**2,
        residual_joint=(cost.z_joint - cost.x_joint).swapaxes(1, 2),
        x_joint=cost.x_joint,
        has_reference=errors is not None,
        pitch=0.0,
        dense_cost=dense,
        freedom=observations.freedom(0),
        grasp=grasp,
        log_noise=observations.log_noise(scales),
    )
