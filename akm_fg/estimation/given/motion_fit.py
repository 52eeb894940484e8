"""A joint fitted to the free rigid motions of its part: the start of every graph.

The tracks speak through `factors.motion_information` alone, so a fit costs milliseconds however
many points there are, and several starts can be tried. For a joint's motions
M_t = T Exp(q_t S) T^-1, the corrections of the free motions are d_t = Log(Mfree_t^-1 M_t).

A hinge is stepped in coordinates in which the cost is nearly quadratic: tilt of the axis, log of
its distance rho from the part, bearing from there, and states as arcs s_t = rho q_t. In radians
and metres, far hinges lie along a curved valley in which rho and all q_t must change together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from akm_fg.estimation.config import PriorConfig
from akm_fg.estimation.given.guesses import MAX_RADIUS_M
from akm_fg.geometry.batches import solutions
from akm_fg.geometry.joint_guess import JointGuess, joint_frame
from akm_fg.records import FloatArray
from factors.joint import Joint, JointKind, cross
from factors.measurements.orientation_track import log_so3
from factors.motion_information import MotionInformation
from factors.priors.pitch_prior import pitch_prior_residual

_ITERATIONS = 25
_TOLERANCE = 0.02  # nats gained by a step that is the last
_RELATIVE_TOLERANCE = 1e-3  # of a cost that no joint of this kind will bring down
_MAX_DAMPING = 1e6
_UNSEEN = 1e-12  # of the largest information: holds a state that nothing tells of where it is
_MAX_LOG_STEP = 1.5  # of the hinge distance in one step


@dataclass(frozen=True, slots=True)
class MotionFit:
    """A joint near the free motions."""

    guess: JointGuess  # its origin is the point of the axis nearest to the part
    corrections: FloatArray  # (6 T,) from the free motions to the joint's
    rho: float  # distance of a hinge from the part's centroid, metres; 1 for a prismatic joint
    twice_cost: float  # above that of the free motions themselves, priors included


def fit_to_motions(
    guess: JointGuess, motions: MotionInformation, centroid_world: FloatArray, prior: PriorConfig
) -> MotionFit:
    """Levenberg-Marquardt from one start.

    Args:
        guess: kind and start, over the frames of `motions`.
        motions: the free motions; that of frame 0 is the identity.
        centroid_world: (3,) of the moving points in frame 0.
        prior: of the hinge distance and the pitch.
    """
    return refined(evaluate(guess, motions, centroid_world, prior), motions, centroid_world, prior)


def refined(
    here: MotionFit, motions: MotionInformation, centroid_world: FloatArray, prior: PriorConfig
) -> MotionFit:
    """Levenberg-Marquardt from an evaluated start; arguments as of `fit_to_motions`."""
    damping = 1e-4
    for _ in range(_ITERATIONS):
        H, g = _normal_equations(here, motions, prior)
        diagonal = H.diagonal().copy()
        largest = float(diagonal.max())
        if not 0 < largest < np.inf:  # the motions tell nothing that a step could be taken by
            return here
        scale = np.maximum(diagonal, _UNSEEN * largest)
        gained = -1.0
        while damping < _MAX_DAMPING:
            H.flat[:: len(g) + 1] = diagonal + damping * scale
            step = solutions(H, -g[:, None])[:, 0]
            if not np.isfinite(step).all():  # singular to rounding: nearer to the gradient
                damping *= 10
                continue
            there = evaluate(_stepped(here, step), motions, centroid_world, prior)
            gained = here.twice_cost - there.twice_cost
            if gained >= 0:
                here, damping = there, max(damping / 10, 1e-9)
                break
            damping *= 10
        if gained < max(2 * _TOLERANCE, _RELATIVE_TOLERANCE * here.twice_cost):
            break
    return here


def evaluate(
    guess: JointGuess, motions: MotionInformation, centroid_world: FloatArray, prior: PriorConfig
) -> MotionFit:
    """What a guess costs; arguments as of `fit_to_motions`."""
    T, rho = nearest_origin(guess.joint, centroid_world)
    joint = replace(guess.joint, T_world_joint=T)
    R, t = joint.motion(guess.q)
    R_free_t = motions.R_world.transpose(0, 2, 1)
    t_free = (R_free_t @ (t - motions.t_world)[:, :, None])[:, :, 0]
    d = log_se3(R_free_t @ R, t_free).ravel()
    cost = float(d @ (2 * motions.gradient + motions.information @ d))
    if joint.kind.turns:
        cost += (math.log(rho / prior.hinge_distance_m) / prior.hinge_distance_sigma_log) ** 2
    if joint.kind.has_pitch:
        cost += pitch_prior_residual(joint.pitch, prior.pitch_sigma_m_per_rad)[0] ** 2
    return MotionFit(JointGuess(joint, guess.q), d, rho, cost)


def bent_drawer(
    drawer: MotionFit, motions: MotionInformation, centroid_world: FloatArray
) -> JointGuess:
    """The far hinge that a drawer's motions allow, to first order in its curvature.

    A drawer bent by the curvature vector k (3,), across its axis a, turns by s_t k on the way s_t
    and leaves the line by s_t^2 / 2 (k x a): linear in k. Its hinge is 1 / |k| away along k x a.
    """
    guess = drawer.guess
    a, s, T = guess.joint.axis, guess.q, guess.q.size
    across = guess.joint.T_world_joint[:3, :2].T
    J = np.zeros((T, 6, 4))  # by the tilt of the axis and by the curvature
    J[:, :, :2] = guess.joint.motion_jacobians(s)[0][:, :, :2]
    for i, k in enumerate(across):
        J[:, :3, 2 + i] = s[:, None] * k
        J[:, 3:, 2 + i] = s[:, None] * cross(centroid_world, k)
        J[:, 3:, 2 + i] += 0.5 * s[:, None] ** 2 * cross(k, a)
    along = np.concatenate([np.zeros(3), a])
    H, g = _with_states(J.reshape(6 * T, 4), along, drawer.corrections, motions)
    of_states = H[4:, 4:] + _UNSEEN * H.diagonal().max() * np.eye(T - 1)
    held = solutions(of_states, np.column_stack([H[4:, :4], g[4:]]))
    left = np.column_stack([H[:4, :4], g[:4]]) - H[:4, 4:] @ held  # states eliminated
    if not np.isfinite(left).all():  # nothing tells of the states, nor of a curvature
        left = np.zeros((4, 5))
    step = -np.linalg.lstsq(left[:, :4], left[:, 4])[0]
    k = across.T @ step[2:]
    size = float(np.linalg.norm(k))
    rho = 1 / max(size, 1 / MAX_RADIUS_M)
    n = k / size if size > 1e-12 else across[0]  # exactly straight: bent in any direction as little
    hinge = centroid_world + rho * cross(n, a)
    return JointGuess(Joint(JointKind.REVOLUTE, joint_frame(n, hinge), 0.0), s / rho)


def nearest_origin(joint: Joint, centroid_world: FloatArray) -> tuple[FloatArray, float]:
    """T_world_joint (4, 4) with its origin on the axis nearest to the centroid, and the distance.

    x points away from the centroid. Of a prismatic joint: the centroid itself, and 1.
    """
    T = joint.T_world_joint.copy()
    if not joint.kind.turns:
        T[:3, 3] = centroid_world
        return T, 1.0
    z, offset = T[:3, 2], T[:3, 3] - centroid_world
    away = offset - z * (z @ offset)
    rho = float(np.linalg.norm(away))
    if rho < 1e-6:
        return T, 1e-6
    T[:3, 3] = centroid_world + away
    T[:3, 0] = away / rho
    T[:3, 1] = cross(z, T[:3, 0])
    return T, rho


def _normal_equations(
    fit: MotionFit, motions: MotionInformation, prior: PriorConfig
) -> tuple[FloatArray, FloatArray]:
    """Information and gradient over (tilt x, tilt y, [log rho, bearing, [pitch,]] s_1..)."""
    guess, rho = fit.guess, fit.rho
    T, hinged = guess.q.size, guess.kind.turns
    by_xi, by_state, by_pitch = guess.joint.motion_jacobians(guess.q)
    J = np.empty((T, 6, guess.kind.coordinates))
    J[:, :, :2] = by_xi[:, :, :2]
    if hinged:  # x points away from the part, y across; the arcs are held
        J[:, :, 2] = rho * by_xi[:, :, 3] - guess.q[:, None] * by_state
        J[:, :, 3] = rho * by_xi[:, :, 4]
    if guess.kind.has_pitch:
        J[:, :, 4] = by_pitch
    H, g = _with_states(J.reshape(6 * T, -1), by_state[0] / rho, fit.corrections, motions)
    if hinged:
        precision = prior.hinge_distance_sigma_log**-2
        H[2, 2] += precision
        g[2] += precision * math.log(rho / prior.hinge_distance_m)
    if guess.kind.has_pitch:
        e, slope = pitch_prior_residual(guess.joint.pitch, prior.pitch_sigma_m_per_rad)
        H[4, 4] += slope**2
        g[4] += slope * e
    return H, g


def _with_states(
    J: FloatArray, arc: FloatArray, d: FloatArray, motions: MotionInformation
) -> tuple[FloatArray, FloatArray]:
    """Information and gradient (k + T - 1) over the k columns of J and s_1 .. s_T-1.

    Args:
        J: (6 T, k) Jacobian of the corrections of all motions.
        arc: (6,) twist of a frame by its own state, the same for all frames.
        d: (6 T,) corrections.
        motions: the quadratic form.
    """
    T, k = J.shape[0] // 6, J.shape[1]
    HJd = motions.information @ np.column_stack([J, d])
    slope = motions.gradient + HJd[:, k]
    by_arc = (motions.information.reshape(-1, 6) @ arc).reshape(T, 6, T)
    H = np.empty((k + T - 1, k + T - 1))
    H[:k, :k] = J.T @ HJd[:, :k]
    H[k:, :k] = (arc @ HJd.reshape(T, 6, k + 1))[1:, :k]
    H[:k, k:] = H[k:, :k].T
    H[k:, k:] = (arc @ by_arc)[1:, 1:]
    return H, np.concatenate([J.T @ slope, slope.reshape(T, 6)[1:] @ arc])


def _stepped(fit: MotionFit, step: FloatArray) -> JointGuess:
    """The guess moved by a step over the coordinates of `_normal_equations`."""
    guess, rho = fit.guess, fit.rho
    T = guess.joint.T_world_joint.copy()
    arcs, new_rho = step[guess.kind.coordinates :], rho
    if guess.kind.turns:
        new_rho = rho * math.exp(min(max(float(step[2]), -_MAX_LOG_STEP), _MAX_LOG_STEP))
        bearing = float(step[3])
        centroid = T[:3, 3] - rho * T[:3, 0]
        T[:3, 3] = centroid + new_rho * (
            math.cos(bearing) * T[:3, 0] + math.sin(bearing) * T[:3, 1]
        )
    T[:3, :3] = T[:3, :3] @ gtsam.Rot3.Expmap(np.array([step[0], step[1], 0.0])).matrix()
    q = (rho * guess.q + np.concatenate([[0.0], arcs])) / new_rho
    pitch = guess.joint.pitch + float(step[4]) if guess.kind.has_pitch else 0.0
    return JointGuess(Joint(guess.kind, T, pitch), q)


def log_se3(R: FloatArray, t: FloatArray) -> FloatArray:
    """Logarithms (T, 6), rotation first, of motions whose rotations are short of pi.

    Lynch and Park, Modern Robotics, 2017, eqs. 3.61 and 3.91.
    """
    w = log_so3(R)
    angle2 = (w * w).sum(axis=1)
    half = 0.5 * np.sqrt(np.maximum(angle2, 1e-8))
    c = np.where(angle2 < 1e-8, 1 / 12, 0.25 * (1 - half / np.tan(half)) / half**2)
    # inverse V t = t - w x t / 2 + c w x (w x t)
    turned = w[:, [1, 2, 0]] * t[:, [2, 0, 1]] - w[:, [2, 0, 1]] * t[:, [1, 2, 0]]
    d = np.empty((len(t), 6))
    d[:, :3] = w
    d[:, 3:] = (1 - c * angle2)[:, None] * t - 0.5 * turned
    d[:, 3:] += (c * (w * t).sum(axis=1))[:, None] * w
    return d
