"""The state that the known surface of a part tells in one frame, looked for about a state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.surface.known_surface import Found
from akm_fg.records import FloatArray, RgbdFrame
from akm_fg.relocalization.config import RelocalizationConfig
from akm_fg.relocalization.likelihood import StateLikelihood


@dataclass(frozen=True, slots=True)
class Measured:
    """A state that the surface of one frame tells."""

    q: float
    variance: float
    share: float  # of the points that should be seen, that were found


class SurfaceState:
    """Finds the surface of one part.

    Args:
        likelihood: of the part's states, with its surface.
        noise: of the depth.
        config: tuning.
        states: (Q,) that the part may have, growing evenly.
    """

    def __init__(
        self,
        likelihood: StateLikelihood,
        noise: DepthNoiseModel,
        config: RelocalizationConfig,
        states: FloatArray,
    ) -> None:
        self._likelihood, self._noise = likelihood, noise
        self._config, self._states = config, states

    def measured(self, frame: RgbdFrame, q: float, reach: float) -> Measured | None:
        """The state that the surface tells, looked for around a state; None where it tells none."""
        c, surface = self._config, self._likelihood.surface
        starts = [q] if reach <= self._narrow(q) else self._starts(frame, q, reach)
        return self._checked(frame, surface.solved(frame, self._noise, np.array(starts), c.match))

    def _starts(self, frame: RgbdFrame, q: float, reach: float) -> list[float]:
        """The state itself, and the likeliest of the grid's about it: never beyond the range."""
        states = self._states[np.abs(self._states - q) <= reach]
        if not states.size:
            return [q]
        odds = self._likelihood.log_odds(frame, self._noise, states)
        return [q, float(states[int(odds.argmax())])]

    def _narrow(self, q: float) -> float:
        """The way within which Gauss-Newton finds the surface from one start, as a state."""
        return 0.7 * self._config.match.gates_m[0] / self._likelihood.surface.metres_per_unit(q)

    def _checked(self, frame: RgbdFrame, found: Found) -> Measured | None:
        c, surface = self._config, self._likelihood.surface
        if found.information <= 0.0:
            return None
        shown = self._likelihood.shown(frame, found.q)
        good = found.good & shown
        share = float(good.sum()) / max(int(shown.sum()), 1)
        few = good.sum() < c.sliver and share < c.least_of_sliver
        if share < c.least_found or good.sum() < 10 or few:
            return None
        per_unit = surface.metres_per_unit(found.q)
        if found.along_m < c.outline_along * per_unit:
            return self._by_outline(frame, found.q, share)
        variance = c.likelihood.as_one / found.information + (c.shared_m / found.along_m) ** 2
        return Measured(found.q, variance, share)

    def _by_outline(self, frame: RgbdFrame, q: float, share: float) -> Measured:
        """The state of a part that slides along its own surface: where that begins and ends tells.

        Mean and variance of the depth's evidence for states about the one that was found. Outlines
        are no sharper than a share of a pixel, by the same in all readings.
        """
        c, surface = self._config, self._likelihood.surface
        per_unit = surface.metres_per_unit(q)
        mean, spread = q, 0.0
        for reach_m in c.outline_reaches_m:
            reach = reach_m / per_unit
            states = mean + np.linspace(-reach, reach, c.outline_states)
            odds = self._likelihood.together(frame, self._noise, states)
            weight = np.exp(odds - odds.max())
            weight = weight / weight.sum()
            mean = float(weight @ states)
            spread = float(weight @ (states - mean) ** 2)
        T = frame.T_world_cam
        depth = (surface.moved(mean)[0] - T.translation()) @ T.rotation().matrix()[:, 2]
        pixel = float(np.median(depth)) / frame.camera.fx / per_unit
        return Measured(mean, spread + (c.outline_px * pixel) ** 2, share)
