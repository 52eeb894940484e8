"""The frames of a stream whose images are kept: at most so many, spread along the motion.

Nobody knows yet which points are the part's, so all followed points tell how far things have gone:
the root mean square way of those that moved beyond their noise, since the last frame that was
called farther. A share of the places goes to time, so that rests are not lost. When there is one
frame too many, the one goes whose neighbours are closest together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.tracking.track_store import SeenPoints
from akm_fg.records import RgbdFrame


@dataclass(frozen=True, slots=True)
class KeptFramesConfig:
    """How many, and how they are spread."""

    most: int = 60  # as many as a graph takes; 2 MB of VGA images each
    clock_share: float = 0.2  # of the places that are spread over time
    sigmas: float = 4.0  # of a point's own noise, that count as motion: one in 10,000 by chance
    largest_step_m: float = 0.1  # of one point; farther is a wild track


class KeptFrames:
    """Frames and their numbers in the stream; the first and the newest are always among them."""

    def __init__(self, config: KeptFramesConfig | None = None) -> None:
        """Nothing yet."""
        self._config = config or KeptFramesConfig()
        self._numbers: list[int] = []
        self._frames: list[RgbdFrame] = []
        self._way_m: list[float] = []  # gone until each of them
        self._seen, self._gone_m = 0, 0.0
        self._anchor: SeenPoints | None = None

    @property
    def numbers(self) -> NDArray[np.int_]:
        """(K,) growing."""
        return np.array(self._numbers, dtype=int)

    @property
    def frames(self) -> tuple[RgbdFrame, ...]:
        """K, in the order of their numbers."""
        return tuple(self._frames)

    def add(self, frame: RgbdFrame, seen: SeenPoints) -> None:
        """Take the next frame in; at the limit, let another one go."""
        self._gone_m += self._step_m(seen)
        self._numbers.append(self._seen)
        self._frames.append(frame)
        self._way_m.append(self._gone_m)
        self._seen += 1
        if len(self._numbers) > self._config.most:
            self._drop(self._least_missed())

    def _step_m(self, seen: SeenPoints) -> float:
        """Way since the anchor: root mean square over the points that are seen in both.

        The anchor is the last frame that had gone a way, or where most points were others.
        """
        before, self._anchor = self._anchor or seen, self._anchor or seen
        _, i, j = np.intersect1d(
            before.pixels.index, seen.pixels.index, assume_unique=True, return_indices=True
        )
        square = ((seen.p_world[j] - before.p_world[i]) ** 2).sum(axis=1)
        noise = np.trace(before.cov_world[i] + seen.cov_world[j], axis1=1, axis2=2)
        known = np.isfinite(square)
        moved = known & (square > self._config.sigmas**2 * noise)
        moved &= square < self._config.largest_step_m**2
        if moved.any() or 2 * known.sum() < len(seen.p_world):
            self._anchor = seen
        return float(np.sqrt(square[moved].sum() / max(known.sum(), 1)))

    def _least_missed(self) -> int:
        """The place of the frame whose neighbours are closest together, ends apart."""
        way, number = np.array(self._way_m), np.array(self._numbers, dtype=float)
        place = way / max(way[-1], 1e-9) + self._config.clock_share * number / number[-1]
        return 1 + int(np.argmin(place[2:] - place[:-2]))

    def _drop(self, place: int) -> None:
        del self._numbers[place], self._frames[place], self._way_m[place]
