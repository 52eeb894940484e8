"""Dense registration factor: the depth images of several keyframes show one moving surface.

Claim: S patches of the moving part's surface, each seen in some of K keyframes, lie on the same
surface once every keyframe is taken back by the joint. Where a patch lands in a keyframe, the
surface point p_world seen there is one observation of the patch, along its normal alone: a patch
slides freely in its own plane (point to plane, Chen and Medioni, 1992). Variables: T_world_joint
(Pose3), the keyframes' states (double; one may be fixed at zero) and a helical joint's pitch.

With M_t the part's motion from state zero (`factors.joint.Joint.motion`), n_s the patch's
normal in the reference pose and m_s its latent place along it,

    e_st = n_s^T M_t^-1 p_st - m_s,     cost = 1/2 sum rho(e_st^2 / sigma_st^2) / count_as_one,

rho the Student-t kernel per observation. No keyframe is exact and no pair of keyframes counts
twice, as in sums over pairs (the paper's Eq. 6): the m_s are marginalised, as the latent points
of `factors.measurements.point_track` are. Neighbouring readings share their errors; `count_as_one`
of them count as one, which is what makes the covariance true. Correspondences are fixed within the
factor and renewed by its caller.

For a small turn of the motion M_t Exp(d_t) the error changes by [n x x_s | -n]^T d_t, x_s the
patch's reference point; the rest is the chain rule of `factors.joint.Joint.motion_jacobians`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.joint import Joint, JointKind
from factors.joint_variables import joint_variables, normal_equations_factor
from factors.student_t import twice_negative_log_kernel

Array = NDArray[np.float64]

_LATENT_ITERATIONS = 8
_LATENT_TOLERANCE = 1e-3  # of a standard deviation of the latent place, squared


@dataclass(frozen=True, slots=True)
class PatchObservations:
    """S surface patches in K keyframes."""

    p_world: Array  # (K, 3, S) metres, the surface point seen where the patch lands
    precision: Array  # (K, S) inverse variance along the normal, 1/m^2; 0 where not seen
    normal_world: Array  # (3, S) unit, in the reference pose (state zero)

    def __post_init__(self) -> None:
        K, _, S = self.p_world.shape
        if self.precision.shape != (K, S) or self.normal_world.shape != (3, S):
            raise ValueError(
                f"points {self.p_world.shape}, precision {self.precision.shape}, normals "
                f"{self.normal_world.shape}; expected (K, 3, S), (K, S), (3, S)"
            )
        if not (np.isfinite(self.precision).all() and (self.precision >= 0).all()):
            raise ValueError("a precision is negative or not finite")
        if not np.isfinite(self.p_world).all():
            raise ValueError("a point is not finite; expected 0 where a patch is not seen")

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(K, S)."""
        return self.precision > 0


@dataclass(frozen=True, slots=True)
class DenseCost:
    """The cost at one set of motions, latent places at their best."""

    twice_cost: float
    e: Array  # (K, S) errors, metres; 0 where not seen
    d2: Array  # (K, S) squared whitened errors; 0 where not seen
    weight: Array  # (K, S) precision times robust weight over scale^2
    x_world: Array  # (3, S) the patches' reference points
    log_det_latent: float  # sum of log information of the latent places


class PatchCosts:
    """The cost of some patches at one set of motions after the other.

    Solvers ask for it twice in a row at the same motions (a step's cost, then its derivatives), and
    noise scales are found at motions that stay: what was found last is kept.

    Args:
        patches: the observations.
        dof: degrees of freedom of the Student-t kernel.
    """

    def __init__(self, patches: PatchObservations, dof: float) -> None:
        self.patches, self._dof = patches, dof
        self._seen = patches.seen.astype(np.float64)
        self._count = np.maximum(self._seen.sum(axis=0), 1)
        with np.errstate(divide="ignore"):
            self._spread = dof / patches.precision  # (K, S) m^2; infinite where not seen
        self._share = patches.precision / np.maximum(patches.precision.sum(axis=0), 1e-300)
        self._motions: tuple[bytes, bytes] | None = None  # the last ones
        self._along, self._middle = np.zeros(0), np.zeros(0)  # (K, S) and (3, S) there
        self._mean = np.zeros(0)  # (S,) plain means of the places there
        self._scale = 0.0
        self._cost: DenseCost | None = None  # there, at that scale

    def at(self, R_world: Array, t_world: Array, scale: float) -> DenseCost:
        """The cost at motions (K, 3, 3), (K, 3) from state zero: see `dense_cost`."""
        motions = R_world.tobytes(), t_world.tobytes()
        if motions != self._motions:
            self._motions, self._cost = motions, None
            self._along, self._middle = self._taken_back(R_world, t_world)
            self._mean = np.einsum("ks,ks->s", self._share, self._along)
        if self._cost is None or scale != self._scale:
            self._scale, self._cost = scale, self._evaluated(scale)
        return self._cost

    def _taken_back(self, R_world: Array, t_world: Array) -> tuple[Array, Array]:
        """Places (K, S) along the normals, and the mean points (3, S), in the reference pose."""
        # Contiguous: products of many small matrices are five times slower otherwise.
        back = np.ascontiguousarray(R_world.transpose(0, 2, 1)) @ (
            self.patches.p_world - t_world[:, :, None]
        )
        middle = np.einsum("ks,kas->as", self._seen, back) / self._count
        return np.einsum("as,kas->ks", self.patches.normal_world, back), middle

    def _evaluated(self, scale: float) -> DenseCost:
        """At the last motions."""
        n, dof = self.patches.normal_world, self._dof
        spread = scale**2 * self._spread
        m = _latent_places(self._along, spread, self._mean, dof)
        e = (self._along - m) * self._seen
        d2 = e * e
        w = (dof + 1) / (spread + d2)
        d2 *= self.patches.precision / scale**2
        total = w.sum(axis=0)
        return DenseCost(
            twice_cost=float(twice_negative_log_kernel(d2, dof, 1).sum()),
            e=e,
            d2=d2,
            weight=w,
            x_world=self._middle + n * (m - (n * self._middle).sum(axis=0)),
            log_det_latent=float(np.log(total[total > 0]).sum()),
        )


def dense_cost(
    R_world: Array, t_world: Array, patches: PatchObservations, dof: float, scale: float
) -> DenseCost:
    """Evaluate the patches' cost.

    Args:
        R_world: (K, 3, 3) motions from state zero.
        t_world: (K, 3).
        patches: the observations.
        dof: degrees of freedom of the Student-t kernel.
        scale: factor on the observations' standard deviations.
    """
    return PatchCosts(patches, dof).at(R_world, t_world, scale)


def _latent_places(along: Array, spread: Array, start: Array, dof: float) -> Array:
    """Robust weighted means (S,) of the observed places (K, S).

    What lies far off was not associated: there is no outlier to start away from.

    Args:
        along: the places.
        spread: (K, S) dof times their variances; infinite where not seen. Over it a reading's
            weight is (dof + 1) / (spread + e^2), as precision and kernel have it.
        start: (S,) where to start.
        dof: degrees of freedom of the Student-t kernel.
    """
    m, e, w = start.copy(), np.empty_like(along), np.empty_like(along)
    for _ in range(_LATENT_ITERATIONS):
        np.subtract(along, m, out=e)
        np.multiply(e, e, out=w)
        w += spread
        np.reciprocal(w, out=w)
        total = np.maximum(w.sum(axis=0), 1e-300)
        w *= e
        step = w.sum(axis=0) / total
        m += step
        if float((step**2 * total).mean()) * (dof + 1) < _LATENT_TOLERANCE:
            break
    return m


def dense_information(cost: DenseCost, patches: PatchObservations) -> tuple[Array, Array]:
    """Information (6 K, 6 K) and gradient (6 K,) over the keyframes' twists, latents marginalised.

    The form that `factors.motion_information` has for tracks; the two add up.
    """
    K = len(cost.weight)
    squares, g, held, pull = _parts(cost, patches)
    H = np.zeros((K, 6, K, 6))
    frames = np.arange(K)
    H[frames, :, frames] = squares
    held = held.reshape(6 * K, -1)
    return H.reshape(6 * K, 6 * K) - held @ held.T, g.ravel() - held @ pull


def _parts(cost: DenseCost, patches: PatchObservations) -> tuple[Array, Array, Array, Array]:
    """Of the keyframes' twists: information (K, 6, 6) and gradient (K, 6), latents held.

    And by what marginalising the latents lessens them: rows (K, 6, S), of which the product with
    themselves, and with the latents' own pull (S,), is taken off.
    """
    K, S = cost.weight.shape
    n, w = patches.normal_world, cost.weight
    J = np.concatenate([np.cross(n, cost.x_world, axis=0), -n])  # (6, S)
    squares = (J[:, None] * J).reshape(36, S)
    pulls = w * cost.e
    total = np.sqrt(np.maximum(w.sum(axis=0), 1e-300))
    held = J * (w / total)[:, None]
    return (w @ squares.T).reshape(K, 6, 6), pulls @ J.T, held, pulls.sum(axis=0) / total


def dense_normal_equations(
    joint: Joint, q: Array, cost: DenseCost, patches: PatchObservations
) -> tuple[Array, Array]:
    """Information (d, d) and gradient (d,) over (xi, q), d = 6 + K; helical: (xi, q, pitch)."""
    K = q.size
    by_xi, by_state, by_pitch = joint.motion_jacobians(q)
    J = np.zeros((K, 6, 6 + K + joint.kind.has_pitch))
    J[:, :, :6] = by_xi
    frames = np.arange(K)
    J[frames, :, 6 + frames] = by_state
    if joint.kind.has_pitch:
        J[:, :, -1] = by_pitch
    squares, g, held, pull = _parts(cost, patches)
    # Twists are many more than the joint's coordinates and states: brought to these first.
    stacked = J.reshape(6 * K, -1)
    rows = stacked.T @ held.reshape(6 * K, -1)
    H = stacked.T @ (squares @ J).reshape(6 * K, -1) - rows @ rows.T
    return H, stacked.T @ g.ravel() - rows @ pull


def dense_registration_factor(
    kind: JointKind,
    joint_key: int,
    state_keys: Sequence[int | None],
    patches: PatchObservations,
    dof: float,
    scale: float,
    count_as_one: float = 1.0,
    pitch_key: int | None = None,
    costs: PatchCosts | None = None,
) -> gtsam.CustomFactor:
    """The factor over T_world_joint, the keyframes' states and a helical joint's pitch.

    Args:
        kind: joint kind.
        joint_key: key of T_world_joint (Pose3).
        state_keys: one a keyframe, key of q_t (double), or None where q_t is fixed at zero.
        patches: the observations, K keyframes.
        dof: degrees of freedom of the Student-t kernel.
        scale: factor on the observations' standard deviations.
        count_as_one: neighbouring observations that count as one (relative to those of other
            factors, where all are tempered alike afterwards).
        pitch_key: key of a helical joint's pitch (double), metres per radian.
        costs: of these patches and `dof`, for those who go on asking for them where a graph ended.

    Raises:
        ValueError: the number of keys is not that of the keyframes, an unknown kind, a pitch key
            where there is no pitch (or none where there is one), a scale or a count that is not
            positive.
    """
    variables = joint_variables(kind, joint_key, state_keys, pitch_key, patches.p_world.shape[0])
    if not (scale > 0 and count_as_one > 0):
        raise ValueError(f"scale {scale} and count_as_one {count_as_one}, expected > 0")
    costs = costs or PatchCosts(patches, dof)

    def evaluate(
        joint: Joint, q: Array, want_equations: bool
    ) -> tuple[float, tuple[Array, Array] | None]:
        R, t = joint.motion(q)
        cost = costs.at(R, t, scale)
        equations = None
        if want_equations:
            H, g = dense_normal_equations(joint, q, cost, patches)
            equations = H / count_as_one, g / count_as_one
        return cost.twice_cost / count_as_one, equations

    return normal_equations_factor(variables, evaluate)
