"""The one door through which a residual of ours enters GTSAM.

GTSAM 4.3 ends the process on a Jacobian block of the wrong shape, so shapes are checked here.
Callbacks are closures over plain arrays, never bound methods: those are never freed.
"""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Residual = Callable[[gtsam.Values, bool], tuple[Array, list[Array] | None]]


def make_factor(
    residual: Residual, dims: dict[int, int], noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """Wrap `residual(values, want_jacobians) -> (error, blocks)` as a GTSAM factor.

    Args:
        residual: returns the error (m,) and, where asked, one block (m, d) a key, in the order
            of `dims`.
        dims: key -> tangent dimension d.
        noise: noise model of dimension m.

    Raises:
        ValueError: (when evaluated) an error or a block of the wrong shape.
    """
    rows = noise.dim()

    def error(_: object, values: gtsam.Values, H: list[Array] | None) -> Array:
        e, blocks = residual(values, H is not None)
        if e.shape != (rows,):
            raise ValueError(f"error has shape {e.shape}, expected {(rows,)}")
        if H is not None:
            got = [b.shape for b in blocks or []]
            want = [(rows, d) for d in dims.values()]
            if got != want:
                raise ValueError(f"Jacobian blocks {got}, expected {want}")
            for i, block in enumerate(blocks or []):
                H[i] = np.asfortranarray(block)
        return e

    return gtsam.CustomFactor(noise, list(dims), error)


def square_root_rows(
    information: Array, gradient: Array, twice_cost: float, definite: int = 0
) -> tuple[Array, Array]:
    """The fewest rows (A, e) with A^T A = information, A^T e = gradient, e^T e = twice_cost.

    A factor with many residuals but few variables enters GTSAM through these d + 1 rows: same
    normal equations, same cost. `e` is not differentiated by A row by row; only its normal
    equations and its length have a meaning.

    Args:
        information: (d, d) positive semi-definite (gauge directions may be zero).
        gradient: (d,) of half the cost.
        twice_cost: at least gradient^T information^-1 gradient.
        definite: the last so many variables should be known if all else is (states are): they are
            eliminated by Cholesky, which is faster than eigenvectors. Where they are not, nothing
            is lost but time.

    Returns:
        A (d + 1, d) and e (d + 1,).
    """
    d = gradient.size
    A, e = np.zeros((d + 1, d)), np.zeros(d + 1)
    k = d - definite
    try:
        lower = np.linalg.cholesky(information[k:, k:])
    except np.linalg.LinAlgError:
        k, lower = d, np.zeros((0, 0))
    left, slope = information[:k, :k], gradient[:k]
    if k < d:
        known = np.column_stack([information[k:, :k], gradient[k:]])
        known = np.linalg.solve(lower, known)
        A[k:d, :k], e[k:d] = known[:, :k], known[:, k]
        A[k:d, k:] = lower.T
        left, slope = left - A[k:d, :k].T @ A[k:d, :k], slope - A[k:d, :k].T @ e[k:d]
    A[:k, :k], e[:k] = _eigen_rows(left, slope, float(information.diagonal().max()))
    e[d] = max(twice_cost - float(e[:d] @ e[:d]), 0.0) ** 0.5
    return A, e


def _eigen_rows(information: Array, gradient: Array, largest: float) -> tuple[Array, Array]:
    """Rows (d, d) and errors (d,) of a part of a matrix whose largest entry is given."""
    eigenvalues, vectors = np.linalg.eigh(information)
    # Directions without information carry only the rounding of what was subtracted from them.
    kept = eigenvalues > 1e-13 * max(largest, 1e-300)
    roots = np.sqrt(np.where(kept, eigenvalues, 0.0))
    e = np.where(kept, vectors.T @ gradient / np.where(kept, roots, 1.0), 0.0)
    return roots[:, None] * vectors.T, e
