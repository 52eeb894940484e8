"""Surface: patches of the part seen again in keyframes of the depth images."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.sources.source import At, Contribution, NoiseLevel, Part, Source, Term
from akm_fg.estimation.sources.tracks import beyond_averaging
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import FloatArray
from factors.joint_variables import JointVariables
from factors.measurements.dense_registration import (
    DenseCost,
    PatchCosts,
    PatchObservations,
    dense_normal_equations,
    dense_registration_factor,
)
from factors.student_t import covariance_factor, log_normaliser, weight

SURFACE = "surface"


@dataclass(frozen=True, slots=True)
class SurfaceSource(Source):
    """Patches in some of the graph's frames."""

    patches: PatchObservations  # K keyframes
    frames: NDArray[np.int_]  # (K,) indices into the graph's frames
    count_as_one: float  # neighbouring readings that err together, over those of the tracks
    first_scale: float
    config: FitConfig
    name: ClassVar[str] = SURFACE

    def term(self, guess: JointGuess, part: Part, previous: Contribution | None) -> SurfaceTerm:
        """The patches in one kind's graph."""
        assert previous is None or isinstance(previous, SurfaceContribution)
        return SurfaceTerm(self, part, previous)

    @property
    def own_frames(self) -> NDArray[np.int_]:
        """Those of the keyframes."""
        return self.frames

    def moved(self, places: NDArray[np.int_]) -> SurfaceSource:
        """In another graph that has the keyframes too."""
        return replace(self, frames=places[self.frames])

    def recounted(self, as_one: float) -> SurfaceSource:
        """Weighed for tracks of which so many observations count as one."""
        return replace(self, count_as_one=max(self.count_as_one / as_one, 1e-3))

    @property
    def freedom(self) -> float:
        """Share of the readings left after the latent places."""
        seen = self.patches.seen
        return max(1 - float(seen.any(axis=0).sum() / max(seen.sum(), 1)), 0.05)

    @property
    def readings(self) -> float:
        """As often as they count."""
        return float(self.patches.seen.sum()) / self.count_as_one

    def scale_factor(self, cost: DenseCost) -> float:
        """One step of expectation maximisation: what the noise scale is to be multiplied by.

        Args:
            cost: of the patches, whitened with the present scale.
        """
        d2 = cost.d2[self.patches.seen]
        power = float((weight(d2, self.config.dof, 1) * d2).mean())
        return math.sqrt(max(power / self.freedom, 1e-4))

    def systematic_readings(self, scale: float) -> float:
        """How many readings count as one for the depth's systematic errors along its normal."""
        precision = self.patches.precision[self.patches.seen]
        variance = scale**2 / float(np.median(precision))
        config = self.config
        return beyond_averaging(
            precision.size, variance, config.surface_systematic_m, config.systematic_modes
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceContribution(Contribution):
    """What the surface says."""

    scale: float  # of its noise
    count_as_one: float

    def reported(self, as_one: float) -> dict[str, Any]:
        """With the readings that err together, whatever the tracks do."""
        return {**self.report, "patches_as_one": self.count_as_one * as_one}


class SurfaceTerm(Term):
    """The patches in one kind's graph."""

    name = SURFACE

    def __init__(
        self, source: SurfaceSource, part: Part, previous: SurfaceContribution | None
    ) -> None:
        self._source, self._part, self._previous = source, part, previous
        self._costs = PatchCosts(source.patches, source.config.dof)

    def start_scale(self, near: bool) -> float:
        """What the registration left, or an earlier fit."""
        return self._source.first_scale if self._previous is None else self._previous.scale

    def factors(self, variables: JointVariables, scale: float) -> list[gtsam.NonlinearFactor]:
        """One for all patches."""
        source = self._source
        return [
            dense_registration_factor(
                variables.kind,
                variables.joint_key,
                [variables.state_keys[t] for t in source.frames],
                source.patches,
                source.config.dof,
                scale,
                source.count_as_one,
                variables.pitch_key,
                self._costs,
            )
        ]

    def _cost(self, at: At) -> DenseCost:
        source = self._source
        R, t = at.guess.joint.motion(at.guess.q[source.frames])
        return self._costs.at(R, t, at.scales[SURFACE])

    def rescaled(self, at: At, freedom: float, level: NoiseLevel | None) -> float:
        """One step of expectation maximisation; the readings' freedom is their own."""
        return at.scales[SURFACE] * self._source.scale_factor(self._cost(at))

    def contribution(self, at: At, freedom: float) -> SurfaceContribution:
        """What the patches say, their latent places marginalised.

        The likelihood is marginal over the places, and counts as it does in the graph.
        """
        source, cost, scale = self._source, self._cost(at), at.scales[SURFACE]
        patches, config = source.patches, source.config
        seen, precision = patches.seen, patches.precision[patches.seen]
        likelihood = precision.size * (log_normaliser(config.dof, 1) - math.log(scale))
        likelihood += 0.5 * float(np.log(precision).sum()) - 0.5 * cost.twice_cost
        likelihood -= 0.5 * cost.log_det_latent
        information, held = self._information(at, cost)
        factor = covariance_factor(cost.d2[seen], config.dof, 1, source.freedom)
        beyond = source.systematic_readings(scale) / source.count_as_one
        return SurfaceContribution(
            information=information,
            held=held,
            log_likelihood=likelihood / source.count_as_one,
            variance_fixed=factor * beyond,
            variance_per_as_one=factor,
            readings=source.readings,
            explained=scale <= config.surface_noise_limit,
            report={
                "keyframes_registered": tuple(int(k) for k in self._part.keyframes[source.frames]),
                "patches_used": int(seen.any(axis=0).sum()),
                "patches_rms_m": float(np.sqrt((cost.e[seen] ** 2).mean())),
            },
            scale=scale,
            count_as_one=source.count_as_one,
        )

    def _information(self, at: At, cost: DenseCost) -> tuple[FloatArray, FloatArray]:
        """Over `At.columns`, and on each free state with all else held."""
        source, free, joint = self._source, at.variables.free, at.guess.joint
        if not free:
            return np.zeros((0, 0)), np.zeros(0)
        here = at.guess.q[source.frames]
        H, _ = dense_normal_equations(joint, here, cost, source.patches)
        H = H / source.count_as_one
        T = at.guess.q.size
        places = np.array([*range(6), *(6 + source.frames), *([6 + T] * joint.kind.has_pitch)])
        whole = np.zeros((6 + T + joint.kind.has_pitch,) * 2)
        whole[np.ix_(places, places)] = H
        columns = at.columns
        return whole[np.ix_(columns, columns)], np.diag(whole)[6:][free].copy()
