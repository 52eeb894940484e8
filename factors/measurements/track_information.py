"""Gauss-Newton information of the point tracks' cost, latent points marginalised or held.

The twist Jacobian G(x_n) does not depend on the frame (see `factors.measurements.point_track`), so
that sums over points and frames are products of matrices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from factors.joint import Joint, skew
from factors.measurements.lasting_errors import Marginal, Slips
from factors.measurements.track_cost import TrackCost, TrackObservations, taken_back
from factors.packed import (
    COL,
    ROW,
    UNPACK,
    inverse_and_determinant,
    squared_length,
    times,
)
from factors.student_t import weight

Array = NDArray[np.float64]


def track_normal_equations(joint: Joint, q: Array, cost: TrackCost) -> tuple[Array, Array]:
    """Information (d, d) and gradient (d,), latent points marginalised.

    Over (xi, q), d = 6 + T; of a helical joint over (xi, q, pitch), d = 7 + T.
    """
    W = cost.information
    T, _, N = W.shape
    adjoint, G = joint.adjoint_of_return(q), twist_jacobian(cost.x_joint)
    e = cost.z_joint - cost.x_joint
    We = times(W, e)
    H, g = _with_latent_points_held(joint, q, adjoint, W, We, G)
    # What couples a point to the variables, one row each, and what is left of its own gradient.
    rows = np.empty((len(g) + 1, 3, N))
    moved = (adjoint.reshape(T, 36).T @ W.reshape(T, -1)).reshape(6, 6, W.shape[1], N)
    rows[:6] = _twisted(moved, G)
    direction = joint.unit_twist @ G  # (3, N)
    rows[6 : 6 + T] = times(W, np.broadcast_to(direction, We.shape))
    if joint.kind.has_pitch:
        rows[-2] = _times_minus_z((q @ W.reshape(T, -1)).reshape(W.shape[1:]))
    rows[-1] = We.sum(axis=0)
    held = times(inverse_and_determinant(W.sum(axis=0))[0][None], rows)
    marginalised = rows[:-1].reshape(len(g), 3 * N) @ held.reshape(len(g) + 1, 3 * N).T
    if cost.lasting is not None:
        marginalised += _lasting(joint, q, adjoint, cost.lasting, e, rows, G)[:-1]
    return H - marginalised[:, :-1], g - marginalised[:, -1]


def _lasting(
    joint: Joint, q: Array, adjoint: Array, lasting: Marginal, e: Array, rows: Array, G: Array
) -> Array:
    """(d + 1, d + 1) what marginalising the errors that last takes, the gradient's row last.

    Args:
        joint: the joint.
        q: (T,) states.
        adjoint: (T, 6, 6) of each frame's return.
        lasting: the errors.
        e: (T, 3, N) what is left of all errors.
        rows: (d + 1, 3, N) on the latent points.
        G: (3, 6, N) twist Jacobians.
    """
    some, T = lasting.modes.tracks, q.size
    by_twist = lasting.by_twists(G)
    own = np.empty((len(rows), *by_twist.shape[2:]))
    own[:6] = np.einsum("tij,timl->jml", adjoint, by_twist)
    own[6 : 6 + T] = np.einsum("j,tjml->tml", joint.unit_twist, by_twist)
    if joint.kind.has_pitch:
        own[-2] = np.einsum("t,tml->ml", q, by_twist[:, 5])
    own[-1] = lasting.pull(e[..., some])
    return lasting.taken(lasting.left(own, rows[..., some]))


def _with_latent_points_held(
    joint: Joint, q: Array, adjoint: Array, W: Array, We: Array, G: Array
) -> tuple[Array, Array]:
    """Information and gradient as of `track_normal_equations`, latent points held.

    Args:
        joint: the joint.
        q: (T,) states.
        adjoint: (T, 6, 6) of each frame's return.
        W: (T, 6 or 1, N) weighted information.
        We: (T, 3, N) weighted errors.
        G: (3, 6, N) twist Jacobians.
    """
    T, S = q.size, joint.unit_twist
    # per frame: G^T W G (T, 6, 6) and G^T W e (T, 6), summed over the points
    by_twist = weighted_twist_products(W, G)
    gradient = We.reshape(T, -1) @ G.transpose(0, 2, 1).reshape(-1, 6)
    chained, along = by_twist @ adjoint, S @ by_twist
    d = 6 + T + joint.kind.has_pitch
    H, g = np.zeros((d, d)), np.empty(d)
    H[:6, :6] = adjoint.reshape(-1, 6).T @ chained.reshape(-1, 6)
    H[6 : 6 + T, :6] = S @ chained
    H.flat[6 * (d + 1) : (6 + T) * (d + 1) : d + 1] = along @ S
    g[:6] = gradient.ravel() @ adjoint.reshape(-1, 6)
    g[6 : 6 + T] = gradient @ S
    if joint.kind.has_pitch:  # the pitch slides a frame by its state
        H[-1, :6] = q @ chained[:, 5]
        H[6 : 6 + T, -1] = H[-1, 6 : 6 + T] = q * along[:, 5]
        H[-1, -1] = q**2 @ by_twist[:, 5, 5]
        g[-1] = q @ gradient[:, 5]
    H[:6, 6:] = H[6:, :6].T
    return H, g


def _twisted(moved: Array, G: Array) -> Array:
    """Sum over frames of W G Ad, (6, 3, N), from that of W Ad (6, 6, 6 or 1, N); G as (3, 6, N).

    Row a of G is a row of [x]x and -1 in column 3 + a; the other entries are zero.
    """
    if moved.shape[2] == 1:
        return np.stack([_twisted_row(moved[:, :, 0], G, a) for a in range(3)], axis=1)
    rows = [[_twisted_row(moved[:, :, UNPACK[a, b]], G, b) for b in range(3)] for a in range(3)]
    return np.stack([x + y + z for x, y, z in rows], axis=1)


def _twisted_row(moved: Array, G: Array, row: int) -> Array:
    """(6, N): row of G (3, 6, N), over its entries that are not zero, times moved (6, 6, N)."""
    left, right = (row + 1) % 3, (row + 2) % 3
    return G[row, left] * moved[left] + G[row, right] * moved[right] - moved[3 + row]


def _times_minus_z(packed: Array) -> Array:
    """-Lambda e_z (3, N) of packed Lambda (6 or 1, N)."""
    if len(packed) == 6:
        return -packed[UNPACK[2]]
    return np.concatenate([np.zeros((2, packed.shape[1])), -packed])


def weighted_twist_products(W: Array, G: Array) -> Array:
    """G^T W G of every frame (T, 6, 6), summed over the points: W (T, 6 or 1, N), G (3, 6, N)."""
    T, width, _ = W.shape
    if width == 1:
        return (W[:, 0] @ twist_moments(G).T @ MOMENT_TWISTS).reshape(T, 6, 6)
    return (W.reshape(T, -1) @ _twist_products(G)).reshape(T, 6, 6)


def twist_moments(G: Array) -> Array:
    """The ten different entries of G^T G, (10, N), from G (3, 6, N); see `MOMENT_TWISTS`."""
    x, y, z = G[2, 1], G[0, 2], G[1, 0]
    xx, yy, zz = x * x, y * y, z * z
    return np.stack([np.ones_like(x), x, y, z, yy + zz, zz + xx, xx + yy, y * z, z * x, x * y])


def _moment_twists() -> Array:
    """(10, 36): where the moments 1, x, y, z, yy + zz, .., yz, zx, xy stand in G^T G."""
    where = np.zeros((10, 6, 6))
    where[0, 3:, 3:] = np.eye(3)
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        where[1 + a, :3, 3:] = skew(np.eye(3)[a])
        where[1 + a, 3:, :3] = -where[1 + a, :3, 3:]
        where[4 + a, a, a] = 1.0
        where[7 + a, b, c] = where[7 + a, c, b] = -1.0
    return where.reshape(10, 36)


MOMENT_TWISTS = _moment_twists()  # moments (N, 10) @ MOMENT_TWISTS = G^T G (N, 36)


def _twist_products(G: Array) -> Array:
    """What a packed weight adds to G^T W G: (6 N, 36), from G (3, 6, N)."""
    products = np.empty((6, G.shape[2], 36))
    for k, (a, b) in enumerate(zip(ROW, COL, strict=True)):
        outer = G[a].T[:, :, None] * G[b].T[:, None, :]
        products[k] = (outer if a == b else outer + outer.swapaxes(1, 2)).reshape(-1, 36)
    return products.reshape(-1, 36)


def state_information(joint: Joint, cost: TrackCost) -> Array:
    """(T,) information on each state when joint and latent points are held."""
    direction = joint.unit_twist @ twist_jacobian(cost.x_joint)
    return squared_length(cost.information, direction[None]).sum(axis=1)


def state_step(
    joint: Joint,
    q: Array,
    x_joint: Array,
    tracks: TrackObservations,
    dof: float,
    scale: float,
    slips: Slips | None = None,
) -> tuple[Array, Array]:
    """Gauss-Newton step and information (T,) of each state with joint and latent points held.

    Args:
        joint: the joint.
        q: (T,) states to step from.
        x_joint: (3, N) reference points, joint frame.
        tracks: the observations.
        dof: degrees of freedom of the Student-t kernel.
        scale: factor on the observations' standard deviations.
        slips: errors that last, held as well.
    """
    z, information, modes = taken_back(joint, q, tracks)
    if modes is not None and slips is not None:
        z = modes.without(z, slips.amount)
    information = information / scale**2
    e = z - x_joint
    information *= weight(squared_length(information, e), dof, 3)[:, None, :]
    direction = joint.unit_twist @ twist_jacobian(x_joint)
    gradient = (times(information, e) * direction).sum(axis=(1, 2))
    curvature = squared_length(information, direction[None]).sum(axis=1)
    return -gradient / curvature, curvature


def twist_jacobian(x_joint: Array) -> Array:
    """G(x) = [ [x]x | -I ], (3, 6, N)."""
    G = np.zeros((3, 6, x_joint.shape[1]))
    x, y, z = x_joint
    G[0, 1], G[0, 2], G[1, 0] = -z, y, z
    G[1, 2], G[2, 0], G[2, 1] = -x, -y, x
    G[[0, 1, 2], [3, 4, 5]] = -1.0
    return G
