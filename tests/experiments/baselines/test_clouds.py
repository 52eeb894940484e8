import numpy as np
import pytest

from experiments.baselines.clouds import choose_keyframes, part_cloud


def test_keyframes_are_farthest_apart_in_state_with_the_first_among_them():
    states = np.array([0.0, 0.01, 0.3, np.nan, 0.1, 0.02, 0.2])
    np.testing.assert_array_equal(choose_keyframes(states, 4), [0, 2, 4, 6])


def test_no_more_keyframes_than_frames_with_a_state():
    np.testing.assert_array_equal(choose_keyframes(np.array([0.0, np.nan, 0.0]), 5), [0, 2])


def test_normals_of_a_sphere_point_along_its_radii():
    rng = np.random.default_rng(0)
    radii = rng.normal(size=(3000, 3))
    radii /= np.linalg.norm(radii, axis=1, keepdims=True)
    cloud = part_cloud(0.3 * radii + [1, 2, 3])
    assert np.abs((cloud.normals * radii).sum(axis=1)).min() > 0.99


def test_points_that_were_not_seen_are_refused():
    with pytest.raises(ValueError, match="finite"):
        part_cloud(np.full((10, 3), np.nan))
