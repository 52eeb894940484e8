"""Spectral clustering in two, of a few hundred things whose likeness is known.

The two leading eigenvectors of the normalised affinity (Shi and Malik, "Normalized cuts and image
segmentation", 2000), and which cluster a row is of by a pivoted QR decomposition, without a start
to choose (Damle, Minden and Ying, "Simple, direct and efficient multi-way spectral clustering",
2019). What scikit-learn finds as `SpectralClustering(2, assign_labels="cluster_qr")`; loading that
takes a second, in the midst of a stream.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from akm_fg.records import FloatArray


def two_clusters(affinity: FloatArray) -> NDArray[np.int_]:
    """Labels (n,), 0 or 1.

    Args:
        affinity: (n, n) symmetric, above 0; its diagonal does not matter.
    """
    linked = affinity - np.diag(np.diag(affinity))
    root = np.sqrt(linked.sum(axis=0))
    leading = np.linalg.eigh(linked / np.outer(root, root))[1][:, -2:] / root[:, None]
    first = int((leading**2).sum(axis=1).argmax())  # the pivots of a QR decomposition
    along = leading[first] / np.linalg.norm(leading[first])
    second = int(np.abs(leading @ np.array([-along[1], along[0]])).argmax())
    left, _, right = np.linalg.svd(leading[[first, second]].T)
    return np.asarray(np.abs(leading @ (left @ right)).argmax(axis=1))
