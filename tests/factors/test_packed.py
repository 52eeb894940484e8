"""Packed symmetric matrices: each operation against numpy's on the full matrices."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.packed import (
    COL,
    ROW,
    UNPACK,
    inverse_and_determinant,
    multiples_of_identity,
    rotated,
    times,
)

T, N = 4, 5


@pytest.fixture
def full():
    """Symmetric positive definite matrices (T, N, 3, 3)."""
    root = np.eye(3) + 0.4 * np.random.default_rng(0).normal(size=(T, N, 3, 3))
    return root @ root.swapaxes(-1, -2)


@pytest.fixture
def one():
    """Positive numbers (T, 1, N): multiples of the identity."""
    return np.random.default_rng(1).uniform(0.5, 2.0, (T, 1, N))


def _packed(full):
    return full[..., ROW, COL].swapaxes(1, 2)


def _unpacked(packed):
    return packed[:, UNPACK].transpose(0, 3, 1, 2)


def _rotations():
    turns = np.random.default_rng(2).normal(size=(T, 3))
    return np.array([gtsam.Rot3.Expmap(w).matrix() for w in turns])


def test_packing_and_unpacking_gives_the_matrix_back(full):
    assert_allclose(_unpacked(_packed(full)), full)


def test_rotated_is_the_matrix_seen_from_the_turned_frame(full):
    R = _rotations()
    want = np.einsum("tji,tnjk,tkl->tnil", R, full, R)
    assert_allclose(_unpacked(rotated(_packed(full), R)), want, atol=1e-12)


def test_times_is_the_product_of_matrix_and_vector(full):
    v = np.random.default_rng(3).normal(size=(T, 3, N))
    assert_allclose(times(_packed(full), v), np.einsum("tnij,tjn->tin", full, v), atol=1e-12)


def test_inverse_and_determinant_are_numpys(full):
    inverse, determinant = inverse_and_determinant(_packed(full).swapaxes(0, 1))
    assert_allclose(_unpacked(inverse.swapaxes(0, 1)), np.linalg.inv(full), rtol=1e-9, atol=1e-9)
    assert_allclose(determinant, np.linalg.det(full), rtol=1e-9)


def _six(one):
    """Packed (T, 6, N) of multiples of the identity (T, 1, N)."""
    return one * np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])[:, None]


def test_one_number_stands_for_six_in_every_operation(one):
    R, v = _rotations(), np.random.default_rng(4).normal(size=(T, 3, N))
    assert_allclose(_six(rotated(one, R)), rotated(_six(one), R), atol=1e-12)
    assert_allclose(times(one, v), times(_six(one), v))
    inverse, determinant = inverse_and_determinant(one.swapaxes(0, 1))
    inverse6, determinant6 = inverse_and_determinant(_six(one).swapaxes(0, 1))
    assert_allclose(_six(inverse.swapaxes(0, 1)), inverse6.swapaxes(0, 1))
    assert_allclose(determinant, determinant6)


def test_multiples_of_the_identity_are_told_from_what_is_nearly_one(one):
    packed = _six(one).swapaxes(0, 1)
    assert multiples_of_identity(packed)
    for k in range(6):
        off = packed.copy()
        off[k, 2, 3] += 1e-12
        assert not multiples_of_identity(off), k
