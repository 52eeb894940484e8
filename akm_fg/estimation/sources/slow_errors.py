"""Likelihood of residuals that err slowly: independent noise, and errors that change on the way.

A tag's orientation is biased with the view, a part flexes: frames in neighbouring places err
together, whenever they were taken. A hand tilts in its grasp: frames that follow on each other err
together, wherever they are. Such errors are a Gaussian process with an exponential covariance, half
of it over the places p, half over the way s gone so far, beside independent noise and an offset
that nobody knows:

    cov(e_i, e_j) = sigma_slow^2 a_ij + sigma^2 [i = j] + flat offset,
    a_ij = exp(-|p_i - p_j| / extent) / 2 + exp(-|s_i - s_j| / length of the way) / 2.

Both levels are known beforehand, at least as large as what the best kind leaves, and the same for
every kind. What is below them is no evidence for the kind that happens to explain it: a level
fitted to each kind's own residuals would reward it a hundred times over.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from akm_fg.records import FloatArray
from factors.measurements.orientation_track import log_so3

OUTLIER_MEDIANS = 3.0  # residuals beyond so many medians are rejected, not averaged over


@dataclass(frozen=True, slots=True)
class SlowErrors:
    """What is known of the errors of K frames."""

    alike: FloatArray  # (K, K) correlations of the slow errors
    sigma: float  # independent from frame to frame, each coordinate
    sigma_slow: float  # of the slow ones

    def restricted(self, frames: NDArray[np.int_]) -> SlowErrors:
        """Of some of the frames (indices)."""
        return replace(self, alike=self.alike[np.ix_(frames, frames)])

    def log_likelihood(self, e: FloatArray) -> float:
        """Log density of residuals (K, d), their offset integrated out with a flat density."""
        root = self._root()
        frames, dims = e.shape
        power, log_det_offset = self._left(root, e)
        log_det = 2 * float(np.log(np.diag(root)).sum()) + log_det_offset
        return -0.5 * (power + dims * (log_det + (frames - 1) * math.log(2 * math.pi)))

    def times(self, e: FloatArray) -> float:
        """How large residuals (K, d) are, in what is known: root mean square, whitened."""
        power, _ = self._left(self._root(), e)
        return math.sqrt(power / max((len(e) - 1) * e.shape[1], 1))

    def wider(self, factor: float) -> SlowErrors:
        """Errors `factor` times as large."""
        return replace(self, sigma=factor * self.sigma, sigma_slow=factor * self.sigma_slow)

    def _root(self) -> FloatArray:
        cov = self.sigma_slow**2 * self.alike
        cov[np.diag_indices_from(cov)] += self.sigma**2 + 1e-12 * self.sigma_slow**2
        return np.asarray(np.linalg.cholesky(cov))

    @staticmethod
    def _left(root: FloatArray, e: FloatArray) -> tuple[float, float]:
        """Whitened square of what the best offset leaves, and log of the information on it."""
        ones = linalg.solve_triangular(root, np.ones(len(e)), lower=True)
        white = linalg.solve_triangular(root, e, lower=True)
        information = float(ones @ ones)
        told = ones @ white
        return float((white**2).sum() - (told**2).sum() / information), math.log(information)


def at_one_level(
    known: SlowErrors, residuals: Sequence[FloatArray]
) -> tuple[list[float], list[float]]:
    """Log densities of several kinds' residuals at what is known, or at what the best leaves.

    Frames in which the best is an outlier tell of no kind.

    Args:
        known: the errors beforehand.
        residuals: (K, d) of each kind.

    Returns:
        The log densities; how large the residuals are in what is known beforehand.
    """
    size = np.array([np.linalg.norm(e, axis=1) for e in residuals])
    best = size[np.argmin(np.median(size, axis=1))]
    kept = np.flatnonzero(best <= OUTLIER_MEDIANS * np.median(best))
    known = known.restricted(kept)
    times = [known.times(e[kept]) for e in residuals]
    errors = known.wider(max(1.0, min(times)))
    return [errors.log_likelihood(e[kept]) for e in residuals], times


def slow_correlations(path: FloatArray, R_world_part: FloatArray) -> FloatArray:
    """Correlations (K, K) of slow errors, `a` above; turning on the spot is a way, too.

    Args:
        path: (K, 3) of a marker.
        R_world_part: (K, 3, 3) its orientations.
    """
    apart = np.linalg.norm(path[:, None] - path, axis=-1)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    turns = np.linalg.norm(log_so3(R_world_part[:-1].swapaxes(1, 2) @ R_world_part[1:]), axis=1)
    shares = [each / each.sum() for each in (steps, turns) if each.sum() > 0]
    way = np.append(0.0, np.cumsum(np.mean(shares, axis=0))) if shares else np.zeros(len(path))
    by_place = np.exp(-apart / max(float(apart.max()), 1e-12))
    return np.asarray((by_place + np.exp(-np.abs(way[:, None] - way))) / 2)
