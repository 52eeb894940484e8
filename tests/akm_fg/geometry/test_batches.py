"""Batches with a singular member: that one is NaN, the others are as if it were not there."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.geometry.batches import (
    eigensystems,
    eigenvalues,
    inverses,
    singular_values,
    solutions,
)


@pytest.fixture
def batch():
    rng = np.random.default_rng(0)
    M = rng.normal(size=(5, 3, 3))
    return M @ M.transpose(0, 2, 1)


def test_a_singular_member_is_nan_and_the_others_are_solved(batch):
    b = np.ones((5, 3, 1))
    whole = solutions(batch, b)
    batch[2] = 0.0
    x = solutions(batch, b)
    assert np.isnan(x[2]).all()
    assert_allclose(np.delete(x, 2, 0), np.delete(whole, 2, 0))
    inverse = inverses(batch)
    assert np.isnan(inverse[2]).all()
    assert_allclose(np.delete(inverse @ batch, 2, 0), np.tile(np.eye(3), (4, 1, 1)), atol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_member_that_is_not_finite_has_no_eigenvalues_and_the_others_do(batch, bad):
    w = np.linalg.eigvalsh(np.delete(batch, 1, 0))
    batch[1, 0, 0] = bad
    for got in (eigenvalues(batch), eigensystems(batch)[0], singular_values(batch)[:, ::-1]):
        assert np.isnan(got[1]).all()
        assert_allclose(np.delete(got, 1, 0), w)


def test_no_members_are_no_trouble():
    none = np.zeros((0, 2, 2))
    assert inverses(none).shape == solutions(none, none).shape == (0, 2, 2)
    assert eigenvalues(none).shape == singular_values(none).shape == (0, 2)
