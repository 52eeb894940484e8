"""The tracks of a stream: they start and end; those long lost are forgotten."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from akm_fg.estimation.stream.keyframes import Keyframes, StreamFrame
from akm_fg.records import FloatArray


class StreamTracks:
    """Which of the caller's tracks are kept, and in what order.

    Args:
        most: tracks beyond which lost ones are forgotten.
    """

    def __init__(self, most: int) -> None:
        self.ids: NDArray[np.int_] = np.zeros(0, dtype=int)  # (N,) the caller's indices
        self._most = most
        self._given = 0  # tracks in the caller's last frame
        self._frames, self._stamp_s = 0, -np.inf

    def taken_in(
        self,
        p_world: FloatArray,
        cov_world: FloatArray,
        stamp_s: float | None,
        keyframes: Keyframes,
    ) -> StreamFrame:
        """The next frame, in the order of the kept tracks, to which the keyframes are brought.

        Args:
            p_world: (M, 3) metres, NaN where a track is lost.
            cov_world: (M, 3, 3) m^2.
            stamp_s: time of the frame, if known.
            keyframes: of the stream.

        Raises:
            ValueError: see `IncrementalFit.add`; nothing is changed then.
        """
        self._check(p_world, cov_world, stamp_s)
        seen = np.flatnonzero(np.isfinite(p_world).all(axis=1))
        fresh = np.setdiff1d(seen, self.ids)
        if fresh.size:
            kept = self._worth_keeping(seen, fresh.size, keyframes)
            self.ids = np.concatenate([self.ids[kept], fresh])
            keyframes.select_columns(kept, self.ids.size)
        p, cov = np.full((self.ids.size, 3), np.nan), np.full((self.ids.size, 3, 3), np.nan)
        here = np.isin(self.ids, seen)
        p[here], cov[here] = p_world[self.ids[here]], cov_world[self.ids[here]]
        number, self._frames, self._given = self._frames, self._frames + 1, p_world.shape[0]
        self._stamp_s = self._stamp_s if stamp_s is None else stamp_s
        return StreamFrame(number, p, cov)

    def _worth_keeping(
        self, seen: NDArray[np.int_], fresh: int, keyframes: Keyframes
    ) -> NDArray[np.int_]:
        """Places of the tracks to keep; of the lost, those go whose keyframes have most others."""
        kept = np.ones(self.ids.size, dtype=bool)
        lost = np.flatnonzero(~np.isin(self.ids, seen))
        surplus = min(self.ids.size + fresh - self._most, lost.size)
        if surplus > 0:
            observed = keyframes.tracks().observed
        for _ in range(surplus):
            others = observed[:, kept].sum(axis=1)
            least = np.where(observed, others[:, None], observed.shape[1] + 1).min(axis=0)
            kept[lost[np.argmax(np.where(kept[lost], least[lost], -1))]] = False
        return np.flatnonzero(kept)

    def _check(self, p_world: FloatArray, cov_world: FloatArray, stamp_s: float | None) -> None:
        frame = f"frame {self._frames}"
        if p_world.ndim != 2 or p_world.shape[1] != 3 or cov_world.shape != (*p_world.shape, 3):
            raise ValueError(
                f"{frame}: points {p_world.shape} and covariances {cov_world.shape}, "
                "expected (N, 3) and (N, 3, 3)"
            )
        if p_world.shape[0] < self._given:
            raise ValueError(
                f"{frame}: {p_world.shape[0]} tracks after {self._given}; expected at least as "
                "many, NaN where a track is lost"
            )
        cov = cov_world[np.isfinite(p_world).all(axis=1)]
        if not np.isfinite(cov).all() or not (np.linalg.eigvalsh(cov) > 0).all():
            raise ValueError(f"{frame}: a covariance is not positive definite")
        if stamp_s is not None and not stamp_s > self._stamp_s:
            raise ValueError(
                f"{frame}: stamp {stamp_s} s after {self._stamp_s} s; expected to grow"
            )
