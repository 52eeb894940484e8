"""What a further stretch of pull would tell of the joint, before it is pulled.

Points of the part seen along states 0..q, all alike and independent, tell the joint

    D(q) = sum_tn J_tn^T J_tn - (states and reference points marginalised),

up to the noise: J are the derivatives of reference coordinates (`factors.joint`), whose mean over
the frames falls to the latent point, and whose part along the path to the frame's own state. The
noise level, correlations and errors that all frames share are in the covariance P that the
estimator gives now; the level k with which k D(q) says as much as P^-1 is

    k = d / trace(D(q) P),      and then      P' = (P^-1 + k (D(q') - D(q)))^-1

after a stretch to q', d being the number of the joint's coordinates that can be known. What no
pull can better, such as the camera's calibration, is in P too: P' is the best to hope for, and the
stop rule looks at what past stretches have really brought as well (`stopping`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from akm_fg.exploration.records import Bounds
from akm_fg.posterior import JointPosterior
from akm_fg.records import FloatArray
from factors.joint import Joint, skew

MOST_POINTS = 60  # their spread counts, not their number
PLACES = 8  # along the path at which the information is summed


@dataclass(frozen=True, slots=True)
class Pulled:
    """The pull so far: states from 0 to here, looked at in so many frames."""

    state: float  # m or rad
    frames: int


def bounds_of(joint: JointPosterior) -> Bounds:
    """The bounds that a posterior claims."""
    return Bounds(
        joint.axis_bound_rad(), joint.pivot_bound_m(), joint.axis_sd_rad, joint.pivot_sd_m
    )


def foreseen(
    joint: JointPosterior, points_world: FloatArray, now: Pulled, then: Pulled
) -> JointPosterior:
    """The joint's posterior as it is expected after a further stretch.

    Args:
        joint: as it is known now.
        points_world: (N, 3) of the part, where they are at state zero.
        now: the pull until now.
        then: and after the stretch.
    """
    known = list(joint.kind.observable)
    cov = joint.cov[np.ix_(known, known)]
    before = information(joint.joint, points_world, now)
    gained = information(joint.joint, points_world, then) - before
    told = float(np.trace(before @ cov))
    if len(points_world) < 1 or not told > 0.0:
        return joint
    level = len(known) / told
    # With as many frames as before and more to come nothing is lost: rounding aside.
    values, vectors = np.linalg.eigh(gained)
    gained = (vectors * np.maximum(values, 0.0)) @ vectors.T
    # (P^-1 + k G)^-1 = P - P (k^-1 G^-1 + P)^-1 P needs no inverse of a P that has zeros.
    after = cov @ np.linalg.inv(np.eye(len(known)) + level * gained @ cov)
    whole = joint.cov.copy()
    whole[np.ix_(known, known)] = 0.5 * (after + after.T)
    return replace(joint, cov=whole)


def information(joint: Joint, points_world: FloatArray, pulled: Pulled) -> FloatArray:
    """D (d, d) over the joint's observable tangent directions, of unit noise; see the module."""
    known = list(joint.kind.observable)
    if len(points_world) == 0 or pulled.frames < 2:
        return np.zeros((len(known), len(known)))
    chosen = np.linspace(0, len(points_world) - 1, min(len(points_world), MOST_POINTS)).astype(int)
    p = points_world[chosen].T[None]  # (1, 3, N)
    z = joint.reference_coordinates(np.zeros(1), p)[0].T  # (N, 3)
    q = np.linspace(0.0, pulled.state, min(pulled.frames, PLACES))
    G = np.concatenate([skew(z), np.broadcast_to(-np.eye(3), (len(z), 3, 3))], axis=2)  # (N, 3, 6)
    by_xi = np.einsum("nij,tjk->tnik", G, joint.adjoint_of_return(q))[..., known]  # (T, N, 3, d)
    along = G @ joint.unit_twist  # (N, 3), the same in all frames
    size = len(known) + q.size - 1
    J = np.zeros((q.size, len(z), 3, size))
    J[..., : len(known)] = by_xi
    for t in range(1, q.size):
        J[t, :, :, len(known) + t - 1] = along
    J -= J.mean(axis=0)
    flat = J.reshape(-1, size)
    whole = flat.T @ flat
    d = len(known)
    states = whole[d:, d:] + 1e-12 * np.trace(whole) * np.eye(size - d)
    schur = whole[:d, :d] - whole[:d, d:] @ np.linalg.solve(states, whole[d:, :d])
    frames = pulled.frames / q.size * len(points_world) / len(z)
    return np.asarray(frames * 0.5 * (schur + schur.T))
