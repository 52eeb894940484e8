"""One joint kind as a GTSAM graph: built, solved, its noise scale found, its posterior read off."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.errors import AxisUnobservable
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.initial_guess import JointGuess
from akm_fg.records import FloatArray
from factors.gauge import GAUGE_NAMES, gauge_factor
from factors.hinge_distance import hinge_distance_factor
from factors.joint_motion import unit_twist
from factors.orientation_track import log_so3, orientation_residual, orientation_track_factor
from factors.point_track import (
    TrackObservations,
    point_track_factor,
    state_information,
    track_cost,
)
from factors.student_t import (
    covariance_factor,
    log_normaliser,
    twice_negative_log_kernel,
    weight,
)

JOINT = gtsam.symbol("j", 0)
REFERENCE = gtsam.symbol("r", 0)
_TANGENT = ("wx", "wy", "wz", "vx", "vy", "vz")


def state_key(frame: int) -> int:
    """Key of q_t."""
    return gtsam.symbol("q", frame)


@dataclass(frozen=True, slots=True)
class Observations:
    """What the graph sees of one part, in T frames."""

    tracks: TrackObservations
    R_world_part: FloatArray | None  # (T, 3, 3) measured orientations
    noise_known: bool  # whether the tracks' covariances are more than a nominal unit
    min_scale: float = 0.0  # systematic errors of a path, in the tracks' standard deviations
    visible_share: float = 1.0  # of the noise variance that residuals show, after slow errors


@dataclass(frozen=True, slots=True)
class Scales:
    """Estimated noise: factor on the tracks' standard deviations, radians of the orientations."""

    track: float
    orientation_rad: float


@dataclass(frozen=True, slots=True)
class KindFit:
    """The solved graph of one kind."""

    kind: str
    T_world_joint: FloatArray | None  # (4, 4); None for rigid
    q: FloatArray  # (T,)
    cov: FloatArray  # (d, d) over joint without gauge directions, then (reference,) then states
    joint_directions: tuple[int, ...]  # tangent indices of T_world_joint that are not gauge
    scales: Scales
    log_likelihood: float  # normalised Student-t, at the best latent points and orientation
    log_prior: float  # density of the joint alone, at the solution
    log_frames: float  # what the frames say with their states marginalised, latent points held
    log_det: float  # of the information on joint, reference and latent points, states marginalised
    tau: float  # frames that count as one observation
    d2: FloatArray  # (T, N) squared errors in units of the *given* covariances
    residual_joint: FloatArray  # (T, N, 3) metres, in the joint's axes
    x_joint: FloatArray  # (3, N) latent reference points, joint frame
    has_reference: bool  # whether orientations were seen
    freedom: float  # share of the observations' numbers left after the fit

    @property
    def log_evidence(self) -> float:
        """Laplace evidence, frames counted once every tau.

        The marginal likelihood of joint, reference and latent points (states integrated out
        frame by frame) to the power 1 / tau, times their prior, integrated by Laplace's method.
        """
        joint = len(self.joint_directions)
        reference = 3 if self.has_reference else 0
        fitted = joint + reference + 3 * self.x_joint.shape[1]
        return (
            self.log_frames / self.tau
            + self.log_prior
            + 0.5 * fitted * math.log(2 * math.pi * self.tau)
            - 0.5 * self.log_det
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
    def state_sd(self) -> FloatArray:
        """(T,) standard deviations of the states; zero in frame 0, where the state is zero."""
        T = self.q.size
        return np.concatenate([[0.0], np.sqrt(np.diag(self.cov)[-(T - 1) :])])


def fit_rigid(observations: Observations, start: Scales, config: FitConfig) -> KindFit:
    """Nothing moved: the latent points alone, with their own noise scale."""
    T = observations.tracks.observed.shape[0]
    q, identity = np.zeros(T), np.eye(4)
    R_ref = _mean_orientation(observations)
    scales = start
    for _ in range(config.scale_iterations):
        cost = track_cost("prismatic", identity, q, observations.tracks, config.dof, scales.track)
        errors = _orientation_errors("prismatic", identity, q, R_ref, observations)
        new = _new_scales(cost.d2, errors, 0, scales, observations, config)
        done = abs(math.log(new.track / scales.track)) < config.scale_tolerance
        scales = new
        if done:
            break
    cost = track_cost("prismatic", identity, q, observations.tracks, config.dof, scales.track)
    log_likelihood = _log_likelihood(cost.d2, errors, scales, observations, config)
    freedom = _freedom(0, observations)
    log_det = cost.log_det_latent
    if errors is not None:
        w = weight((errors**2).sum(1) / scales.orientation_rad**2, config.dof, 3)
        log_det += 3 * math.log(w.sum() / scales.orientation_rad**2)
    return KindFit(
        kind="rigid",
        T_world_joint=None,
        q=q,
        cov=np.zeros((T - 1, T - 1)),
        joint_directions=(),
        scales=scales,
        log_likelihood=log_likelihood,
        log_prior=0.0,
        log_frames=log_likelihood,
        log_det=log_det,
        tau=1.0,
        d2=cost.d2 * scales.track**2,
        residual_joint=(cost.z_joint - cost.x_joint).swapaxes(1, 2),
        x_joint=cost.x_joint,
        has_reference=errors is not None,
        freedom=freedom,
    )


def guess_cost(
    guess: JointGuess, observations: Observations, scales: Scales, config: FitConfig
) -> float:
    """How badly a start explains the tracks: the median squared error, so that few can spoil it."""
    cost = track_cost(
        guess.kind, guess.T_world_joint, guess.q, observations.tracks, config.dof, scales.track
    )
    return float(np.median(cost.d2[observations.tracks.observed]))


def fit_kind(
    observations: Observations,
    guess: JointGuess,
    centroid_world: FloatArray,
    lever_m: float,
    start: Scales,
    config: FitConfig,
) -> KindFit:
    """Solve one moving kind from one start, and find its noise scale.

    Args:
        observations: what was seen.
        guess: kind and start.
        centroid_world: (3,) of the moving points at state zero.
        lever_m: root mean square size of the moving points about it.
        start: noise scales to begin with.
        config: tuning.

    Raises:
        AxisUnobservable: the data leave a direction open.
    """
    values = _initial_values(guess, observations)
    scales = _start_scales(guess, start, values, observations, config)
    for _ in range(config.scale_iterations):
        graph = _graph(guess.kind, observations, centroid_world, scales, config)
        graph.push_back(_gauge(guess.kind, values, centroid_world))
        values = _solve(graph, values)
        d2, errors = _evaluate(guess.kind, values, observations, scales, config)
        fitted = _parameters(guess.kind, observations)
        new = _new_scales(d2, errors, fitted, scales, observations, config)
        change = max(
            abs(math.log(new.track / scales.track)),
            abs(math.log(new.orientation_rad / scales.orientation_rad)),
        )
        scales = new
        if change < config.scale_tolerance:
            break
    return _posterior(guess.kind, values, observations, centroid_world, lever_m, scales, config)


def _initial_values(guess: JointGuess, observations: Observations) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(JOINT, gtsam.Pose3(guess.T_world_joint))
    for t in range(1, guess.q.size):
        values.insert(state_key(t), float(guess.q[t]))
    if observations.R_world_part is not None:
        values.insert(REFERENCE, gtsam.Rot3(observations.R_world_part[0]))
    return values


def _start_scales(
    guess: JointGuess,
    start: Scales,
    values: gtsam.Values,
    observations: Observations,
    config: FitConfig,
) -> Scales:
    """`start`, or larger where the guess leaves larger errors: a kind that does not fit."""
    d2, errors = _evaluate(guess.kind, values, observations, start, config)
    # medians of chi-square with three degrees of freedom
    track = start.track * math.sqrt(float(np.median(d2[observations.tracks.observed])) / 2.366)
    orientation = start.orientation_rad
    if errors is not None:
        orientation = math.sqrt(float(np.median((errors**2).sum(axis=1))) / 2.366)
    return Scales(max(track, start.track), max(orientation, start.orientation_rad))


def _state_keys(T: int) -> list[int | None]:
    return [None, *(state_key(t) for t in range(1, T))]


def _graph(
    kind: str,
    observations: Observations,
    centroid_world: FloatArray,
    scales: Scales,
    config: FitConfig,
) -> gtsam.NonlinearFactorGraph:
    """Observations and priors, without the gauge."""
    T = observations.tracks.observed.shape[0]
    keys = _state_keys(T)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(
        point_track_factor(kind, JOINT, keys, observations.tracks, config.dof, scales.track)
    )
    if observations.R_world_part is not None:
        graph.push_back(
            orientation_track_factor(
                kind,
                JOINT,
                REFERENCE,
                keys,
                observations.R_world_part,
                scales.orientation_rad,
                config.dof,
            )
        )
    if kind == "revolute":
        prior = config.prior
        graph.push_back(
            hinge_distance_factor(
                JOINT, centroid_world, prior.hinge_distance_m, prior.hinge_distance_sigma_log
            )
        )
    return graph


def _gauge(kind: str, values: gtsam.Values, centroid_world: FloatArray) -> gtsam.CustomFactor:
    return gauge_factor(kind, JOINT, values.atPose3(JOINT).rotation(), centroid_world)


def log_state_prior(
    kind: str,
    T_world_joint: FloatArray,
    centroid_world: FloatArray,
    lever_m: float,
    config: FitConfig,
) -> float:
    """Log prior density of one state, per unit of the state.

    Flat on metres of displacement over the configured range, so that it pulls nowhere and favours
    no kind: a radian counts as the moving points' root mean square distance from the axis.
    """
    per_metre = -math.log(config.prior.displacement_range_m)
    if kind == "prismatic":
        return per_metre
    c = T_world_joint[:3, :3].T @ (centroid_world - T_world_joint[:3, 3])
    return per_metre + 0.5 * math.log(c[0] ** 2 + c[1] ** 2 + lever_m**2)


def _solve(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(30)
    parameters.setRelativeErrorTol(1e-5)
    parameters.setAbsoluteErrorTol(1e-3)
    parameters.setlambdaInitial(1e-5)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def _states(values: gtsam.Values, T: int) -> FloatArray:
    return np.array([0.0, *(values.atDouble(state_key(t)) for t in range(1, T))])


def _parameters(kind: str, observations: Observations) -> int:
    """Numbers fitted beside the latent points."""
    joint = 6 - len(GAUGE_NAMES[kind])
    reference = 3 if observations.R_world_part is not None else 0
    return joint + reference + observations.tracks.observed.shape[0] - 1


def _evaluate(
    kind: str,
    values: gtsam.Values,
    observations: Observations,
    scales: Scales,
    config: FitConfig,
) -> tuple[FloatArray, FloatArray | None]:
    """Squared whitened track errors (T, N) and orientation errors (T, 3)."""
    T = observations.tracks.observed.shape[0]
    pose, q = values.atPose3(JOINT).matrix(), _states(values, T)
    R_ref = values.atRot3(REFERENCE).matrix() if values.exists(REFERENCE) else None
    cost = track_cost(kind, pose, q, observations.tracks, config.dof, scales.track)
    return cost.d2, _orientation_errors(kind, pose, q, R_ref, observations)


def _orientation_errors(
    kind: str,
    T_world_joint: FloatArray,
    q: FloatArray,
    R_ref: FloatArray | None,
    observations: Observations,
) -> FloatArray | None:
    if observations.R_world_part is None or R_ref is None:
        return None
    return orientation_residual(
        kind, T_world_joint[:3, :3], R_ref, q, observations.R_world_part
    )[0]


def _mean_orientation(observations: Observations) -> FloatArray | None:
    """Robust mean of the measured orientations."""
    if observations.R_world_part is None:
        return None
    mean = observations.R_world_part[0]
    for _ in range(10):
        e = log_so3(mean.T @ observations.R_world_part)
        w = 1 / np.maximum(np.linalg.norm(e, axis=1), 1e-4)
        mean = mean @ gtsam.Rot3.Expmap((w[:, None] * e).sum(0) / w.sum()).matrix()
    return mean


def _freedom(fitted: int, observations: Observations) -> float:
    """Share of the observations' numbers that is left after the fit."""
    observed = observations.tracks.observed
    n = 3 * int(observed.sum())
    if observations.R_world_part is not None:
        n += 3 * observed.shape[0]
    latent = 3 * int(observed.any(axis=0).sum())
    return max(1 - (fitted + latent) / n, 0.05)


def _new_scales(
    d2: FloatArray,
    errors: FloatArray | None,
    fitted: int,
    scales: Scales,
    observations: Observations,
    config: FitConfig,
) -> Scales:
    """Maximise the marginal likelihood in the scales (one step of expectation maximisation)."""
    freedom = _freedom(fitted, observations)
    d2 = d2[observations.tracks.observed]
    total, count = float((weight(d2, config.dof, 3) * d2).sum()), 3 * d2.size * freedom
    factor = total / count
    if observations.noise_known:
        extra = config.noise_prior_observations
        factor = (total + extra / scales.track**2) / (count + extra)
    orientation = scales.orientation_rad
    if errors is not None:
        e2 = (errors**2).sum(axis=1) / orientation**2
        orientation *= math.sqrt(
            float((weight(e2, config.dof, 3) * e2).sum()) / (3 * e2.size * freedom)
        )
    track2 = scales.track**2 * factor / observations.visible_share + observations.min_scale**2
    return Scales(math.sqrt(max(track2, 1e-12)), max(orientation, 1e-5))


def _log_likelihood(
    d2: FloatArray,
    errors: FloatArray | None,
    scales: Scales,
    observations: Observations,
    config: FitConfig,
) -> float:
    n = int(observations.tracks.observed.sum())
    log_likelihood = (
        n * (log_normaliser(config.dof, 3) - 3 * math.log(scales.track))
        - 0.5 * observations.tracks.log_det_cov
        - 0.5 * float(twice_negative_log_kernel(d2, config.dof, 3).sum())
    )
    if errors is not None:
        e2 = (errors**2).sum(axis=1) / scales.orientation_rad**2
        log_likelihood += e2.size * (
            log_normaliser(config.dof, 3) - 3 * math.log(scales.orientation_rad)
        ) - 0.5 * float(twice_negative_log_kernel(e2, config.dof, 3).sum())
    return log_likelihood


def _posterior(
    kind: str,
    values: gtsam.Values,
    observations: Observations,
    centroid_world: FloatArray,
    lever_m: float,
    scales: Scales,
    config: FitConfig,
) -> KindFit:
    """Laplace approximation at the solution."""
    T = observations.tracks.observed.shape[0]
    graph = _graph(kind, observations, centroid_world, scales, config)
    ordering = gtsam.Ordering()
    ordering.push_back(JOINT)
    if observations.R_world_part is not None:
        ordering.push_back(REFERENCE)
    for t in range(1, T):
        ordering.push_back(state_key(t))
    information, _ = graph.linearize(values).hessian(ordering)
    directions = tuple(i for i, name in enumerate(_TANGENT) if name not in GAUGE_NAMES[kind])
    kept = [*directions, *range(6, information.shape[0])]
    information = information[np.ix_(kept, kept)]
    cov, log_det = _invert(kind, information, directions)

    pose, q = values.atPose3(JOINT).matrix(), _states(values, T)
    cost = track_cost(kind, pose, q, observations.tracks, config.dof, scales.track)
    R_ref = values.atRot3(REFERENCE).matrix() if values.exists(REFERENCE) else None
    errors = _orientation_errors(kind, pose, q, R_ref, observations)
    log_likelihood = _log_likelihood(cost.d2, errors, scales, observations, config)
    held = state_information(kind, cost)[1:]
    if errors is not None:
        w = weight((errors**2).sum(1) / scales.orientation_rad**2, config.dof, 3)[1:]
        held = held + w * np.sum(unit_twist(kind)[:3] ** 2) / scales.orientation_rad**2
    flat = log_state_prior(kind, pose, centroid_world, lever_m, config)
    log_frames = log_likelihood + float(
        np.sum(flat + 0.5 * math.log(2 * math.pi) - 0.5 * np.log(held))
    )
    freedom = _freedom(_parameters(kind, observations), observations)
    inflation = covariance_factor(
        cost.d2[observations.tracks.observed] / freedom, config.dof, 3
    )
    return KindFit(
        kind=kind,
        T_world_joint=pose,
        q=q,
        cov=cov * inflation,
        joint_directions=directions,
        scales=scales,
        log_likelihood=log_likelihood,
        log_prior=log_joint_prior(kind, pose, centroid_world, config),
        log_frames=log_frames,
        log_det=log_det + cost.log_det_latent - float(np.log(held).sum()),
        tau=1.0,
        d2=cost.d2 * scales.track**2,
        residual_joint=(cost.z_joint - cost.x_joint).swapaxes(1, 2),
        x_joint=cost.x_joint,
        has_reference=errors is not None,
        freedom=freedom,
    )


def log_joint_prior(
    kind: str, T_world_joint: FloatArray, centroid_world: FloatArray, config: FitConfig
) -> float:
    """Log prior density over axis direction and position at a solution.

    Axis uniform on the half sphere (its sign is a convention); hinge distance log-normal, hinge
    bearing uniform. The flat priors of the orientation reference and of the latent points are
    the same for every kind and left out.
    """
    prior = config.prior
    total = -math.log(2 * math.pi)
    if kind == "revolute":
        c = T_world_joint[:3, :3].T @ (centroid_world - T_world_joint[:3, 3])
        rho = math.hypot(c[0], c[1])
        z = math.log(rho / prior.hinge_distance_m) / prior.hinge_distance_sigma_log
        total += -0.5 * z**2 - math.log(prior.hinge_distance_sigma_log * math.sqrt(2 * math.pi))
        total -= math.log(2 * math.pi * rho**2)
    return total


def _invert(
    kind: str, information: FloatArray, directions: tuple[int, ...]
) -> tuple[FloatArray, float]:
    """Covariance and log determinant of the information, or the direction that is open."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if eigenvalues[0] < 1e-12 or not np.isfinite(eigenvalues).all():
        worst = int(np.argmax(np.abs(vectors[:, 0])))
        names = [_TANGENT[i] for i in directions]
        name = names[worst] if worst < len(names) else f"state {worst - len(names) + 1}"
        raise AxisUnobservable(
            f"{kind} joint: the data leave {name} of "
            f"{'T_world_joint' if worst < len(names) else 'q'} open"
        )
    root = vectors / np.sqrt(eigenvalues) * scale[:, None]
    log_det = float(np.log(eigenvalues).sum() - 2 * np.log(scale).sum())
    return root @ root.T, log_det
