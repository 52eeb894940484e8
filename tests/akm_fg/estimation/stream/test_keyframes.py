"""What is kept of a stream: averages worked by hand, places told apart, the limit."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.estimation.stream.keyframes import Keyframes, StreamFrame

SIGMA_M = 0.003
ALL = np.ones(8, dtype=bool)


def _frame(number, shift_m=0.0, seed=0, noise_m=0.0):
    """Eight points, shifted along x."""
    p = np.random.default_rng(3).uniform(-0.3, 0.3, (8, 3)) + np.array([shift_m, 0.0, 0.0])
    p += noise_m * np.random.default_rng(seed).normal(size=p.shape)
    return StreamFrame(number, p, np.tile(SIGMA_M**2 * np.eye(3), (8, 1, 1)))


def _still(number_from, number_to):
    return np.eye(3), np.zeros(3)


def _filled(shifts_m, most=10):
    keyframes = Keyframes(most, most_pooled=4, gate_sigmas=4.0)
    for number, shift in enumerate(shifts_m):
        frame = _frame(number, shift)
        distance = np.zeros(0) if number == 0 else keyframes.distances(frame, ALL, 1.0)[0]
        keyframes.add(frame, distance, _still, 1.0)
    return keyframes


def test_two_frames_average_by_their_covariances():
    keyframes = _filled([0.0, 0.1])
    one = keyframes.frames[1]
    other = StreamFrame(2, one.p_world + np.array([0.005, 0.0, 0.0]), 4 * one.cov_world)
    keyframes.pool(1, other, 1.0)
    pooled = keyframes.frames[1]
    assert_allclose(pooled.p_world, one.p_world + np.array([0.001, 0.0, 0.0]))  # weights 4 : 1
    assert_allclose(pooled.cov_world, 0.8 * one.cov_world)
    assert keyframes.counts == [1, 2]


def test_an_observation_far_off_is_not_pooled_and_a_new_track_is_taken():
    keyframes = _filled([0.0, 0.1])
    keyframes.frames[1].p_world[2] = np.nan
    before = keyframes.frames[1].p_world.copy()
    other = _frame(2, 0.1)
    other.p_world[5] += 0.05
    keyframes.pool(1, other, 1.0)
    pooled = keyframes.frames[1]
    assert_allclose(pooled.p_world[5], before[5])
    assert_allclose(pooled.p_world[2], other.p_world[2])
    assert_allclose(pooled.cov_world[[2, 5]], np.tile(SIGMA_M**2 * np.eye(3), (2, 1, 1)))


def test_a_keyframe_stands_for_no_more_frames_than_it_may():
    keyframes = _filled([0.0, 0.1])
    for number in range(2, 9):
        keyframes.pool(1, _frame(number, 0.1), 1.0)
    assert keyframes.counts == [1, 4]
    assert_allclose(keyframes.frames[1].cov_world, keyframes.frames[0].cov_world / 4)


def test_at_the_limit_the_two_closest_become_one_and_the_first_stays():
    keyframes = _filled([0.0, 0.001, 0.1, 0.103, 0.2], most=5)
    new = _frame(5, 0.3)
    keyframes.add(new, keyframes.distances(new, ALL, 1.0)[0], _still, 1.0)
    assert keyframes.numbers.tolist() == [0, 1, 2, 4, 5]
    assert keyframes.counts == [1, 1, 2, 1, 1]
    assert_allclose(keyframes.frames[2].p_world, _frame(2, 0.1015).p_world)
    # The distances left are those of the frames left.
    later = _frame(6, 0.0)
    want = keyframes.distances(later, ALL, 1.0)[0]
    assert want[1] < 0.01 < want[2]
    assert_allclose(keyframes.least_distance_m(), 0.1, rtol=0.05)


def test_the_later_of_two_keyframes_is_moved_to_where_the_earlier_is_before_they_become_one():
    """Both saw the same panel, 3 mm further on in the later one: nothing is left of that."""
    shifts = [0.0, 0.05, 0.1, 0.103, 0.2, 0.3]

    def motion(number_from, number_to):
        return np.eye(3), np.array([shifts[number_to] - shifts[number_from], 0.0, 0.0])

    keyframes = _filled(shifts[:5], most=5)
    new = _frame(5, shifts[5])
    keyframes.add(new, keyframes.distances(new, ALL, 1.0)[0], motion, 1.0)
    assert keyframes.numbers.tolist() == [0, 1, 2, 4, 5]
    assert_allclose(keyframes.frames[2].p_world, _frame(2, 0.1).p_world, atol=1e-12)
    assert_allclose(keyframes.frames[2].cov_world, keyframes.frames[0].cov_world / 2)


def test_noise_does_not_make_distances_longer():
    """Of points 5 mm apart, seen to 3 mm: on average the squares are 25 mm^2, not more."""
    keyframes = _filled([0.0])
    found = [
        keyframes.distances(_frame(1, 0.005, seed, SIGMA_M), ALL, np.sqrt(0.5))[0][0]
        for seed in range(400)
    ]
    # Without their noise's six numbers of 9 mm^2 / 8 each they would be 32 mm^2.
    assert_allclose(np.mean(np.square(found)), 0.005**2, rtol=0.08)


def test_distance_of_a_turn_about_the_middle_is_that_of_the_points():
    """The centroid stays where it is: only the points' displacement tells."""
    first = _frame(0)
    middle = first.p_world.mean(axis=0)
    R = gtsam.Rot3.Rz(0.2).matrix()
    turned = (first.p_world - middle) @ R.T + middle
    keyframes = _filled([0.0])
    distance, noise = keyframes.distances(
        StreamFrame(1, turned, first.cov_world * 1e-6), ALL, scale=1e-3
    )
    want = np.sqrt(((turned - first.p_world) ** 2).sum(axis=1).mean())
    assert_allclose(distance[0], want, rtol=1e-3)
    assert noise[0] < 1e-5


def test_noise_alone_stays_below_its_own_bound():
    keyframes = _filled([0.0])
    runs = [
        keyframes.distances(_frame(1, 0.0, seed, SIGMA_M), ALL, np.sqrt(0.5)) for seed in range(200)
    ]
    ratio = np.array([distance[0] / noise[0] for distance, noise in runs])
    assert (ratio < 1.5).mean() > 0.97


def test_too_few_common_tracks_are_infinitely_far():
    keyframes = _filled([0.0])
    blind = _frame(1)
    blind.p_world[2:] = np.nan
    blind = StreamFrame(1, blind.p_world, np.where(np.isnan(blind.p_world)[..., None], np.nan, 1.0))
    assert keyframes.distances(blind, ALL, 1.0)[0][0] == np.inf


@pytest.mark.parametrize("columns", [[0, 1, 2], [5, 3]])
def test_tracks_are_rearranged_and_new_places_are_empty(columns):
    keyframes = _filled([0.0, 0.1])
    keyframes.select_columns(np.array(columns), 4)
    p = keyframes.tracks().p_world
    assert p.shape == (2, 4, 3)
    assert_allclose(p[1, : len(columns)], _frame(1, 0.1).p_world[columns])
    assert np.isnan(p[:, len(columns) :]).all()
