"""What tracks say about free rigid motions of their part: a quadratic form over the frames' twists.

For motions M_t that take the part from its reference pose to frame t, and small corrections
M_t Exp(d_t), the point-track cost of `factors.point_track` with its latent points marginalised is

    2 cost(d) = twice_cost + 2 g^T d + d^T H d,     d = (d_1, ..., d_T), tangent rotation first,

with e_tn = Exp(-d_t) M_t^-1 p_tn - x_n, hence d e / d d_t = G(x_n) (see `factors.joint_motion`)
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

from factors.packed import UNPACK, inverse_and_determinant, rotated, times
from factors.point_track import (
    TrackObservations,
    best_reference,
    first_reference,
    twist_jacobian,
    weighted_twist_products,
)

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
    T, _, N = tracks.p_world.shape
    z, x, W, d2 = _taken_back(R_world, t_world, tracks, dof, scale, x_start)
    G = twist_jacobian(x)
    We = times(W, z - x)
    H = np.zeros((T, 6, T, 6))
    frames = np.arange(T)
    H[frames, :, frames] = weighted_twist_products(W, G)
    g = (We.reshape(T, -1) @ G.transpose(0, 2, 1).reshape(3 * N, 6)).ravel()
    F = _weighted_jacobian(W, G)
    pulls = np.concatenate([F.reshape(3, N, 6 * T), We.sum(axis=0)[:, :, None]], axis=2)
    held = _whitened(W.sum(axis=0), pulls).reshape(3 * N, 6 * T + 1)
    held, pull = held[:, :-1], held[:, -1]
    return MotionInformation(
        R_world=R_world,
        t_world=t_world,
        information=H.reshape(6 * T, 6 * T) - held.T @ held,
        gradient=g - held.T @ pull,
        x_world=x,
        d2=d2,
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
    _, x, _, d2 = _taken_back(R_world, t_world, tracks, dof, scale, x_start)
    return x, d2


def _taken_back(
    R_world: Array,
    t_world: Array,
    tracks: TrackObservations,
    dof: float,
    scale: float,
    x_start: Array | None,
) -> tuple[Array, Array, Array, Array]:
    """Points (T, 3, N) in the reference pose, latent points, weights (T, 6, N), squared errors."""
    T = tracks.p_world.shape[0]
    if R_world.shape != (T, 3, 3) or t_world.shape != (T, 3):
        raise ValueError(f"motions {R_world.shape} and {t_world.shape}, tracks have {T} frames")
    z = R_world.transpose(0, 2, 1) @ (tracks.p_world - t_world[:, :, None])
    information = rotated(tracks.information_world, R_world) / scale**2
    if x_start is None:
        x_start = first_reference(z, tracks.observed)
    x, W, d2 = best_reference(z, information, x_start, dof)
    return z, x, W, d2


def _weighted_jacobian(W: Array, G: Array) -> Array:
    """W G (3, N, T, 6) of weights (T, 6 or 1, N) and twist Jacobians (3, 6, N)."""
    rows, w = G.transpose(0, 2, 1)[:, :, None], W.transpose(1, 2, 0)[..., None]
    if len(w) == 1:
        return rows * w
    return np.stack([sum(w[UNPACK[a, b]] * rows[b] for b in range(3)) for a in range(3)])


def _whitened(packed: Array, v: Array) -> Array:
    """L^-1 v for packed matrices (6 or 1, N) = L L^T, L lower triangular, and v (3, N, ...)."""
    inverse, _ = inverse_and_determinant(packed)
    if len(inverse) == 1:
        return np.sqrt(inverse)[..., None] * v
    a, b, c, d, e, f = inverse  # = L^-T L^-1: a Cholesky factor from the last row upwards
    m22 = np.sqrt(f)
    m21, m20 = e / m22, c / m22
    m11 = np.sqrt(d - m21**2)
    m10 = (b - m21 * m20) / m11
    m00 = np.sqrt(a - m10**2 - m20**2)
    zero = np.zeros_like(m00)
    root = np.array([[m00, zero, zero], [m10, m11, zero], [m20, m21, m22]])
    return np.einsum("abn,bnk->ank", root, v)
