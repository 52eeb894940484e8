"""Batches of small systems of which some cannot be solved: these give NaN, the others go on.

NumPy ends a whole batch at its first singular matrix, and an eigenvalue decomposition at its first
NaN. Here every point has a matrix of its own: one that cannot be followed is no reason to lose the
others. Comparisons with NaN are False, so what asks "is it good" leaves such a point out by itself.
"""

from __future__ import annotations

import numpy as np

from akm_fg.records import BoolArray, FloatArray


def solutions(M: FloatArray, b: FloatArray) -> FloatArray:
    """Solutions (..., n, k) of M x = b; NaN where M (..., n, n) is singular."""
    try:
        return np.asarray(np.linalg.solve(M, b))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.solve(_regular(M), b))


def inverses(M: FloatArray) -> FloatArray:
    """Inverses of matrices (..., n, n); NaN where there is none."""
    try:
        return np.asarray(np.linalg.inv(M))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.inv(_regular(M)))


def eigenvalues(M: FloatArray) -> FloatArray:
    """Of symmetric matrices (..., n, n), growing (..., n); NaN where an entry is not finite."""
    finite = _finite(M)
    return np.where(finite[..., 0], np.linalg.eigvalsh(np.where(finite, M, 0.0)), np.nan)


def eigensystems(M: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues as of `eigenvalues`, and eigenvectors in columns (..., n, n)."""
    finite = _finite(M)
    w, V = np.linalg.eigh(np.where(finite, M, 0.0))
    return np.where(finite[..., 0], w, np.nan), V


def singular_values(M: FloatArray) -> FloatArray:
    """Of matrices (..., n, m), falling; NaN where an entry is not finite."""
    finite = _finite(M)
    s = np.linalg.svd(np.where(finite, M, 0.0), compute_uv=False)
    return np.where(finite[..., 0], s, np.nan)


def _finite(M: FloatArray) -> BoolArray:
    """(..., 1, 1) whether all entries of each matrix are finite."""
    return np.asarray(np.isfinite(M).all(axis=(-2, -1), keepdims=True))


def _regular(M: FloatArray) -> FloatArray:
    """The batch with NaN in place of the matrices that NumPy calls singular."""
    flat = M.reshape(-1, *M.shape[-2:]).copy()
    for i, one in enumerate(flat):
        try:
            np.linalg.inv(one)
        except np.linalg.LinAlgError:
            flat[i] = np.nan
    return flat.reshape(M.shape)
