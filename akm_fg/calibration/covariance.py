"""Covariance of every variable of a graph at once, by singular values.

`gtsam.Marginals` works through Cholesky factors, whose rounding loses distortion coefficients
beside metres; the graph of a calibration is small enough for one dense decomposition.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from akm_fg.records import FloatArray

OPEN = 1e-10  # singular value over the largest, columns scaled to length 1: no information


@dataclass(frozen=True, slots=True)
class JointCovariance:
    """The covariance of all variables, on their stacked tangents."""

    cov: FloatArray  # (n, n)
    columns: dict[int, slice]  # of each key

    def of(self, key: int) -> FloatArray:
        """The block of one variable."""
        return self.cov[self.columns[key], self.columns[key]]


class OpenDirection(Exception):
    """A direction that no factor speaks of; `key` is the variable that it moves most."""

    def __init__(self, key: int) -> None:
        super().__init__(f"no information about {gtsam.DefaultKeyFormatter(key)}")
        self.key = key


def joint_covariance(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> JointCovariance:
    """Invert the information of the linearised graph.

    Raises:
        OpenDirection: the information is singular.
    """
    ordering = gtsam.Ordering()
    columns, start, zeros = {}, 0, values.zeroVectors()
    keys: list[int] = list(values.keys())
    for key in keys:
        ordering.push_back(key)
        columns[key] = slice(start, start + zeros.at(key).size)
        start = columns[key].stop
    A, _ = graph.linearize(values).jacobian(ordering)
    lengths = np.linalg.norm(A, axis=0)
    _, singular, directions = np.linalg.svd(
        A / np.where(lengths > 0, lengths, 1.0), full_matrices=False
    )
    if lengths.min() == 0 or singular[-1] < OPEN * singular[0]:
        open_way = directions[-1] if lengths.min() > 0 else (lengths == 0).astype(float)
        shares = {key: float((open_way[at] ** 2).sum()) for key, at in columns.items()}
        raise OpenDirection(max(shares, key=lambda key: shares[key]))
    root = (directions.T / singular) / lengths[:, None]
    return JointCovariance(root @ root.T, columns)
