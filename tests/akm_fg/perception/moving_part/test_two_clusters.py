"""Two clusters: what scikit-learn finds, and what anyone sees."""

import numpy as np
import pytest

from akm_fg.perception.moving_part.two_clusters import two_clusters


def _affinity(rng: np.random.Generator, apart: float) -> tuple[np.ndarray, np.ndarray]:
    """Likeness of points in two heaps, and which heap each is of."""
    heap = (np.arange(rng.integers(30, 120)) > 20).astype(int)
    x = rng.normal(size=(heap.size, 2)) + apart * heap[:, None]
    distance = np.linalg.norm(x[:, None] - x, axis=2)
    near = np.maximum(np.sort(distance, axis=1)[:, 7], 0.3)
    return np.exp(-(distance**2) / (near[:, None] * near)) + 1e-6, heap


def _alike(a: np.ndarray, b: np.ndarray) -> float:
    return max(float((a == b).mean()), float((a != b).mean()))


@pytest.mark.parametrize("seed", range(5))
def test_heaps_that_lie_apart_are_told_apart(seed):
    affinity, heap = _affinity(np.random.default_rng(seed), 10.0)
    assert _alike(two_clusters(affinity), heap) == 1.0


@pytest.mark.parametrize("seed", range(10))
def test_labels_are_those_of_scikit_learn_where_heaps_overlap(seed):
    from sklearn.cluster import SpectralClustering

    affinity, _ = _affinity(np.random.default_rng(seed), 2.0)
    theirs = SpectralClustering(
        2, affinity="precomputed", assign_labels="cluster_qr", random_state=0
    ).fit_predict(affinity)
    assert _alike(two_clusters(affinity), theirs) == 1.0
