"""Priors of a joint and of its states: densities for the evidence, factors for the graph."""

from __future__ import annotations

import math

import gtsam
import numpy as np

from akm_fg.estimation.config import PriorConfig
from akm_fg.records import FloatArray
from factors.joint import Joint
from factors.joint_variables import JointVariables
from factors.priors.hinge_distance import hinge_distance_factor
from factors.priors.pitch_prior import pitch_log_density, pitch_prior_factor


def joint_prior_factors(
    variables: JointVariables, centroid_world: FloatArray, prior: PriorConfig
) -> list[gtsam.NonlinearFactor]:
    """What is known of a joint of this kind beforehand; its axis is uniform and has no factor."""
    factors: list[gtsam.NonlinearFactor] = []
    if variables.kind.turns:
        median_m, sigma_log = prior.hinge_distance_m, prior.hinge_distance_sigma_log
        key = variables.joint_key
        factors.append(hinge_distance_factor(key, centroid_world, median_m, sigma_log))
    if variables.pitch_key is not None:
        factors.append(pitch_prior_factor(variables.pitch_key, prior.pitch_sigma_m_per_rad))
    return factors


def metres_per_unit(joint: Joint, centroid_world: FloatArray, lever_m: float) -> float:
    """How far the part moves when its state grows by one: root mean square over its points.

    Args:
        joint: the joint.
        centroid_world: (3,) of the points at state zero.
        lever_m: root mean square size of the part about it.
    """
    if not joint.kind.turns:
        return 1.0
    rho2 = _hinge_distance(joint, centroid_world) ** 2
    return math.sqrt(rho2 + lever_m**2 + joint.pitch**2)


def log_state_prior(q: FloatArray, metres: float, prior: PriorConfig) -> float:
    """Log prior density of one state of q (T,), per unit of the state.

    How far the part was moved is not known beforehand: its travel L is log-uniform between the
    least and the largest of the configuration, state zero lies anywhere in it, and the states, in
    metres of displacement, are uniform over it. With travel and place integrated out, n states
    that spread over R have the density

        R^-n / (n (n + 1) log(L_max / L_min)),

    which pulls nowhere within the travel and takes no more from a small motion than from a large
    one. It is the same for every moving kind.

    Args:
        q: states, the first zero.
        metres: see `metres_per_unit`.
        prior: holds the ends of the travel.
    """
    n = q.size - 1
    spread = min(max(metres * float(np.ptp(q)), prior.least_travel_m), prior.largest_travel_m)
    range_log = math.log(prior.largest_travel_m / prior.least_travel_m)
    return math.log(metres / spread) - math.log(n * (n + 1) * range_log) / n


def log_joint_prior(joint: Joint, centroid_world: FloatArray, prior: PriorConfig) -> float:
    """Log prior density over axis direction and position (and pitch) at a solution.

    Axis uniform on the half sphere (its sign is a convention); hinge distance log-normal, hinge
    bearing uniform; pitch normal. The flat priors of the orientation reference and of the latent
    points are the same for every kind and left out.
    """
    total = -math.log(2 * math.pi)
    if joint.kind.turns:
        rho = _hinge_distance(joint, centroid_world)
        z = math.log(rho / prior.hinge_distance_m) / prior.hinge_distance_sigma_log
        total += -0.5 * z**2 - math.log(prior.hinge_distance_sigma_log * math.sqrt(2 * math.pi))
        total -= math.log(2 * math.pi * rho**2)
    if joint.kind.has_pitch:
        total += pitch_log_density(joint.pitch, prior.pitch_sigma_m_per_rad)
    return total


def _hinge_distance(joint: Joint, centroid_world: FloatArray) -> float:
    c = joint.R_world_joint.T @ (centroid_world - joint.origin)
    return max(math.hypot(c[0], c[1]), 1e-6)
