"""Laplace approximation: covariance and evidence of one kind at its solution."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from akm_fg.errors import AxisUnobservable
from akm_fg.estimation.config import PriorConfig
from akm_fg.estimation.given.observations import Scales
from akm_fg.estimation.sources.gripper import GraspFit
from akm_fg.posterior import Evidence
from akm_fg.records import FloatArray
from factors.measurements.dense_registration import DenseCost
from factors.priors.gauge import GAUGE_NAMES
from factors.priors.pitch_prior import pitch_log_density

TANGENT = ("wx", "wy", "wz", "vx", "vy", "vz")


@dataclass(frozen=True, slots=True)
class KindFit:
    """The solved graph of one kind."""

    kind: str
    T_world_joint: FloatArray | None  # (4, 4); None for rigid
    q: FloatArray  # (T,)
    cov: FloatArray  # (d, d) over joint without gauge directions, (pitch, reference,) states
    information: FloatArray  # (d, d) the graph's, over the same
    dense_information: FloatArray  # (d, d) what the dense patches contribute to it
    joint_directions: tuple[int, ...]  # tangent indices of T_world_joint that are not gauge
    scales: Scales
    log_likelihood: float  # normalised Student-t, at the best latent points and orientation
    log_prior: float  # density of the joint alone, at the solution
    log_frames: float  # what the frames say with their states marginalised, latent points held
    log_latents: float  # log of the width that the data leave the latent points
    log_det: float  # of the information on joint and reference, states marginalised
    tau: float  # observations (neighbours in time and space) that count as one
    cov_factor: float  # of `cov` over the inverse of the graph's information
    d2: FloatArray  # (T, N) squared errors in units of the *given* covariances
    residual_joint: FloatArray  # (T, N, 3) metres, in the joint's axes
    x_joint: FloatArray  # (3, N) latent reference points, joint frame
    has_reference: bool  # whether orientations were seen
    pitch: float  # of a helical joint, metres per radian
    dense_cost: DenseCost | None
    freedom: float  # share of the observations' numbers left after the fit
    log_nested: float = 0.0  # see `akm_fg.estimation.between_kinds.evidence.nested_screw`
    grasp: GraspFit | None = None  # in `information`, `log_likelihood` and `log_frames` already
    log_noise: float = 0.0  # density of the noise scale, over that of the most probable one

    @property
    def log_evidence(self) -> float:
        """See `evidence`."""
        return self.evidence.total

    @property
    def evidence(self) -> Evidence:
        """Laplace evidence, one in tau observations counted.

        The marginal likelihood of joint and reference (latent points integrated out, states frame
        by frame) to the power 1 / tau, times their prior, integrated by Laplace's method.
        """
        reference = 3 if self.has_reference else 0
        fitted = len(self.joint_directions) + reference
        fitted += self.kind == "helical"
        log_det = self.log_det
        if self.grasp is not None:
            fitted, log_det = fitted + self.grasp.variables, log_det + self.grasp.log_det
        return Evidence(
            log_likelihood=(self.log_likelihood + self.log_latents) / self.tau,
            log_states=(self.log_frames - self.log_likelihood) / self.tau,
            log_joint_prior=self.log_prior,
            log_joint_volume=0.5 * fitted * math.log(2 * math.pi * self.tau) - 0.5 * log_det,
            log_nested=self.log_nested,
            log_noise=self.log_noise,
        )

    @property
    def squared_error_m2(self) -> FloatArray:
        """(T, N) squared residuals."""
        return (self.residual_joint**2).sum(axis=-1)

    @property
    def joint_cov(self) -> FloatArray:
        """(6, 6) in the tangent of T_world_joint, zero along the gauge directions."""
        cov = np.zeros((6, 6))
        k = len(self.joint_directions)
        cov[np.ix_(self.joint_directions, self.joint_directions)] = self.cov[:k, :k]
        return cov

    @property
    def pitch_sd(self) -> float:
        """Standard deviation of a helical joint's pitch, metres per radian."""
        k = len(self.joint_directions)
        return math.sqrt(float(self.cov[k, k]))

    @property
    def state_sd(self) -> FloatArray:
        """(T,) standard deviations of the states; zero in frame 0, where the state is zero."""
        T = self.q.size
        return np.concatenate([[0.0], np.sqrt(np.diag(self.cov)[-(T - 1) :])])


def observable_directions(kind: str) -> tuple[int, ...]:
    """Tangent indices of T_world_joint that the data can fix."""
    return tuple(i for i, name in enumerate(TANGENT) if name not in GAUGE_NAMES[kind])


def metres_per_unit(
    kind: str,
    T_world_joint: FloatArray,
    centroid_world: FloatArray,
    lever_m: float,
    pitch: float = 0.0,
) -> float:
    """How far the part moves when its state grows by one: root mean square over its points."""
    if kind == "prismatic":
        return 1.0
    rho2 = _hinge_distance(T_world_joint, centroid_world) ** 2
    return math.sqrt(rho2 + lever_m**2 + pitch**2)


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


def log_joint_prior(
    kind: str,
    T_world_joint: FloatArray,
    centroid_world: FloatArray,
    prior: PriorConfig,
    pitch: float = 0.0,
) -> float:
    """Log prior density over axis direction and position (and pitch) at a solution.

    Axis uniform on the half sphere (its sign is a convention); hinge distance log-normal, hinge
    bearing uniform; pitch normal. The flat priors of the orientation reference and of the latent
    points are the same for every kind and left out.
    """
    total = -math.log(2 * math.pi)
    if kind != "prismatic":
        rho = _hinge_distance(T_world_joint, centroid_world)
        z = math.log(rho / prior.hinge_distance_m) / prior.hinge_distance_sigma_log
        total += -0.5 * z**2 - math.log(prior.hinge_distance_sigma_log * math.sqrt(2 * math.pi))
        total -= math.log(2 * math.pi * rho**2)
    if kind == "helical":
        total += pitch_log_density(pitch, prior.pitch_sigma_m_per_rad)
    return total


def _hinge_distance(T_world_joint: FloatArray, centroid_world: FloatArray) -> float:
    c = T_world_joint[:3, :3].T @ (centroid_world - T_world_joint[:3, 3])
    return max(math.hypot(c[0], c[1]), 1e-6)


def inverted(kind: str, information: FloatArray) -> tuple[FloatArray, float]:
    """Covariance and log determinant of an information matrix over (joint, ...).

    Raises:
        AxisUnobservable: it is singular; names the direction that is open.
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if not eigenvalues[0] > 1e-12:
        names = [f"{TANGENT[i]} of T_world_joint" for i in observable_directions(kind)]
        names += ["the pitch"] if kind == "helical" else []
        worst = int(np.argmax(np.abs(vectors[:, 0])))
        name = names[worst] if worst < len(names) else "a state"
        raise AxisUnobservable(f"{kind} joint: the data leave {name} open")
    root = vectors / np.sqrt(eigenvalues) * scale[:, None]
    log_det = float(np.log(eigenvalues).sum() - 2 * np.log(scale).sum())
    return root @ root.T, log_det
