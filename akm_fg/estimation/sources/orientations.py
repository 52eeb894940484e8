"""Orientations: how the part was turned in every frame, as a pose log tells it.

The noise that they are weighed by is found with the kind, up to a ceiling; its correlation in time
is measured in their own residuals; no other source's enters. What they say for or against a kind is
judged by errors known beforehand, the same for every kind (`slow_errors`): a drawer may not explain
a turn as noise, nor a door a hand that tilts by a degree.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.sources.slow_errors import OUTLIER_MEDIANS, SlowErrors, at_one_level
from akm_fg.estimation.sources.source import (
    At,
    Contribution,
    NoiseLevel,
    Part,
    Source,
    Term,
    information_of,
)
from akm_fg.estimation.sources.track_noise import correlation_time
from akm_fg.estimation.sources.tracks import CHI2_MEDIAN
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import FloatArray
from factors.joint_variables import JointVariables
from factors.measurements.orientation_track import (
    log_so3,
    orientation_residual,
    orientation_track_factor,
)
from factors.student_t import (
    covariance_factor,
    weight,
)

ORIENTATIONS = "orientations"
REFERENCE = gtsam.symbol("r", 0)  # the part's orientation at state zero
_LEAST_RAD = 1e-5  # what rounded quaternions leave
_HIDDEN = 2  # of each series the fit takes offset and slope away: the reference and the axis


@dataclass(frozen=True, slots=True)
class OrientationSource(Source):
    """Measured orientations in the graph's T frames."""

    R_world_part: FloatArray  # (T, 3, 3)
    errors: SlowErrors  # radians, each axis
    config: FitConfig
    name: ClassVar[str] = ORIENTATIONS

    def term(self, guess: JointGuess, part: Part, previous: Contribution | None) -> OrientationTerm:
        """The orientations in one kind's graph."""
        assert previous is None or isinstance(previous, OrientationContribution)
        return OrientationTerm(self, guess, previous)

    def restricted(self, frames: NDArray[np.int_]) -> OrientationSource:
        """Over some of the graph's frames."""
        errors = self.errors.restricted(frames)
        return replace(self, R_world_part=self.R_world_part[frames], errors=errors)

    def levelled(self, said: Sequence[Contribution]) -> list[Contribution]:
        """At one level for all kinds: what is known, or what the best of them leaves."""
        each = [one for one in said if isinstance(one, OrientationContribution)]
        told, times = at_one_level(self.errors, [one.residual_rad for one in each])
        return [
            replace(one, log_correlated=log, explained=factor <= self.config.orientation_misfit)
            for one, log, factor in zip(each, told, times, strict=True)
        ]

    @property
    def typical_rad(self) -> float:
        """Standard deviation of all errors together, each axis."""
        return math.hypot(self.errors.sigma, self.errors.sigma_slow)


@dataclass(frozen=True, slots=True, kw_only=True)
class OrientationContribution(Contribution):
    """What the orientations say."""

    sigma_rad: float
    R_ref: FloatArray  # (3, 3)
    residual_rad: FloatArray  # (T, 3)


class OrientationTerm(Term):
    """The orientations in one kind's graph, with the part's orientation at state zero."""

    name = ORIENTATIONS

    def __init__(
        self,
        source: OrientationSource,
        guess: JointGuess,
        previous: OrientationContribution | None,
    ) -> None:
        self._source, self._guess, self._previous = source, guess, previous

    @property
    def own(self) -> Mapping[int, int]:
        """The reference."""
        return {REFERENCE: 3}

    @property
    def numbers(self) -> tuple[int, int]:
        """Three a frame, and the reference."""
        return 3 * len(self._source.R_world_part), 3

    def insert(self, values: gtsam.Values) -> None:
        """The reference: what the frames agree on under the guess."""
        previous = self._previous
        R = self._agreed() if previous is None else previous.R_ref
        values.insert(REFERENCE, gtsam.Rot3(R))

    def _agreed(self) -> FloatArray:
        turned, _ = self._guess.motion()
        return robust_mean_orientation(np.swapaxes(turned, 1, 2) @ self._source.R_world_part)

    def start_scale(self, near: bool) -> float:
        """The median error of the guess."""
        if self._previous is not None:
            return self._previous.sigma_rad
        joint, q = self._guess.joint, self._guess.q
        e = orientation_residual(joint, self._agreed(), q, self._source.R_world_part)[0]
        found = math.sqrt(float(np.median((e**2).sum(axis=1))) / CHI2_MEDIAN)
        return min(max(found, _LEAST_RAD), self._ceiling)

    @property
    def _ceiling(self) -> float:
        return self._source.config.orientation_noise_limit * self._source.typical_rad

    def factors(self, variables: JointVariables, scale: float) -> list[gtsam.NonlinearFactor]:
        """One for all frames."""
        return [
            orientation_track_factor(
                variables.kind,
                variables.joint_key,
                REFERENCE,
                variables.state_keys,
                self._source.R_world_part,
                scale,
                self._source.config.dof,
            )
        ]

    def _errors(self, at: At) -> tuple[FloatArray, FloatArray]:
        """(T, 3) radians, and whitened and squared (T,)."""
        R_ref = at.values.atRot3(REFERENCE).matrix()
        measured = self._source.R_world_part
        e = orientation_residual(at.guess.joint, R_ref, at.guess.q, measured)[0]
        return e, (e**2).sum(axis=1) / at.scales[ORIENTATIONS] ** 2

    def rescaled(self, at: At, freedom: float, level: NoiseLevel | None) -> float:
        """One step of expectation maximisation."""
        _, e2 = self._errors(at)
        power = float((weight(e2, self._source.config.dof, 3) * e2).sum()) / (3 * e2.size * freedom)
        return min(max(at.scales[ORIENTATIONS] * math.sqrt(power), _LEAST_RAD), self._ceiling)

    def contribution(self, at: At, freedom: float) -> OrientationContribution:
        """What the orientations say, the reference marginalised."""
        e, e2 = self._errors(at)
        dof, scale = self._source.config.dof, at.scales[ORIENTATIONS]
        information, held, _ = information_of(self.factors(at.variables, scale), at, self.own)
        errors = self._source.errors
        size = np.sqrt(np.maximum(e2, 1e-300))  # outliers are rejected: they are pulled in here
        clipped = e * np.minimum(1.0, OUTLIER_MEDIANS * np.median(size) / size)[:, None]
        seen = np.ones((len(e), 1), dtype=bool)
        frames_as_one, _ = correlation_time(clipped[:, None], seen, _HIDDEN, 1e-300)
        return OrientationContribution(
            information=information,
            held=held,
            judged_share=min((scale / self._source.typical_rad) ** 2, 1.0),
            log_correlated=errors.log_likelihood(clipped),  # the reference integrated out there
            residual_rad=e,
            variance_fixed=frames_as_one * covariance_factor(e2, dof, 3, freedom),
            sigma_rad=scale,
            R_ref=at.values.atRot3(REFERENCE).matrix(),
        )


def robust_mean_orientation(R: FloatArray) -> FloatArray:
    """Geodesic median (3, 3) of orientations (T, 3, 3) by Weiszfeld's iteration."""
    mean = R[0]
    for _ in range(10):
        e = log_so3(mean.T @ R)
        w = 1 / np.maximum(np.linalg.norm(e, axis=1), 1e-4)
        mean = mean @ gtsam.Rot3.Expmap((w[:, None] * e).sum(axis=0) / w.sum()).matrix()
    return mean
