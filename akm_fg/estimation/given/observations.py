"""What the graph of a part sees, and how noisy it turns out to be."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.knowledge import NoiseLevel
from akm_fg.estimation.sources.gripper import GraspObservations
from akm_fg.records import FloatArray
from factors.measurements.dense_registration import DenseCost, PatchObservations
from factors.measurements.orientation_track import log_so3, orientation_residual
from factors.measurements.track_cost import TrackObservations
from factors.student_t import log_normaliser, twice_negative_log_kernel, weight

CHI2_MEDIAN = 2.366  # of a chi-square variable with three degrees of freedom
# The scale of a Student-t with six degrees of freedom fitted to normal noise, over its sigma.
T_OVER_NORMAL = 0.92


@dataclass(frozen=True, slots=True)
class DenseObservations:
    """Surface patches seen in some of the graph's frames."""

    patches: PatchObservations  # K keyframes
    frames: NDArray[np.int_]  # (K,) indices into the graph's frames
    count_as_one: float  # neighbouring readings that err together, over those of the tracks


@dataclass(frozen=True, slots=True)
class Observations:
    """What the graph sees of one part, in T frames."""

    tracks: TrackObservations
    R_world_part: FloatArray | None  # (T, 3, 3) measured orientations
    noise_known: bool  # whether the tracks' covariances are more than a nominal unit
    min_scale: float = 0.0  # systematic errors of a path, in the tracks' standard deviations
    visible_share: float = 1.0  # of the noise variance that residuals show, after slow errors
    dense: DenseObservations | None = None
    noise_level: NoiseLevel | None = None  # of the tracks, where it is known better than given
    grasp: GraspObservations | None = None

    @property
    def frames(self) -> int:
        """T."""
        return int(self.tracks.observed.shape[0])

    @property
    def numbers(self) -> float:
        """How many numbers were observed, dense readings as often as they count."""
        dense = self.dense
        readings = 0.0 if dense is None else float(dense.patches.seen.sum()) / dense.count_as_one
        return 3.0 * int(self.tracks.observed.sum()) + readings

    def freedom(self, fitted: int) -> float:
        """Share of the observed numbers left after fitting `fitted` and the latent points."""
        observed = self.tracks.observed
        n = 3 * int(observed.sum()) + (0 if self.R_world_part is None else 3 * self.frames)
        latent = 3 * int(observed.any(axis=0).sum())
        return max(1 - (fitted + latent) / max(n, 1), 0.05)

    def known_level(self, config: FitConfig) -> NoiseLevel | None:
        """What is known of the tracks' noise beforehand; None where that is nothing."""
        if self.noise_level is None and self.noise_known:
            return NoiseLevel(1.0, config.noise_prior_observations)
        return self.noise_level

    def log_noise(self, scales: Scales) -> float:
        """Density of a noise scale, over that of the most probable one; zero where not known."""
        return 0.0 if self.noise_level is None else self.noise_level.log_density(scales.track)


@dataclass(frozen=True, slots=True)
class Scales:
    """Estimated noise: factors on the given standard deviations, radians of the orientations."""

    track: float
    orientation_rad: float
    dense: float = 1.0

    def change(self, other: Scales) -> float:
        """Largest relative difference."""
        return max(
            abs(math.log(other.track / self.track)),
            abs(math.log(other.orientation_rad / self.orientation_rad)),
            abs(math.log(other.dense / self.dense)),
        )


def orientation_errors(
    kind: str,
    T_world_joint: FloatArray,
    q: FloatArray,
    R_ref: FloatArray | None,
    observations: Observations,
) -> FloatArray | None:
    """(T, 3) rotation vectors between measured and predicted orientations; None without any."""
    if observations.R_world_part is None or R_ref is None:
        return None
    return orientation_residual(kind, T_world_joint[:3, :3], R_ref, q, observations.R_world_part)[0]


def updated_scales(
    d2: FloatArray,
    errors: FloatArray | None,
    fitted: int,
    scales: Scales,
    observations: Observations,
    config: FitConfig,
    dense_cost: DenseCost | None = None,
) -> Scales:
    """One step towards the scales of largest marginal likelihood (expectation maximisation).

    Args:
        d2: (T, N) squared track errors, whitened with the present scale.
        errors: (T, 3) orientation errors, radians, or None.
        fitted: numbers fitted beside the latent points.
        scales: the present scales.
        observations: what was seen.
        config: tuning.
        dense_cost: of the patches, whitened with the present scale.
    """
    freedom = observations.freedom(fitted)
    d2 = d2[observations.tracks.observed]
    total, count = float((weight(d2, config.dof, 3) * d2).sum()), 3 * d2.size * freedom
    level = observations.known_level(config)
    if level is not None:  # a log-normal-like pull towards it
        total += level.observations * level.scale**2 / scales.track**2
        count += level.observations
    track2 = scales.track**2 * total / count / observations.visible_share
    orientation = scales.orientation_rad
    if errors is not None:
        e2 = (errors**2).sum(axis=1) / orientation**2
        power = float((weight(e2, config.dof, 3) * e2).sum()) / (3 * e2.size * freedom)
        orientation *= math.sqrt(power)
    dense = scales.dense
    if dense_cost is not None and observations.dense is not None:
        dense *= dense_scale_factor(dense_cost, observations.dense.patches, config.dof)
    track = math.sqrt(max(track2 + observations.min_scale**2, 1e-12))
    return Scales(track, max(orientation, 1e-5), dense)


def dense_freedom(patches: PatchObservations) -> float:
    """Share of the readings left after the latent places."""
    seen = patches.seen
    return max(1 - float(seen.any(axis=0).sum() / max(seen.sum(), 1)), 0.05)


def dense_scale_factor(cost: DenseCost, patches: PatchObservations, dof: float) -> float:
    """One step of expectation maximisation: what the patches' noise scale is to be multiplied by.

    Args:
        cost: of the patches, whitened with the present scale.
        patches: the observations.
        dof: degrees of freedom of the Student-t noise.
    """
    d2 = cost.d2[patches.seen]
    power = float((weight(d2, dof, 1) * d2).mean())
    return math.sqrt(max(power / dense_freedom(patches), 1e-4))


def log_likelihood(
    d2: FloatArray,
    errors: FloatArray | None,
    scales: Scales,
    observations: Observations,
    config: FitConfig,
    dense_cost: DenseCost | None = None,
) -> float:
    """Normalised Student-t log likelihood at the best latent points; arguments as above.

    That of the patches is marginal over their latent places, and counts as it does in the graph.
    """
    total = (
        int(observations.tracks.observed.sum())
        * (log_normaliser(config.dof, 3) - 3 * math.log(scales.track))
        - 0.5 * observations.tracks.log_det_cov
        - 0.5 * float(twice_negative_log_kernel(d2, config.dof, 3).sum())
    )
    if errors is not None:
        e2 = (errors**2).sum(axis=1) / scales.orientation_rad**2
        total += e2.size * (log_normaliser(config.dof, 3) - 3 * math.log(scales.orientation_rad))
        total -= 0.5 * float(twice_negative_log_kernel(e2, config.dof, 3).sum())
    if dense_cost is not None and observations.dense is not None:
        patches = observations.dense.patches
        precision = patches.precision[patches.seen]
        dense = precision.size * (log_normaliser(config.dof, 1) - math.log(scales.dense))
        dense += 0.5 * float(np.log(precision).sum()) - 0.5 * dense_cost.twice_cost
        dense -= 0.5 * dense_cost.log_det_latent
        total += dense / observations.dense.count_as_one
    return total


def orientation_information(errors: FloatArray, scales: Scales, config: FitConfig) -> FloatArray:
    """(T,) information (1/rad^2, each axis) that every measured orientation carries."""
    e2 = (errors**2).sum(axis=1) / scales.orientation_rad**2
    information: FloatArray = weight(e2, config.dof, 3) / scales.orientation_rad**2
    return information


def robust_mean_orientation(R: FloatArray) -> FloatArray:
    """Geodesic median (3, 3) of orientations (T, 3, 3) by Weiszfeld's iteration."""
    mean = R[0]
    for _ in range(10):
        e = log_so3(mean.T @ R)
        w = 1 / np.maximum(np.linalg.norm(e, axis=1), 1e-4)
        mean = mean @ gtsam.Rot3.Expmap((w[:, None] * e).sum(axis=0) / w.sum()).matrix()
    return mean
