"""The grid of fronts: filled once, with as many as asked for; the free one keeps its size."""

from __future__ import annotations

import numpy as np
import pytest

from sim.objects.suites.faces import FaceConfig, sample_face, sample_stack


@pytest.mark.parametrize("n", [2, 4, 8])
@pytest.mark.parametrize("part_m", [(0.4, 0.18), (0.35, 0.6)])
def test_a_face_has_its_fronts_each_cell_one_and_the_free_one_keeps_its_size(
    n: int, part_m: tuple[float, float]
):
    places, counts = set(), []
    for seed in range(10):
        size, face = sample_face(part_m, n, np.random.default_rng(seed))
        mask = face.mask()
        assert set(mask.ravel().tolist()) == set(range(len(face.fronts)))
        assert sum(at_size(face, i) for i in range(len(face.fronts))) == mask.size  # none overlaps
        counts.append(len(face.fronts))
        np.testing.assert_allclose(np.multiply(face.share(0), size), part_m, atol=0.01)
        assert size[0] <= FaceConfig().width_m + 1e-9
        places.add((face.fronts[0].top, face.fronts[0].left))
    assert max(counts) == n and np.mean(counts) > n - 0.5
    assert len(places) > 1  # the free one is not always in the same place


def at_size(face, front: int) -> int:
    at = face.fronts[front]
    return (at.bottom - at.top) * (at.right - at.left)


def test_what_cannot_hold_so_many_fronts_gets_fewer():
    size, face = sample_face((0.8, 0.9), 8, np.random.default_rng(0))
    assert 1 <= len(face.fronts) < 8
    assert size[0] >= 0.8 and size[1] >= 0.9


def test_a_stack_fills_its_height_with_fronts_that_are_neither_too_low_nor_too_tall():
    for seed in range(20):
        face = sample_stack(0.3, 0.8, 3, np.random.default_rng(seed))
        assert len(face.fronts) == 3 and len(face.columns) == 1
        heights = 0.8 * np.array(face.rows)
        assert heights.sum() == pytest.approx(0.8)
        assert heights.min() >= FaceConfig().low_m[0] - 0.005
