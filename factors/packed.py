"""Symmetric 3x3 matrices as six numbers, many at a time: xx, xy, xz, yy, yz, zz.

Covariances and weights of point tracks are kept this way, frames first: (T, 6, N) for the points
of T frames. A stack of 3x3 matrices would spend its time in the calls for each. Where all are
multiples of the identity, one number stands for the six: (T, 1, N).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROW, COL = np.triu_indices(3)  # of the six numbers
UNPACK = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # packed index of every entry


def rotated(information: Array, rotation: Array) -> Array:
    """R^T Lambda R for packed Lambda (T, 6, N) and rotations (T, 3, 3)."""
    if information.shape[1] == 1:
        return information
    left, right = rotation[:, :, ROW], rotation[:, :, COL]
    # out_(ab) = sum_ij R_ia R_jb L_ij, the pair (i, j) folded onto the packed index
    full = np.einsum("tip,tjp->tpij", left, right)
    fold = np.empty((rotation.shape[0], 6, 6))
    for k, (i, j) in enumerate(zip(ROW, COL, strict=True)):
        fold[:, :, k] = full[:, :, i, j] if i == j else full[:, :, i, j] + full[:, :, j, i]
    return fold @ information


def times(packed: Array, v: Array) -> Array:
    """Packed symmetric (T, 6, N) times vectors (T, 3, N)."""
    if packed.shape[1] == 1:
        return packed * v
    x, y, z = v[:, 0], v[:, 1], v[:, 2]
    out = np.empty((max(len(packed), len(v)), 3, v.shape[2]))
    out[:, 0] = packed[:, 0] * x + packed[:, 1] * y + packed[:, 2] * z
    out[:, 1] = packed[:, 1] * x + packed[:, 3] * y + packed[:, 4] * z
    out[:, 2] = packed[:, 2] * x + packed[:, 4] * y + packed[:, 5] * z
    return out


def squared_length(packed: Array, v: Array) -> Array:
    """v^T Lambda v (T, N) for packed symmetric Lambda (T, 6, N) and vectors (T or 1, 3, N)."""
    x, y, z = v[:, 0], v[:, 1], v[:, 2]
    if packed.shape[1] == 1:
        return np.asarray(packed[:, 0] * (x * x + y * y + z * z))
    by_x = packed[:, 0] * x + 2 * (packed[:, 1] * y + packed[:, 2] * z)
    by_y = packed[:, 3] * y + 2 * (packed[:, 4] * z)
    return np.asarray(x * by_x + y * by_y + z * (packed[:, 5] * z))


def inverse_and_determinant(packed: Array) -> tuple[Array, Array]:
    """Inverse (6, ...) and determinant (...) of packed symmetric matrices, by cofactors."""
    if packed.shape[0] == 1:
        return 1 / packed, packed[0] * packed[0] * packed[0]
    a, b, c, d, e, f = packed
    inverse = np.empty_like(packed)
    for out, (k, m), (n, o) in zip(
        inverse,
        ((d, f), (c, e), (b, e), (a, f), (b, c), (a, d)),
        ((e, e), (b, f), (c, d), (c, c), (a, e), (b, b)),
        strict=True,
    ):
        np.multiply(k, m, out=out)
        out -= n * o
    determinant = a * inverse[0] + b * inverse[1] + c * inverse[2]
    inverse /= determinant
    return inverse, determinant


def multiples_of_identity(packed: Array) -> bool:
    """Whether packed matrices (6, ...) are all multiples of the identity."""
    a, b, c, d, e, f = packed
    return bool((a == d).all() and (a == f).all() and not (b.any() or c.any() or e.any()))
