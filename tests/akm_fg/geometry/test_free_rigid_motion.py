"""Free rigid motion: motion, noise and membership before any joint is assumed."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.geometry.rigid_motion import free_rigid_motion, procrustes
from experiments.trials.openings import make_opening


def _motion(tracks, seed=0):
    return free_rigid_motion(tracks, np.random.default_rng(seed))


def _predicted(motion):
    return np.einsum("tij,nj->tni", motion.R_world, motion.shape_world) + motion.t_world[:, None]


def test_noise_free_tracks_are_reproduced_exactly(kind, opening):
    truth = opening(0, kind, noise_m=0.0)
    motion = _motion(truth.tracks)
    assert motion.inlier.all() and motion.known.all()
    assert_allclose(_predicted(motion), truth.tracks.p_world, atol=1e-9)


def test_rotations_are_proper(opening):
    R = _motion(opening(1, "revolute").tracks).R_world
    assert_allclose(R @ R.swapaxes(1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    assert_allclose(np.linalg.det(R), 1.0)


def test_door_turned_by_a_quarter_is_seen_to_turn_by_a_quarter(opening):
    truth = opening(2, "revolute", travel=np.pi / 2, frames=2, noise_m=0.0, steady=True)
    R = _motion(truth.tracks).R_world
    between = R[1] @ R[0].T
    assert_allclose(between @ truth.axis, truth.axis, atol=1e-9)
    assert_allclose(np.trace(between), 1.0, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_drifting_tracks_are_rejected_and_the_others_kept(kind, seed, opening):
    truth = opening(seed, kind, wild_share=0.2)
    inlier = _motion(truth.tracks).inlier
    assert not inlier[truth.wild].any()
    assert inlier[~truth.wild].mean() > 0.95


def test_few_noisy_tracks_are_all_kept():
    """Two frames alone suspect one of ten sound tracks in every second run."""
    for seed in range(20):
        truth = make_opening(seed, points=10, noise_m=0.01, claimed_m=0.01)
        assert _motion(truth.tracks).inlier.all()


def test_four_tracks_in_ten_drifting_are_still_told_apart(opening):
    truth = opening(3, "prismatic", wild_share=0.4)
    inlier = _motion(truth.tracks).inlier
    assert not inlier[truth.wild].any() and inlier[~truth.wild].mean() > 0.95


@pytest.mark.parametrize("times", [0.5, 1.0, 3.0])
def test_noise_scale_is_that_of_the_noise(times, opening):
    """In units of the given covariances, which say 3 mm."""
    truth = opening(4, "revolute", noise_m=0.003 * times)
    assert_allclose(_motion(truth.tracks).scale, times, rtol=0.1)


def test_noise_scale_is_not_raised_by_drifting_tracks(opening):
    assert_allclose(_motion(opening(5, "revolute", wild_share=0.2).tracks).scale, 1.0, rtol=0.15)


def test_a_frame_with_too_few_points_is_unknown(opening):
    truth = opening(6, "revolute")
    truth.tracks.p_world[5, 2:] = np.nan
    motion = _motion(truth.tracks)
    assert not motion.known[5]
    assert np.delete(motion.known, 5).all()


def test_points_seen_only_late_take_part(opening):
    truth = opening(7, "revolute", noise_m=0.0)
    truth.tracks.p_world[:6, :15] = np.nan
    motion = _motion(truth.tracks)
    assert motion.inlier.all()
    seen = truth.tracks.observed
    assert_allclose(_predicted(motion)[seen], truth.tracks.p_world[seen], atol=1e-9)


def test_procrustes_finds_a_known_rotation_and_ignores_points_without_weight():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(6, 3))
    R_true = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    b = a @ R_true.T + [1.0, 2.0, 3.0]
    b[5] += 10
    R, t = procrustes(a, b, np.array([1.0, 2, 1, 1, 1, 0]))
    assert_allclose(R, R_true, atol=1e-12)
    assert_allclose(t, [1.0, 2.0, 3.0], atol=1e-12)


def test_procrustes_of_mirrored_points_is_still_a_rotation():
    a = np.random.default_rng(0).normal(size=(6, 3))
    R, _ = procrustes(a, a * [1, 1, -1], np.ones(6))
    assert_allclose(np.linalg.det(R), 1.0)


def test_procrustes_does_not_turn_a_shifted_line_about_itself():
    a = np.array([0.3, -0.2, 1.0]) + np.linspace(-0.1, 0.1, 6)[:, None] * np.array([0.1, 0.9, 0.2])
    for shift in np.random.default_rng(0).normal(size=(20, 3)):
        R, t = procrustes(a, a + shift, np.ones(6))
        assert_allclose(R, np.eye(3), atol=1e-6)
        assert_allclose(t, shift, atol=1e-6)


@pytest.mark.parametrize(("points", "frames"), [(10, 20), (40, 5)])
def test_the_noise_of_few_tracks_in_few_frames_is_not_underestimated(points, frames):
    """Motions and shape take up 6 T + 3 N of the 3 N T numbers: a quarter, 13 % of the scale."""
    found = [
        _motion(make_opening(seed, points=points, frames=frames, noise_m=0.003).tracks).scale
        for seed in range(40)
    ]
    assert_allclose(np.median(found), 1.0, atol=0.1)
