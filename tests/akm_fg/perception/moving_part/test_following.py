"""Tracks that follow a motion known from elsewhere."""

import numpy as np

from akm_fg.perception.moving_part.following import following
from akm_fg.records import PointTracks
from factors.joint import Joint

T = 12
Q = np.linspace(0.0, 0.5, T)
R, t = Joint("revolute", np.eye(4), 0.0).motion(Q)
KNOWN = np.ones(T, dtype=bool)


def _tracks(*paths):
    p = np.stack(paths, axis=1)
    return PointTracks(p, np.tile(1e-6 * np.eye(3), (*p.shape[:2], 1, 1)))


def _moving(x):
    return R @ np.array(x) + t


def _resting(x):
    return np.tile(x, (T, 1)).astype(float)


def test_what_goes_with_the_part_follows_and_what_rests_does_not():
    tracks = _tracks(_moving([0.4, 0.0, 0.1]), _resting([0.4, 0.0, 0.1]), _moving([0.3, 0.1, 0.0]))
    assert following(tracks, R, t, KNOWN).tolist() == [True, False, True]


def test_what_moves_on_its_own_does_not_follow():
    own = _resting([0.4, 0.0, 0.0]) + np.linspace(0, 0.2, T)[:, None] * np.array([0.0, -1.0, 0.0])
    assert not following(_tracks(own), R, t, KNOWN).any()


def test_a_point_near_the_hinge_is_no_witness():
    assert not following(_tracks(_moving([0.002, 0.0, 0.1])), R, t, KNOWN).any()


def test_a_little_slip_is_allowed_and_much_is_not():
    path = _moving([0.4, 0.0, 0.1])
    slip = np.linspace(0, 1, T)[:, None] * np.array([0.0, 0.0, 1.0])
    tracks = _tracks(path + 0.02 * slip, path + 0.08 * slip)
    assert following(tracks, R, t, KNOWN).tolist() == [True, False]


def test_only_frames_with_a_known_motion_count():
    path = _moving([0.4, 0.0, 0.1])
    path[8:] += 1.0
    known = np.arange(T) < 8
    assert following(_tracks(path), R, t, known).tolist() == [True]
    assert not following(_tracks(path), R, t, KNOWN).any()


def test_a_track_seen_too_seldom_or_never_says_nothing():
    seldom, never = _moving([0.4, 0.0, 0.1]), np.full((T, 3), np.nan)
    seldom[4:] = np.nan
    assert not following(_tracks(seldom, never), R, t, KNOWN).any()
