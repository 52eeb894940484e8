"""Tracks: points of the part, followed through the frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.sources.source import At, Contribution, NoiseLevel, Part, Source, Term
from akm_fg.geometry.joint_guess import TURN_ABOUT_X, JointGuess
from akm_fg.records import BoolArray, FloatArray
from factors.joint_variables import JointVariables
from factors.measurements.lasting_errors import Slips
from factors.measurements.point_track import point_key, point_track_factor
from factors.measurements.track_cost import (
    TrackCost,
    TrackObservations,
    rough_track_cost,
    track_cost,
)
from factors.measurements.track_information import state_information, track_normal_equations
from factors.student_t import (
    covariance_factor,
    log_normaliser,
    twice_negative_log_kernel,
    weight,
)

CHI2_MEDIAN = 2.366  # of a chi-square variable with three degrees of freedom
# The scale of a Student-t with six degrees of freedom fitted to normal noise, over its sigma.
T_OVER_NORMAL = 0.92
TRACKS = "tracks"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackContribution(Contribution):
    """What the tracks say, with the residuals that others judge by."""

    observed: BoolArray  # (T, N)
    d2: FloatArray  # (T, N) squared errors in units of the *given* covariances
    residual_joint: FloatArray  # (T, N, 3) metres, in the joint's axes
    x_joint: FloatArray  # (3, N) latent reference points, joint frame
    slips: Slips | None  # what is off alike in all frames
    scale: float  # of the noise: factor on the given standard deviations
    freedom: float  # share of the observations' numbers left after the fit

    def turned(self, signs: FloatArray) -> TrackContribution:
        """With the joint frame turned about its x."""
        return replace(
            self,
            information=Contribution.turned(self, signs).information,
            x_joint=self.x_joint * TURN_ABOUT_X[:, None],
            residual_joint=self.residual_joint * TURN_ABOUT_X,
        )

    @property
    def squared_error_m2(self) -> FloatArray:
        """(T, N) squared residuals."""
        return (self.residual_joint**2).sum(axis=-1)

    @property
    def noise_variance(self) -> float:
        """Typical variance of a coordinate (m^2): the given ones, scaled as the fit found."""
        given = np.median((self.squared_error_m2 / np.maximum(self.d2, 1e-300))[self.observed])
        return float(given) * self.scale**2


@dataclass(frozen=True, slots=True)
class TrackSource(Source):
    """Tracks of N points in the graph's T frames."""

    observations: TrackObservations
    noise_known: bool  # whether the covariances are more than a nominal unit
    first_scale: float  # of the noise, as far as it shows without a joint
    config: FitConfig
    min_scale: float = 0.0  # systematic errors of a path, in the given standard deviations
    visible_share: float = 1.0  # of the noise variance that residuals show, after slow errors
    systematic_m: float = 0.0  # errors that no averaging removes, each coordinate
    x_world: FloatArray | None = None  # (3, N) where the latent points start, state zero
    name: ClassVar[str] = TRACKS

    def term(self, guess: JointGuess, part: Part, previous: Contribution | None) -> TrackTerm:
        """The tracks in one kind's graph."""
        assert previous is None or isinstance(previous, TrackContribution)
        return TrackTerm(self, guess, previous)

    def restricted(self, frames: NDArray[np.int_]) -> TrackSource:
        """Over some of the graph's frames."""
        return replace(self, observations=self.observations.at(frames))

    def of(self, members: NDArray[np.int_]) -> TrackSource:
        """With some of its tracks (indices); what their covariances add to all kinds stays."""
        seen = self.observations
        kept = replace(seen.select(members), log_det_cov=seen.log_det_cov)
        x_world = None if self.x_world is None else self.x_world[:, members]
        return replace(self, observations=kept, x_world=x_world)

    @property
    def any(self) -> bool:
        """Whether there is any track."""
        return bool(self.observations.observed.shape[1] > 0)

    def rescaled(
        self, d2: FloatArray, scale: float, freedom: float, level: NoiseLevel | None
    ) -> float:
        """One step of expectation maximisation.

        Args:
            d2: (T, N) squared errors, whitened with the present scale.
            scale: the present scale.
            freedom: share of the observed numbers that is left after the fit.
            level: what is known of the noise; of known noise it is the given covariances.
        """
        d2 = d2[self.observations.observed]
        dof = self.config.dof
        total, count = float((weight(d2, dof, 3) * d2).sum()), 3 * d2.size * freedom
        if level is None and self.noise_known:
            level = NoiseLevel(1.0, self.config.noise_prior_observations)
        if level is not None:  # a log-normal-like pull towards it
            total += level.observations * level.scale**2 / scale**2
            count += level.observations
        variance = scale**2 * total / count / self.visible_share
        return math.sqrt(max(variance + self.min_scale**2, 1e-12))

    def freedom(self, fitted: int) -> float:
        """Share of the observed numbers left after fitting `fitted` and the latent points."""
        return freedom_left(*self.numbers, fitted)

    @property
    def numbers(self) -> tuple[int, int]:
        """Observed numbers, and those of the latent points and of what lasts."""
        observed = self.observations.observed
        latent = 3 * int(observed.any(axis=0).sum())
        if self.observations.lasting is not None:
            latent += self.observations.lasting.tracks.size
        return 3 * int(observed.sum()), latent

    @property
    def readings(self) -> float:
        """Three a point and frame."""
        return float(self.numbers[0])

    def rough_errors(self, guess: JointGuess) -> FloatArray:
        """Squared whitened errors (M,) of a start, of some tracks that stand for all."""
        count = self.observations.observed.shape[1]
        some = np.unique(
            np.linspace(0, count - 1, min(count, self.config.ranking_tracks)).astype(int)
        )
        d2 = rough_track_cost(guess.joint, guess.q, self.observations.select(some))
        return np.repeat(d2, -(-count // some.size))  # each stands for its neighbours

    def systematic_points(self, scale: float, variance: float) -> float:
        """How many observations count as one beyond the correlated, for systematic errors.

        n observations of variance s^2 average to s^2 / n; errors of variance b^2 with m
        independent modes add b^2 / m, whatever n is. The ratio of the two is what to count down
        by. Tracks noisier than told follow edges and slip along them: their systematic errors grow
        with their noise.

        Args:
            scale: of the noise, as the fit found it.
            variance: `TrackContribution.noise_variance`.
        """
        count = int(self.observations.observed.sum())
        if not count:
            return 0.0
        variance *= min(1.0, self.config.sound_noise_scale / scale) ** 2
        modes = self.config.systematic_modes
        return beyond_averaging(count, max(variance, 1e-12), self.systematic_m, modes)


def freedom_left(observed: int, latent: int, fitted: int) -> float:
    """Share of the observed numbers left after fitting others and the latent ones."""
    return max(1 - (fitted + latent) / max(observed, 1), 0.05)


def beyond_averaging(count: int, variance: float, systematic_m: float, modes: int) -> float:
    """Systematic variance over that of the mean of `count` observations of a variance (m^2)."""
    return count * systematic_m**2 / (modes * variance)


class TrackTerm(Term):
    """The tracks in one kind's graph; remembers its last evaluation."""

    name = TRACKS

    def __init__(
        self, source: TrackSource, guess: JointGuess, previous: TrackContribution | None
    ) -> None:
        self._source, self._guess, self._previous = source, guess, previous
        self._memory: dict[bytes, TrackCost] = {}
        self._scale: float | None = None  # at which the memory was made
        self._x: FloatArray | None = None
        if previous is not None:
            self._x = previous.x_joint
        elif source.x_world is not None:
            joint = guess.joint
            self._x = joint.R_world_joint.T @ (source.x_world - joint.origin[:, None])

    @property
    def numbers(self) -> tuple[int, int]:
        """Observed and latent ones."""
        return self._source.numbers

    def start_scale(self, near: bool) -> float:
        """The known level, or a larger one where the guess leaves larger errors."""
        source = self._source
        if self._previous is not None:
            return self._previous.scale
        # A start near the noise already known begins there: its own median is the worse estimate.
        if (source.x_world is not None and near) or not source.observations.observed.any():
            return source.first_scale
        d2 = rough_track_cost(self._guess.joint, self._guess.q, source.observations)
        # The median squared error: few bad tracks cannot spoil it.
        scale = T_OVER_NORMAL * math.sqrt(float(np.median(d2)) / CHI2_MEDIAN)
        return (
            source.first_scale if scale < source.config.near_known * source.first_scale else scale
        )

    def factors(self, variables: JointVariables, scale: float) -> list[gtsam.NonlinearFactor]:
        """One for all tracks."""
        self._memory, self._scale = {}, scale
        return [
            point_track_factor(
                variables.kind,
                variables.joint_key,
                variables.state_keys,
                self._source.observations,
                self._source.config.dof,
                scale,
                self._x,
                self._memory,
                variables.pitch_key,
            )
        ]

    def _cost(self, at: At) -> TrackCost:
        """At a solution; taken from the optimiser's last evaluation if that was there."""
        here, scale = point_key(at.guess.joint, at.guess.q), at.scales[TRACKS]
        if self._scale != scale or here not in self._memory:
            dof, seen = self._source.config.dof, self._source.observations
            cost = track_cost(at.guess.joint, at.guess.q, seen, dof, scale, self._x)
            self._memory, self._scale = {here: cost}, scale
        cost = self._memory[here]
        self._x = cost.x_joint
        return cost

    def rescaled(self, at: At, freedom: float, level: NoiseLevel | None) -> float:
        """See `TrackSource.rescaled`."""
        return self._source.rescaled(self._cost(at).d2, at.scales[TRACKS], freedom, level)

    def contribution(self, at: At, freedom: float) -> TrackContribution:
        """What the tracks say, latent points marginalised."""
        source, cost, joint = self._source, self._cost(at), at.guess.joint
        seen, dof, scale = source.observations, source.config.dof, at.scales[TRACKS]
        d2 = cost.d2[seen.observed]
        factor = covariance_factor(d2, dof, 3, freedom) if d2.size else 1.0
        columns, free = at.columns, at.variables.free
        information = np.zeros((0, 0))
        if free:
            H, _ = track_normal_equations(joint, at.guess.q, cost)
            information = H[np.ix_(columns, columns)]
        count = int(seen.observed.sum())
        said = TrackContribution(
            information=information,
            held=state_information(joint, cost)[free],
            log_likelihood=count * (log_normaliser(dof, 3) - 3 * math.log(scale))
            - 0.5 * seen.log_det_cov
            - 0.5 * float(twice_negative_log_kernel(cost.d2, dof, 3).sum()),
            log_latents=_log_latents(cost),
            variance_fixed=0.0,
            variance_per_as_one=factor,
            readings=source.readings,
            observed=seen.observed,
            d2=cost.d2 * scale**2,
            residual_joint=(cost.z_joint - cost.x_joint).swapaxes(1, 2),
            x_joint=cost.x_joint,
            slips=None if cost.lasting is None else cost.lasting.slips,
            scale=scale,
            freedom=freedom,
        )
        if not count:
            return said
        beyond = factor * source.systematic_points(scale, said.noise_variance)
        return replace(said, variance_fixed=beyond)


def _log_latents(cost: TrackCost) -> float:
    """Log of the width that the data leave the latent points (flat prior, one a cubic metre)."""
    return 1.5 * cost.x_joint.shape[1] * math.log(2 * math.pi) - 0.5 * cost.log_det_latent
