"""What tracks say about free rigid motions of their part: a quadratic form over the frames' twists.

For motions M_t that take the part from its reference pose to frame t, and small corrections
M_t Exp(d_t), the point-track cost of `factors.measurements.point_track` with its latent points
marginalised is

    2 cost(d) = twice_cost + 2 g^T d + d^T H d,     d = (d_1, ..., d_T), tangent rotation first,

with e_tn = Exp(-d_t) M_t^-1 p_tn - x_n, hence d e / d d_t = G(x_n) (see `factors.joint`)
and H, g the Schur complement over all x_n (Triggs et al., Bundle adjustment: a modern synthesis,
2000, sec. 6.1). A common correction of all frames is absorbed by the latent points: H d = 0.

Whatever the number of points, a joint can be fitted to the form instead of to the tracks: it is
exact to second order in the distance between the joint's motions and the free ones, which is the
noise where the joint is the right one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factors.measurements.track_cost import (
    TrackCost,
    TrackObservations,
    cost_at,
    first_reference,
)
from factors.measurements.track_information import (
    MOMENT_TWISTS,
    twist_jacobian,
    twist_moments,
    weighted_twist_products,
)
from factors.packed import UNPACK, inverse_and_determinant, rotated, times

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MotionInformation:
    """The tracks' cost around the motions R_world, t_world."""

    R_world: Array  # (T, 3, 3)
    t_world: Array  # (T, 3); p_t = R_t p_ref + t_t
    information: Array  # (6 T, 6 T)
    gradient: Array  # (6 T,)
    x_world: Array  # (3, N) latent points in the reference pose
    d2: Array  # (T, N) squared whitened errors; 0 where not observed


def motion_information(
    R_world: Array,
    t_world: Array,
    tracks: TrackObservations,
    dof: float,
    scale: float,
    x_start: Array | None = None,
) -> MotionInformation:
    """Gauss-Newton form of the tracks' cost at free motions.

    Args:
        R_world: (T, 3, 3).
        t_world: (T, 3).
        tracks: T frames.
        dof: degrees of freedom of the Student-t kernel.
        scale: factor on the observations' standard deviations.
        x_start: (3, N) where to start the latent points.

    Raises:
        ValueError: the number of motions is not that of the frames.
    """
    cost = _taken_back(R_world, t_world, tracks, dof, scale, x_start)
    H, g = _marginal_form(cost)
    return MotionInformation(
        R_world, t_world, information=H, gradient=g, x_world=cost.x_joint, d2=cost.d2
    )


def latent_points(
    R_world: Array,
    t_world: Array,
    tracks: TrackObservations,
    dof: float,
    scale: float,
    x_start: Array | None = None,
) -> tuple[Array, Array]:
    """Latent points (3, N) and squared whitened errors (T, N) alone; arguments as above."""
    cost = _taken_back(R_world, t_world, tracks, dof, scale, x_start)
    return cost.x_joint, cost.d2


def _taken_back(
    R_world: Array,
    t_world: Array,
    tracks: TrackObservations,
    dof: float,
    scale: float,
    x_start: Array | None,
) -> TrackCost:
    """The cost of the points in the reference pose."""
    T = tracks.p_world.shape[0]
    if R_world.shape != (T, 3, 3) or t_world.shape != (T, 3):
        raise ValueError(f"motions {R_world.shape} and {t_world.shape}, tracks have {T} frames")
    z = R_world.transpose(0, 2, 1) @ (tracks.p_world - t_world[:, :, None])
    information = rotated(tracks.information_world, R_world) / scale**2
    if x_start is None:
        x_start = first_reference(z, tracks.observed)
    modes = None if tracks.lasting is None else tracks.lasting.turned(R_world)
    return cost_at(z, information, x_start, dof, modes)


def _marginal_form(cost: TrackCost) -> tuple[Array, Array]:
    """Information (6 T, 6 T) and gradient (6 T,) with the latent points marginalised."""
    W, G = cost.information, twist_jacobian(cost.x_joint)
    e = cost.z_joint - cost.x_joint
    We = times(W, e)
    T, width, N = W.shape
    frames, total = np.arange(T), W.sum(axis=0)
    H = np.zeros((6 * T, 6 * T))
    H.reshape(T, 6, T, 6)[frames, :, frames] = weighted_twist_products(W, G)
    pull = We.sum(axis=0)  # what is left of the latent's own gradient
    if width == 1:
        left = We - W / total * pull
        H -= _isotropic_coupling(W[:, 0], total[0], G)
        return H, _by_twists(left, G).ravel()
    rows = np.empty((6 * T + 1, 3, N))
    rows[-1] = pull
    by_twist = rows[:-1].reshape(T, 6, 3, N)
    for j in range(3):
        by_twist[:, j] = times(W, np.broadcast_to(G[:, j], We.shape))
        np.negative(W[:, UNPACK[j]], out=by_twist[:, 3 + j])
    held = _whitened(total, rows).reshape(6 * T + 1, 3 * N)
    H -= held[:-1] @ held[:-1].T
    g = _by_twists(We, G).ravel() - held[:-1] @ held[-1]
    lasting = cost.lasting
    if lasting is None:
        return H, g
    some = lasting.modes.tracks
    of_a = lasting.pull(e[..., some])
    own = np.concatenate([lasting.by_twists(G).reshape(-1, *of_a.shape), of_a[None]])
    taken = lasting.taken(lasting.left(own, rows[..., some]))
    return H - taken[:-1, :-1], g - taken[:-1, -1]


def _by_twists(v: Array, G: Array) -> Array:
    """G^T v summed over the points, (T, 6), of v (T, 3, N) and twist Jacobians (3, 6, N)."""
    return v.reshape(len(v), -1) @ G.transpose(0, 2, 1).reshape(-1, 6)


def _isotropic_coupling(w: Array, total: Array, G: Array) -> Array:
    """What the latent points take from the information (6 T, 6 T), weights w (T, N) on identities.

    Of frames t and s that is sum_n w_tn w_sn / w_n G_n^T G_n: as G^T G is made of ten moments of
    the points, ten products of the weights will do.
    """
    T, N = w.shape
    shared = w * (twist_moments(G) / total)[:, None]  # (10, T, N)
    by_frames = (shared.reshape(10 * T, N) @ w.T).reshape(10, T * T)
    coupling = (by_frames.T @ MOMENT_TWISTS).reshape(T, T, 6, 6)
    return coupling.swapaxes(1, 2).reshape(6 * T, 6 * T)


def _whitened(packed: Array, v: Array) -> Array:
    """L^-1 v for packed matrices (6, N) = L L^T, L lower triangular, and v (K, 3, N)."""
    inverse, _ = inverse_and_determinant(packed)
    a, b, c, d, e, f = inverse  # = L^-T L^-1: a Cholesky factor from the last row upwards
    m22 = np.sqrt(f)
    m21, m20 = e / m22, c / m22
    m11 = np.sqrt(d - m21**2)
    m10 = (b - m21 * m20) / m11
    m00 = np.sqrt(a - m10**2 - m20**2)
    x, y, z = v[:, 0], v[:, 1], v[:, 2]
    out = np.empty_like(v)
    np.multiply(m00, x, out=out[:, 0])
    out[:, 1] = m10 * x + m11 * y
    out[:, 2] = m20 * x + m21 * y + m22 * z
    return out
