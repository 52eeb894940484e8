"""Tracks to start from: those that go with the hand, though it slips a little."""

import numpy as np

from akm_fg.perception.moving_part.motion_config import MotionSegmentationConfig
from akm_fg.perception.moving_part.motion_seeds import held_tracks, with_hand
from akm_fg.records import PointTracks

T = 20
CONFIG = MotionSegmentationConfig()
Q = np.linspace(0.0, 0.6, T)


def swung(x: np.ndarray) -> np.ndarray:
    """(T, N, 3) of points (N, 3) of a door about the world's y."""
    c, s, o, one = np.cos(Q), np.sin(Q), np.zeros(T), np.ones(T)
    R = np.array([[c, o, s], [o, one, o], [-s, o, c]]).transpose(2, 0, 1)
    return np.einsum("tij,nj->tni", R, x)


def door_and_frame() -> PointTracks:
    """Nine points of a door, seen to 1 mm, and two of what stands beside it."""
    x = np.array([[a, b, 0.0] for a in (0.1, 0.25, 0.4) for b in (0.1, 0.3, 0.5)])
    rest = np.tile([[-0.2, 0.3, 0.0], [0.7, 0.3, 0.1]], (T, 1, 1))
    p = np.concatenate([swung(x), rest], axis=1)
    p += np.random.default_rng(0).normal(scale=0.001, size=p.shape)
    return PointTracks(p, np.tile(1e-6 * np.eye(3), (*p.shape[:2], 1, 1)))


def test_tracks_that_keep_their_distance_to_a_hand_that_slips_are_held():
    """Fingers creep by 1 cm along the handle; the tracks are five times as exact."""
    creep = np.linspace(-0.005, 0.005, T)
    handle = swung(np.array([[0.45, 0.3, -0.04]]))[:, 0]
    hand = handle + creep[:, None] * np.array([0.0, 1.0, 0.0])
    held = held_tracks(door_and_frame(), np.ones(11, bool), hand, CONFIG)
    assert held.tolist() == list(range(9))


def test_a_hand_that_slides_by_a_decimetre_holds_nothing_above_or_below_it():
    slide = np.linspace(-0.05, 0.05, T)
    handle = swung(np.array([[0.45, 0.3, -0.04]]))[:, 0]
    hand = handle + slide[:, None] * np.array([0.0, 1.0, 0.0])
    held = held_tracks(door_and_frame(), np.ones(11, bool), hand, CONFIG)
    assert not set(held.tolist()) & {0, 2, 3, 5, 6, 8}


def test_the_hand_as_a_track_is_as_sure_as_fingers_on_a_handle_are():
    """Errors of 5 mm in each direction weigh one per number; unknown frames have no covariance."""
    hand = swung(np.array([[0.45, 0.3, -0.04]]))[:, 0]
    hand[4] = np.nan
    both = with_hand(door_and_frame(), hand, CONFIG)
    np.testing.assert_array_equal(both.p_world[:, -1], hand)
    assert np.isnan(both.cov_world[4, -1]).all()
    error = np.full(3, 0.005)
    np.testing.assert_allclose(error @ np.linalg.inv(both.cov_world[0, -1]) @ error, 3.0)
