"""Checks analytic derivatives against central differences. Used by every factor's tests."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def central_difference(function: Callable[[Array], Array], at: Array, step: float = 1e-6) -> Array:
    """Jacobian (m, n) of `function` (n,) -> (m,) by central differences."""
    columns = []
    for k in range(at.size):
        h = np.zeros(at.size)
        h[k] = step
        columns.append((np.asarray(function(at + h)) - np.asarray(function(at - h))) / (2 * step))
    return np.stack(columns, axis=-1)


def retract(values: gtsam.Values, keys: list[int], dims: list[int], delta: Array) -> gtsam.Values:
    """`values` moved by the stacked tangent `delta` of the given keys."""
    moved = gtsam.VectorValues()
    start = 0
    for key, dim in zip(keys, dims, strict=True):
        moved.insert(key, delta[start : start + dim])
        start += dim
    return values.retract(moved)


def numeric_gradient(
    factor: gtsam.NonlinearFactor, values: gtsam.Values, dims: list[int], step: float = 1e-6
) -> Array:
    """Gradient of the factor's cost (half squared whitened error) by central differences."""
    keys = list(factor.keys())
    return central_difference(
        lambda d: np.atleast_1d(factor.error(retract(values, keys, dims, d))),
        np.zeros(sum(dims)),
        step,
    )[0]


def analytic_gradient(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> Array:
    """Gradient of the factor's cost from its linearisation, in the order of its keys."""
    A, b = factor.linearize(values).jacobian()
    return -A.T @ b


def numeric_jacobian(
    factor: gtsam.NoiseModelFactor, values: gtsam.Values, dims: list[int], step: float = 1e-6
) -> Array:
    """Jacobian of the factor's unwhitened error by central differences, keys side by side."""
    keys = list(factor.keys())
    return central_difference(
        lambda d: np.asarray(factor.unwhitenedError(retract(values, keys, dims, d))),
        np.zeros(sum(dims)),
        step,
    )
