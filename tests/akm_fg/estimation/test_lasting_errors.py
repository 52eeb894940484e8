"""Errors that stay with a point: no number of frames averages them, and regions say so."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.sources.lasting_errors import cov_as_independent, hidden_share
from akm_fg.records import LastingErrors, PointTracks
from experiments.trials.openings import Opening, make_opening, score_opening

SLIP_M = 0.006  # standard deviation at the end of the way
DEPTH_M = 0.002  # of the depth in every frame: it hides from the residuals what lasts
POINTS = 5  # too few to tell how they err together


def _slipping(seed: int) -> Opening:
    """A door of which every point slides along an edge of its own, the farther it has turned."""
    truth = make_opening(
        [seed, 91], "revolute", travel=0.6, points=POINTS, noise_m=2e-4, claimed_m=2e-4
    )
    rng = np.random.default_rng([seed, 92])
    R_world_panel = truth.T_world_panel.rotation().matrix()
    edges, ray = np.array([truth.axis, R_world_panel[:, 0]]), R_world_panel[:, 1]
    along = edges[rng.integers(0, 2, POINTS)]  # at rest: up, or across the door
    grown = np.argsort(np.argsort(truth.q)) / (truth.q.size - 1)
    R, _ = truth.joint.motion(truth.q)
    way = SLIP_M * grown[:, None, None] * np.einsum("tij,nj->tni", R, along)
    tracks = truth.tracks
    p = tracks.p_world + rng.normal(size=POINTS)[:, None] * way
    p += DEPTH_M * rng.normal(size=p.shape[:2])[..., None] * ray
    cov = tracks.cov_world + DEPTH_M**2 * np.outer(ray, ray)
    lasting = LastingErrors(way[..., :, None] * way[..., None, :], np.zeros_like(p))
    return replace(truth, tracks=PointTracks(p, cov, lasting))


def test_a_slip_counts_once_however_often_a_point_is_seen() -> None:
    """By hand: seen three times a point's is threefold, of one that is seen once it is itself."""
    p = np.zeros((3, 2, 3))
    p[1:, 1] = np.nan
    cov, slip = np.tile(2.0 * np.eye(3), (3, 2, 1, 1)), np.tile(np.eye(3), (3, 2, 1, 1))
    tracks, R = (
        PointTracks(p, cov, LastingErrors(slip, np.zeros((3, 2, 3)))),
        np.tile(np.eye(3), (3, 1, 1)),
    )
    counted = cov_as_independent(tracks, R)
    assert_allclose(counted[:, 0], np.tile(4.0 * np.eye(3), (3, 1, 1)))
    assert_allclose(counted[0, 1], 2.0 * np.eye(3))
    assert_allclose(hidden_share(tracks, counted), 3 * 0.5 / 4)
    alone = replace(tracks, lasting=None)
    assert cov_as_independent(alone, R) is cov
    assert hidden_share(alone, cov) == 0.0


def test_what_lies_elsewhere_on_its_ray_is_off_as_the_part_turns_and_not_as_it_slides() -> None:
    """By hand: 4 cm along a ray that the part sees turn by a quarter is off by 2 cm each way."""
    cov = np.tile(1e-6 * np.eye(3), (2, 1, 1, 1))
    relief = np.tile([0.04, 0.0, 0.0], (2, 1, 1))
    tracks = PointTracks(np.zeros((2, 1, 3)), cov, LastingErrors(np.zeros((2, 1, 3, 3)), relief))
    still = np.tile(np.eye(3), (2, 1, 1))
    assert_allclose(cov_as_independent(tracks, still), cov)
    quarter = np.array([np.eye(3), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    added = (cov_as_independent(tracks, quarter) - cov)[:, 0]
    # As the part sees it the ray is (1, 0, 0), then (0, -1, 0): off by (1, 1, 0) / 2 to and fro.
    off = 0.02 * np.array([1.0, 1.0, 0.0])
    assert_allclose(added[0], 2 * np.outer(off, off), atol=1e-15)
    assert_allclose(added[1], 2 * np.outer(quarter[1] @ off, quarter[1] @ off), atol=1e-15)


def test_frames_and_tracks_keep_what_lasts() -> None:
    tracks = _slipping(0).tracks
    some = tracks.at(np.array([3, 5])).select(np.array([4, 2]))
    assert tracks.lasting is not None and some.lasting is not None
    assert_allclose(some.lasting.slip_world, tracks.lasting.slip_world[[3, 5]][:, [4, 2]])
    assert_allclose(some.p_world, tracks.p_world[[3, 5]][:, [4, 2]])


def test_regions_of_a_door_whose_few_points_slip_hold_its_hinge() -> None:
    """Blind to what lasts the squared errors are 2.6 times what the regions say."""
    honest, blind = [], []
    for seed in range(8):
        truth = _slipping(seed)
        tracks = replace(truth.tracks, lasting=None)
        honest.append(score_opening(fit_tracks(truth.tracks), truth).nees / 4)
        blind.append(score_opening(fit_tracks(tracks), truth).nees / 4)
    assert 0.1 < np.mean(honest) < 1.2
    assert np.mean(blind) > 1.8
