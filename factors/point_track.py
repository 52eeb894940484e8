"""Point-track factor: every tracked point of the part follows the joint.

Claim: N points of one rigid part, observed in T frames with known 3x3 covariances, move as the
joint says. Variables: T_world_joint (Pose3), one state q_t per frame (double; q of a frame may be
fixed at zero), and a helical joint's pitch (double). The points' reference positions are latent
and marginalised here, so that no frame counts as exact (the paper's Eq. 5 takes the first frame's
points as truth, which makes the axis' covariance several times too small).

Residual of one observation, in reference coordinates (see `factors.joint_motion`):

    e_tn = z_tn - x_n,     d2_tn = e_tn^T Lambda_tn e_tn,     cost = 1/2 sum rho(d2_tn)

with rho the Student-t kernel *per observation* and Lambda the inverse covariance, rotated from
world by the joint and the state. That rotation is what makes the twist Jacobian G(x), at the
latent point, and not G(z): the error in world is p - T_world_joint Exp(q S) x. For given joint
and states the latent x_n minimises its own terms (iterated weighted means); the
Gauss-Newton information of what remains is the Schur complement over all x_n. GTSAM sees
6 + T + 1 rows however many points there are (`square_root_rows`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.joint_motion import (
    adjoint_of_return,
    joint_displacement,
    reference_coordinates,
    unit_twist,
)
from factors.joint_variables import joint_variables, normal_equations_factor
from factors.packed import (
    COL,
    ROW,
    UNPACK,
    inverse_and_determinant,
    multiples_of_identity,
    rotated,
    six,
    times,
)
from factors.student_t import twice_negative_log_kernel, weight

Array = NDArray[np.float64]

_Z = np.array([[0.0], [0.0], [1.0]])


@dataclass(frozen=True, slots=True)
class TrackObservations:
    """Observed points in the layout the factor works in."""

    p_world: Array  # (T, 3, N) metres; 0 where not observed
    information_world: Array  # (T, 6 or 1, N) inverse covariance, packed; 0 where not observed
    observed: NDArray[np.bool_]  # (T, N)
    log_det_cov: float  # sum over the observed of log |cov|

    @staticmethod
    def from_points(p_world: Array, cov_world: Array) -> TrackObservations:
        """Pack points (T, N, 3), NaN where lost, with covariances (T, N, 3, 3) in m^2.

        Raises:
            ValueError: shapes that do not match, or a covariance that is not positive definite.
        """
        if p_world.ndim != 3 or p_world.shape[2] != 3 or cov_world.shape != (*p_world.shape, 3):
            raise ValueError(
                f"points {p_world.shape} and covariances {cov_world.shape}, "
                "expected (T, N, 3) and (T, N, 3, 3)"
            )
        observed: NDArray[np.bool_] = np.asarray(np.isfinite(p_world).all(axis=-1))
        packed = cov_world[..., ROW, COL].transpose(2, 0, 1)  # (6, T, N)
        packed = np.where(observed, packed, np.eye(3)[ROW, COL][:, None, None])
        if not np.isfinite(packed).all():
            raise ValueError("a covariance of an observed point is not finite")
        minor = packed[0] * packed[3] - packed[1] ** 2
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse, determinant = inverse_and_determinant(packed)
        leading = np.stack([packed[0], minor, determinant])
        if not (leading > 0).all():  # Sylvester's criterion
            raise ValueError("a covariance is not positive definite")
        if multiples_of_identity(packed):
            inverse = inverse[:1]
        points = np.where(observed[..., None], p_world, 0.0)
        return TrackObservations(
            p_world=np.ascontiguousarray(points.swapaxes(1, 2)),
            information_world=np.ascontiguousarray((inverse * observed).swapaxes(0, 1)),
            observed=observed,
            log_det_cov=float(np.log(determinant).sum()),
        )

    def select(self, tracks: NDArray) -> TrackObservations:
        """The tracks with these indices; `log_det_cov` is not theirs and NaN."""
        return TrackObservations(
            self.p_world[:, :, tracks],
            self.information_world[:, :, tracks],
            self.observed[:, tracks],
            float("nan"),
        )


@dataclass(frozen=True, slots=True)
class TrackCost:
    """The cost of all tracks at one joint and one set of states, latent points at their best."""

    twice_cost: float
    d2: Array  # (T, N) squared whitened errors; 0 where not observed
    x_joint: Array  # (3, N) latent reference points, joint frame
    log_det_latent: float  # sum of log |information of x_n|
    z_joint: Array  # (T, 3, N) reference coordinates
    information: Array  # (T, 6 or 1, N) weighted, packed, in reference coordinates


def track_cost(
    kind: str,
    T_world_joint: Array,
    q: Array,
    tracks: TrackObservations,
    dof: float,
    scale: float,
    x_start: Array | None = None,
    pitch: float = 0.0,
) -> TrackCost:
    """Evaluate the tracks' cost.

    Args:
        kind: joint kind.
        T_world_joint: (4, 4).
        q: (T,) states.
        tracks: the observations.
        dof: degrees of freedom of the Student-t kernel.
        scale: factor on the observations' standard deviations.
        x_start: (3, N) where to start the latent points; their medians over the frames if None.
        pitch: of a helical joint, metres per radian.
    """
    z = reference_coordinates(kind, T_world_joint, q, tracks.p_world, pitch)
    rotations, _ = joint_displacement(kind, q)
    information = rotated(tracks.information_world, T_world_joint[:3, :3] @ rotations) / scale**2
    x = first_reference(z, tracks.observed) if x_start is None else x_start
    x, weighted, d2 = best_reference(z, information, x, dof)
    return TrackCost(
        twice_cost=float(twice_negative_log_kernel(d2, dof, 3).sum()),
        d2=d2,
        x_joint=x,
        log_det_latent=float(np.log(inverse_and_determinant(weighted.sum(axis=0))[1]).sum()),
        z_joint=z,
        information=weighted,
    )


def first_reference(z: Array, observed: NDArray[np.bool_]) -> Array:
    """Median over the frames of each point's reference coordinates, (3, N)."""
    if observed.all():
        return np.median(z, axis=0)
    masked = np.where(observed[:, None, :], z, np.nan)
    return np.nanmedian(masked, axis=0)


def rough_track_cost(kind: str, T_world_joint: Array, q: Array, tracks: TrackObservations) -> Array:
    """Squared whitened errors (M,) of the M observations, latent points at their medians.

    For comparing starts: cheap, and not for sale to outliers when a median is taken of it.
    """
    z = reference_coordinates(kind, T_world_joint, q, tracks.p_world)
    rotations, _ = joint_displacement(kind, q)
    information = rotated(tracks.information_world, T_world_joint[:3, :3] @ rotations)
    e = z - first_reference(z, tracks.observed)
    return (e * times(information, e)).sum(axis=1)[tracks.observed]


def best_reference(
    z: Array,
    information: Array,
    x: Array,
    dof: float,
    iterations: int = 20,
    tolerance: float = 5e-3,
) -> tuple[Array, Array, Array]:
    """Minimise each point's robust cost over its reference; x, weighted information, d2."""
    x = x.copy()
    active = np.arange(x.shape[1])
    z_active, information_active = z, information
    for _ in range(iterations):
        e = z_active - x[:, active]
        Le = times(information_active, e)
        w = weight((e * Le).sum(axis=1), dof, 3)[:, None, :]
        pull = (Le * w).sum(axis=0)
        total = (information_active * w).sum(axis=0)
        step = times(inverse_and_determinant(total)[0][None], pull[None])[0]
        x[:, active] += step
        # A step's squared length in units of the reference's own standard deviation.
        moving = (step * pull).sum(axis=0) > tolerance
        if not moving.any():
            break
        if moving.sum() < 0.7 * active.size:  # points settle at their own pace
            active = active[moving]
            z_active, information_active = z[:, :, active], information[:, :, active]
    e = z - x
    d2 = (e * times(information, e)).sum(axis=1)
    return x, information * weight(d2, dof, 3)[:, None, :], d2


def track_normal_equations(
    kind: str, q: Array, cost: TrackCost, pitch: float = 0.0
) -> tuple[Array, Array]:
    """Information (d, d) and gradient (d,), latent points marginalised.

    Over (xi, q), d = 6 + T; of a helical joint over (xi, q, pitch), d = 7 + T. The twist Jacobian
    G(x_n) does not depend on the frame, so that sums over points and frames are products of
    matrices.
    """
    W = cost.information
    T, _, N = W.shape
    adjoint, G = adjoint_of_return(kind, q, pitch), twist_jacobian(cost.x_joint)
    along = _joint_columns(kind, q, pitch)  # (T, 6, c): what moves a frame apart from its joint
    c = along.shape[2]
    We = times(W, cost.z_joint - cost.x_joint)
    # per frame: G^T W G (T, 6, 6) and G^T W e (T, 6), summed over the points
    twist_information = weighted_twist_products(W, G)
    twist_gradient = We.reshape(T, -1) @ G.transpose(0, 2, 1).reshape(3 * N, 6)
    F = np.empty((3, 6 + T + c - 1, N))
    moved = (adjoint.reshape(T, 36).T @ W.reshape(T, -1)).reshape(6, 6, W.shape[1], N)
    if moved.shape[2] == 1:
        F[:, :6] = np.einsum("jkn,ajn->akn", moved[:, :, 0], G)
    else:
        F[:, :6] = np.einsum("jkabn,bjn->akn", moved[:, :, UNPACK], G)
    direction = np.einsum("ajn,j->an", G, unit_twist(kind, pitch))
    F[:, 6 : 6 + T] = times(W, np.broadcast_to(direction, We.shape)).transpose(1, 0, 2)
    chained = twist_information @ adjoint
    H = np.zeros((6 + T + c - 1, 6 + T + c - 1))
    H[:6, :6] = np.einsum("tji,tjk->ik", adjoint, chained)
    states = np.arange(6, 6 + T)
    S = along[:, :, 0]
    H[6 : 6 + T, :6] = np.einsum("tj,tjk->tk", S, chained)
    H[states, states] = np.einsum("ti,tij,tj->t", S, twist_information, S)
    g = np.zeros(6 + T + c - 1)
    g[:6] = np.einsum("tji,tj->i", adjoint, twist_gradient)
    g[6 : 6 + T] = (twist_gradient * S).sum(axis=1)
    if c == 2:
        P = along[:, :, 1]
        F[:, -1] = np.einsum("t,tan->an", q, times(W, np.broadcast_to(-_Z, We.shape)))
        H[-1, :6] = np.einsum("tj,tjk->k", P, chained)
        H[-1, 6 : 6 + T] = np.einsum("ti,tij,tj->t", P, twist_information, S)
        H[-1, -1] = np.einsum("ti,tij,tj->", P, twist_information, P)
        g[-1] = float((twist_gradient * P).sum())
    H = np.tril(H) + np.tril(H, -1).T
    pull = We.sum(axis=0)  # what is left of the latent's own gradient
    rows = np.concatenate([F, pull[:, None]], axis=1)  # (3, d + 1, N)
    held = times(inverse_and_determinant(W.sum(axis=0))[0][None, :, None], rows[None])[0]
    marginalised = np.tensordot(F, held, axes=([0, 2], [0, 2]))
    return H - marginalised[:, :-1], g - marginalised[:, -1]


def _joint_columns(kind: str, q: Array, pitch: float) -> Array:
    """(T, 6, c) twists of a frame by its own state and, for a helical joint, by the pitch."""
    columns = [np.tile(unit_twist(kind, pitch), (q.size, 1))]
    if kind == "helical":
        columns.append(q[:, None] * np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    return np.stack(columns, axis=2)


def weighted_twist_products(W: Array, G: Array) -> Array:
    """G^T W G of every frame (T, 6, 6), summed over the points: W (T, 6 or 1, N), G (3, 6, N)."""
    T, width, N = W.shape
    if width == 1:
        products = np.einsum("ajn,akn->njk", G, G).reshape(N, 36)
        return (W[:, 0] @ products).reshape(T, 6, 6)
    return (W.reshape(T, -1) @ _twist_products(G)).reshape(T, 6, 6)


def _twist_products(G: Array) -> Array:
    """What a packed weight adds to G^T W G: (6 N, 36), from G (3, 6, N)."""
    products = np.empty((6, G.shape[2], 36))
    for k, (a, b) in enumerate(zip(ROW, COL, strict=True)):
        outer = G[a].T[:, :, None] * G[b].T[:, None, :]
        products[k] = (outer if a == b else outer + outer.swapaxes(1, 2)).reshape(-1, 36)
    return products.reshape(-1, 36)


def state_information(kind: str, cost: TrackCost, pitch: float = 0.0) -> Array:
    """(T,) information on each state when joint and latent points are held."""
    step = np.einsum("ajn,j->an", twist_jacobian(cost.x_joint), unit_twist(kind, pitch))
    full = six(cost.information)[:, UNPACK]
    return np.einsum("an,tabn,bn->t", step, full, step)


def state_step(
    kind: str,
    T_world_joint: Array,
    q: Array,
    x_joint: Array,
    tracks: TrackObservations,
    dof: float,
    scale: float,
    pitch: float = 0.0,
) -> tuple[Array, Array]:
    """Gauss-Newton step and information (T,) of each state with joint and latent points held.

    Args:
        kind: joint kind.
        T_world_joint: (4, 4).
        q: (T,) states to step from.
        x_joint: (3, N) reference points, joint frame.
        tracks: the observations.
        dof: degrees of freedom of the Student-t kernel.
        scale: factor on the observations' standard deviations.
        pitch: of a helical joint, metres per radian.
    """
    z = reference_coordinates(kind, T_world_joint, q, tracks.p_world, pitch)
    rotations, _ = joint_displacement(kind, q)
    information = rotated(tracks.information_world, T_world_joint[:3, :3] @ rotations) / scale**2
    e = z - x_joint
    Le = times(information, e)
    w = weight((e * Le).sum(axis=1), dof, 3)
    direction = np.einsum("ajn,j->an", twist_jacobian(x_joint), unit_twist(kind, pitch))
    gradient = (direction * Le * w[:, None]).sum(axis=(1, 2))
    along = times(information * w[:, None], np.broadcast_to(direction, z.shape))
    curvature = (direction * along).sum(axis=(1, 2))
    return -gradient / curvature, curvature


def twist_jacobian(x_joint: Array) -> Array:
    """G(x) = [ [x]x | -I ], (3, 6, N)."""
    G = np.zeros((3, 6, x_joint.shape[1]))
    x, y, z = x_joint
    G[0, 1], G[0, 2], G[1, 0] = -z, y, z
    G[1, 2], G[2, 0], G[2, 1] = -x, -y, x
    G[[0, 1, 2], [3, 4, 5]] = -1.0
    return G


def point_key(T_world_joint: Array, q: Array, pitch: float = 0.0) -> bytes:
    """What a joint (4, 4), states (T,) and a pitch are filed under."""
    return T_world_joint.tobytes() + q.tobytes() + np.float64(pitch).tobytes()


def point_track_factor(
    kind: str,
    joint_key: int,
    state_keys: Sequence[int | None],
    tracks: TrackObservations,
    dof: float,
    scale: float,
    x_start: Array | None = None,
    last: dict[bytes, TrackCost] | None = None,
    pitch_key: int | None = None,
) -> gtsam.CustomFactor:
    """The factor over T_world_joint, the states and a helical joint's pitch.

    Args:
        kind: joint kind.
        joint_key: key of T_world_joint (Pose3).
        state_keys: one a frame, key of q_t (double), or None where q_t is fixed at zero.
        tracks: the observations, T frames.
        dof: degrees of freedom of the Student-t kernel.
        scale: factor on the observations' standard deviations.
        x_start: (3, N) where to start the latent points, joint frame; saves time only.
        last: keeps the last evaluation under `point_key`, for a caller who wants it too.
        pitch_key: key of a helical joint's pitch (double), metres per radian.

    Raises:
        ValueError: the number of keys is not that of the frames, an unknown kind, or a pitch key
            where there is no pitch (or none where there is one).
    """
    variables = joint_variables(kind, joint_key, state_keys, pitch_key, tracks.p_world.shape[0])
    memory = {} if last is None else last

    def evaluate(
        T_world_joint: Array, q: Array, pitch: float, want_equations: bool
    ) -> tuple[float, tuple[Array, Array] | None]:
        here = point_key(T_world_joint, q, pitch)
        if here not in memory:  # the optimiser asks for the error first, then for the Jacobian
            start = next((cost.x_joint for cost in memory.values()), x_start)
            memory.clear()
            memory[here] = track_cost(kind, T_world_joint, q, tracks, dof, scale, start, pitch)
        cost = memory[here]
        equations = track_normal_equations(kind, q, cost, pitch) if want_equations else None
        return cost.twice_cost, equations

    return normal_equations_factor(variables, evaluate)
