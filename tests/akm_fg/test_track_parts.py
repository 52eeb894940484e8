"""Tracks of several parts: what stands still, what moves, and another part that moves."""

import numpy as np
import pytest

from akm_fg.posterior_views import posterior_as_dict
from akm_fg.records import PointTracks
from akm_fg.track_parts import fit_parts
from experiments.trials.openings import make_opening

SIGMA_M = 0.001


def _still(count, frames, seed):
    rng = np.random.default_rng(seed)
    at = rng.uniform(-1, 1, (count, 3)) + np.array([0, 0, 3])
    return at + SIGMA_M * rng.normal(size=(frames, count, 3))


def _together(*points):
    p = np.concatenate(points, axis=1)
    cov = np.broadcast_to(SIGMA_M**2 * np.eye(3), (*p.shape, 3)).copy()
    return PointTracks(p, cov)


def _opening(seed, kind, points):
    travel = 0.9 if kind == "revolute" else 0.25
    return make_opening(
        seed, kind, travel, points=points, frames=20, noise_m=SIGMA_M, claimed_m=SIGMA_M
    )


@pytest.mark.parametrize("noise_known", [True, False])
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_the_part_that_moves_is_asked_for_though_most_tracks_stand_still(kind, noise_known):
    truth = _opening(3, kind, 30)
    tracks = _together(_still(70, 20, 1), truth.tracks.p_world)
    posterior = fit_parts(tracks, noise_known=noise_known)
    assert posterior.kind == kind
    assert abs(posterior.best.joint.axis @ truth.axis) > np.cos(np.radians(1.0))
    assert any("stand still and were left out" in text for text in posterior.fit.warnings)
    assert posterior.fit.tracks_rejected >= 65


def test_two_parts_that_move_are_said_with_both():
    door, drawer = _opening(4, "revolute", 40), _opening(5, "prismatic", 25)
    tracks = _together(door.tracks.p_world, drawer.tracks.p_world)
    posterior = fit_parts(tracks)
    assert posterior.kind == "revolute"
    (other,) = posterior.other_parts
    assert other.kind == "prismatic"
    assert abs(other.best.joint.axis @ drawer.axis) > np.cos(np.radians(1.0))
    assert any("more than one part moves" in text for text in posterior.fit.warnings)
    (said,) = posterior_as_dict(posterior)["other_parts"]
    assert said["kind"] == "prismatic" and len(said["states"]["mean"]) == 20


def test_tracks_of_one_part_with_strays_are_one_part():
    truth = make_opening(6, "revolute", 0.6, points=40, frames=20, wild_share=0.2)
    posterior = fit_parts(truth.tracks)
    assert posterior.kind == "revolute"
    assert posterior.other_parts == ()
    assert posterior.fit.tracks_used >= 28


@pytest.mark.parametrize("noise_known", [True, False])
def test_a_track_that_stands_twelve_times_in_the_file_is_one(noise_known):
    door = _opening(4, "revolute", 1).tracks
    posterior = fit_parts(door.select(np.zeros(12, dtype=int)), noise_known=noise_known)
    alone = fit_parts(door, noise_known=noise_known)
    assert posterior.kind_probability == alone.kind_probability
    assert posterior.fit.tracks_used == 1 and posterior.fit.tracks_rejected == 11
    assert posterior.fit.warnings[0] == "11 of 12 tracks are copies of others and were left out"


def test_tracks_that_all_stand_still_do_not_move():
    assert fit_parts(_together(_still(40, 20, 2))).kind == "rigid"
