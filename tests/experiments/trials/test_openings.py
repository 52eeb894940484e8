import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.trials.openings import make_opening, spatial_correlation


def _noise(opening):
    """(T, N, 3) of an opening that does not move."""
    return opening.tracks.p_world - opening.rest_world


@pytest.fixture(scope="module")
def correlated():
    return make_opening(0, "prismatic", 0.0, points=12, frames=3000, correlation_m=0.07)


def test_correlated_noise_has_the_claimed_standard_deviation_at_every_point(correlated):
    sd = _noise(correlated).std(axis=(0, 2))
    assert_allclose(sd, 0.003, rtol=0.05)
    assert_allclose(np.diag(correlated.cov_points), 0.003**2)


def test_correlated_noise_is_alike_as_a_gaussian_of_the_distance_says(correlated):
    noise = _noise(correlated).transpose(1, 0, 2).reshape(12, -1)
    p = correlated.rest_world
    d = np.linalg.norm(p[:, None] - p[None], axis=-1)
    assert_allclose(np.corrcoef(noise), np.exp(-(d**2) / (2 * 0.07**2)), atol=0.05)


def test_correlated_noise_is_independent_from_frame_to_frame_and_between_coordinates(correlated):
    noise = _noise(correlated)[:, 0]
    assert abs(np.corrcoef(noise[:-1, 0], noise[1:, 0])[0, 1]) < 0.06
    assert abs(np.corrcoef(noise[:, 0], noise[:, 1])[0, 1]) < 0.06


def test_without_a_length_the_noise_is_independent():
    assert_allclose(spatial_correlation(np.zeros((3, 3)), 0.0), np.eye(3))


def test_tracks_claim_what_they_are_told_to():
    opening = make_opening(0, noise_m=0.01, claimed_m=0.002)
    assert_allclose(opening.tracks.cov_world[3, 5], 0.002**2 * np.eye(3))
    assert_allclose(opening.cov_points[5, 5], 0.01**2)


def test_points_at_rest_are_where_the_noiseless_first_frame_is():
    opening = make_opening(3, "revolute", noise_m=0.0)
    assert_allclose(opening.tracks.p_world[0], opening.rest_world, atol=1e-12)
