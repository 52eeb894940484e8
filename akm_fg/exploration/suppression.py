"""The paper's belief: a map of scores from which failures subtract a Gaussian (Eq. 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from akm_fg.exploration.belief import ways_of
from akm_fg.exploration.records import BeliefSnapshot, Contact, Hypothesis, Outcome, Way


@dataclass(frozen=True, slots=True)
class SuppressionConfig:
    """The paper's settings."""

    alpha: float = 0.5  # subtracted at the place that failed
    sigma: float = 0.05  # of the Gaussian, in image widths (the authors' settings)


class SuppressedMap:
    """Tries the highest score, always outwards; a failure is a failure, whatever its cause.

    Args:
        contacts: at whose pixels the map is kept; their priors are its first scores.
        width_px: of the image.
        config: tuning.
        rng: without suppression nothing is learned, and the next place is drawn by score;
            None where failures suppress.
    """

    def __init__(
        self,
        contacts: Sequence[Contact],
        width_px: int,
        config: SuppressionConfig | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        self._contacts, self._rng = tuple(contacts), rng
        self._config, self._width_px = config or SuppressionConfig(), width_px
        self._score = np.array([contact.prior for contact in contacts], dtype=float)
        self._left = np.zeros(len(self._contacts), dtype=bool)
        self._refused = self._left.copy()  # by the planner, the last time
        self._uv = np.array([contact.uv for contact in contacts], dtype=float).reshape(-1, 2)

    def next(self) -> Hypothesis | None:
        """The highest score; of a map without suppression, one drawn by score.

        None where the planner has refused all that is left: a refusal costs no pull, so that such
        tries would never come to an end.
        """
        if (self._left | self._refused).all():
            return None
        score = np.where(self._left, -np.inf, self._score)
        if self._rng is None:
            place = int(np.argmax(score))
        else:
            share = np.where(self._left, 0.0, self._score)
            share = share / share.sum()
            place = int(self._rng.choice(len(self._contacts), p=share))
        normal = self._contacts[place].normal_world
        return Hypothesis(place, "outward", ways_of(normal)["outward"])

    def probability(self, hypothesis: Hypothesis) -> float:
        """The score, which the paper reads as a probability."""
        return float(np.clip(self._score[hypothesis.contact], 0.0, 1.0))

    def while_held(self, rigid: Sequence[Hypothesis]) -> Hypothesis | None:
        """The paper lets go."""
        return None

    def learn(
        self, hypothesis: Hypothesis, outcome: Outcome, moved: bool, held: bool = False
    ) -> None:
        """A <- A - alpha exp(-|u - mu|^2 / (2 sigma^2)) after any failure (the paper's Eq. 2)."""
        self._refused[hypothesis.contact] = outcome == "refused"
        if self._rng is not None or outcome == "opened":
            return
        away = np.linalg.norm(self._uv - self._uv[hypothesis.contact], axis=1)
        sigma_px = self._config.sigma * self._width_px
        self._score -= self._config.alpha * np.exp(-0.5 * (away / sigma_px) ** 2)

    def noticed(self, place: int, way: Way) -> None:
        """The paper looks at pulls alone."""

    def leave(self, contacts: Sequence[int]) -> None:
        """Nothing more is to be tried at these: what they are on is known."""
        self._left[list(contacts)] = True

    def snapshot(self) -> BeliefSnapshot:
        """As it is now."""
        score = np.where(self._left, 0.0, np.clip(self._score, 0.0, 1.0))
        most = float(score.max(initial=0.0))
        return BeliefSnapshot(score, most, most)
