"""Intervals of what is estimated from a number of trials: shares, medians, root mean squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from akm_fg.records import FloatArray

LEVEL = 0.95


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and the interval that holds the true one at the level asked for."""

    value: float
    low: float
    high: float


def wilson(successes: int, trials: int, level: float = LEVEL) -> Estimate:
    """A share with Wilson's score interval (1927): right also near 0 and 1.

    Raises:
        ValueError: no trials, or more successes than trials.
    """
    if not 0 <= successes <= trials or trials == 0:
        raise ValueError(f"{successes} successes in {trials} trials")
    interval = stats.binomtest(successes, trials).proportion_ci(level, method="wilson")
    return Estimate(successes / trials, float(interval.low), float(interval.high))


def share(flags: Sequence[bool], level: float = LEVEL) -> Estimate:
    """Share of the true ones, Wilson's interval."""
    return wilson(sum(flags), len(flags), level)


def median(values: ArrayLike, level: float = LEVEL) -> Estimate:
    """Median with the interval of order statistics, which asks nothing of the distribution.

    The median is below the k-th smallest only if fewer than k of n values are below it: k is the
    largest with P(Binomial(n, 1/2) < k) <= (1 - level) / 2. With fewer than six values there is
    none, and the interval is the range. A trial without a value counts as infinitely far off:
    pass inf, not NaN.

    Raises:
        ValueError: no values, or NaN.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    n = ordered.size
    if n == 0 or np.isnan(ordered).any():
        raise ValueError(f"{n} values, NaN among them: {bool(np.isnan(ordered).any())}")
    middle = (ordered[(n - 1) // 2], ordered[n // 2])
    value = middle[0] if middle[0] == middle[1] else sum(middle) / 2  # inf stays inf
    low, high = stats.quantile_test(ordered, p=0.5).confidence_interval(level)
    if np.isnan(low):  # too few
        low, high = ordered[0], ordered[-1]
    return Estimate(float(value), float(low), float(high))


def rms_ratio(
    squares: ArrayLike, expected: ArrayLike, rng: np.random.Generator, draws: int = 1000
) -> Estimate:
    """Root of summed squares over their summed expectations, percentile bootstrap over trials.

    Args:
        squares: (n,) squared errors.
        expected: (n,) their expectations.
        rng: draws the samples.
        draws: how many.
    """
    e2, v = np.asarray(squares, dtype=float), np.asarray(expected, dtype=float)
    value = float(_root_of_ratio(e2, v))
    if e2.size < 2:  # one trial says nothing of another
        return Estimate(value, value, value)
    drawn = stats.bootstrap(
        (e2, v),
        _root_of_ratio,
        paired=True,
        n_resamples=draws,
        method="percentile",
        confidence_level=LEVEL,
        rng=rng,
    )
    return Estimate(value, *(float(end) for end in drawn.confidence_interval))


def _root_of_ratio(squares: FloatArray, expected: FloatArray, axis: int = -1) -> FloatArray:
    return np.asarray(np.sqrt(squares.sum(axis=axis) / expected.sum(axis=axis)))


def mean_nees(total_nees: float, dof: int) -> Estimate:
    """NEES per degree of freedom; low and high bound 95 % of such means where covariances are true.

    Args:
        total_nees: sum over independent trials.
        dof: sum of their degrees of freedom.
    """
    low, high = stats.chi2.interval(LEVEL, dof)
    return Estimate(total_nees / dof, float(low / dof), float(high / dof))
