"""Static points: what does not move is seen as noisily as what does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import gtsam
import numpy as np

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.sources.source import At, Contribution, NoiseLevel, Part, Source, Term
from akm_fg.estimation.sources.tracks import TRACKS
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import PointTracks
from factors.joint_variables import JointVariables
from factors.measurements.static_part import static_scale
from factors.measurements.track_cost import TrackObservations


@dataclass(frozen=True, slots=True)
class StaticPoints(Source):
    """The level at which points that rest are seen, as knowledge of the tracks' noise."""

    level: NoiseLevel
    name: ClassVar[str] = "static points"

    @staticmethod
    def of(static: PointTracks, config: FitConfig) -> StaticPoints | None:
        """Read off tracks of what does not move; None where they do not tell a level.

        Args:
            static: T frames of such tracks.
            config: tuning.
        """
        T = static.observed.shape[0]
        frames = _spread(T, config.static_frames)
        seen = np.flatnonzero(static.observed[frames].sum(axis=0) >= 2)
        if seen.size == 0:
            return None
        some = seen[_spread(seen.size, config.static_tracks)]
        tracks = TrackObservations.from_points(
            static.p_world[frames][:, some], static.cov_world[frames][:, some]
        )
        try:
            found = static_scale(tracks, config.dof)
        except ValueError:  # points that do not jitter at all: their noise is not the part's
            return None
        variance = found.log_scale_sd**2 + config.moving_noise_sd_log**2
        scale = config.moving_noise * math.exp(found.log_scale)
        return StaticPoints(NoiseLevel(scale, 0.5 / variance))

    def term(self, guess: JointGuess, part: Part, previous: Contribution | None) -> Term:
        """The same for every kind."""
        return _StaticTerm(self.level)


class _StaticTerm(Term):
    """Knowledge of the tracks' noise in one kind's fit; no factor of the graph."""

    name = StaticPoints.name

    def __init__(self, level: NoiseLevel) -> None:
        self._level = level

    @property
    def levels(self) -> Mapping[str, NoiseLevel]:
        """Of the tracks."""
        return {TRACKS: self._level}

    def factors(self, variables: JointVariables, scale: float) -> list[gtsam.NonlinearFactor]:
        """None."""
        return []

    def contribution(self, at: At, freedom: float) -> Contribution:
        """How probable the noise level is that this kind needs."""
        size, free = at.columns.size, len(at.variables.free)
        return Contribution(
            information=np.zeros((size, size)),
            held=np.zeros(free),
            log_noise=self._level.log_density(at.scales[TRACKS]),
        )


def _spread(count: int, most: int) -> np.ndarray:
    """At most so many places, evenly over `count`."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))
