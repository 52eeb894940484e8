"""Errors that stay with a point: no number of frames averages them, and regions say so."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.lasting_modes import lasting_tracks, observations_of
from akm_fg.records import LastingErrors, PointTracks
from experiments.trials.openings import Opening, make_opening, score_opening

SLIP_M = 0.006  # standard deviation at the end of the way
RELIEF_M = 0.008  # standard deviation
DEPTH_M = 0.0005  # of the depth in every frame: it hides from the residuals what lasts
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
    cov = cov + way[..., :, None] * way[..., None, :]
    lasting = LastingErrors(way, np.zeros_like(p))
    return replace(truth, tracks=PointTracks(p, cov, lasting))


def _tracks(slip: np.ndarray, relief: np.ndarray, sd_m: float) -> PointTracks:
    """Of points (T, N) that stay where they are, with errors of `sd_m` anew in every frame."""
    cov = sd_m**2 * np.eye(3) + slip[..., :, None] * slip[..., None, :]
    return PointTracks(np.zeros(slip.shape), cov, LastingErrors(slip, relief))


def test_a_slip_is_taken_for_one_that_lasts_where_it_matters() -> None:
    """By hand: 1 mm each time; 2 mm at the end lasts, a tenth of a millimetre does not matter."""
    slip = np.zeros((5, 2, 3))
    slip[:, 0, 0], slip[:, 1, 0] = np.linspace(0, 2e-3, 5), np.linspace(0, 1e-4, 5)
    tracks, still = _tracks(slip, np.zeros_like(slip), 1e-3), np.tile(np.eye(3), (5, 1, 1))
    which = lasting_tracks(tracks, still)
    assert which.tolist() == [0]
    taken = observations_of(tracks, which)
    assert taken.lasting is not None
    share = 8 / np.pi**2  # the rest is new in every frame
    assert_allclose(taken.lasting.vectors[0, :, :, 0], np.sqrt(share) * slip[:, 0])
    assert_allclose(taken.information_world[-1, 0, 0], 1 / (1e-6 + (1 - share) * 4e-6))
    assert_allclose(taken.information_world[-1, 0, 1], 1 / (1e-6 + 1e-8))
    alone = replace(tracks, lasting=None)
    assert not lasting_tracks(alone, still).size
    assert observations_of(alone, np.zeros(0, dtype=int)).lasting is None


def test_tracks_that_slip_the_same_way_may_do_so_together() -> None:
    """By hand: two slip along x, one along y, and one half and half."""
    slip = np.zeros((5, 4, 3))
    way = np.linspace(0, 5e-3, 5)
    slip[:, 0, 0] = slip[:, 1, 0] = slip[:, 2, 1] = slip[:, 3, 0] = slip[:, 3, 1] = way
    taken = observations_of(_tracks(slip, np.zeros_like(slip), 1e-3), np.arange(4))
    assert taken.lasting is not None
    assert_allclose(taken.lasting.sd[0] ** 2, [2.5, 2.5, 1.5, 2.5])
    assert_allclose(taken.lasting.sd[1], 1.0)


def test_what_lies_elsewhere_on_its_ray_matters_as_the_part_turns_and_not_as_it_slides() -> None:
    relief = np.tile([0.04, 0.0, 0.0], (2, 1, 1))
    tracks = _tracks(np.zeros((2, 1, 3)), relief, 1e-3)
    quarter = np.array([np.eye(3), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    assert lasting_tracks(tracks, quarter).tolist() == [0]
    assert not lasting_tracks(tracks, np.tile(np.eye(3), (2, 1, 1))).size


def test_frames_and_tracks_keep_what_lasts() -> None:
    tracks = _slipping(0).tracks
    some = tracks.at(np.array([3, 5])).select(np.array([4, 2]))
    assert tracks.lasting is not None and some.lasting is not None
    assert_allclose(some.lasting.slip_world, tracks.lasting.slip_world[[3, 5]][:, [4, 2]])
    assert_allclose(some.p_world, tracks.p_world[[3, 5]][:, [4, 2]])


def _beside(seed: int) -> Opening:
    """A door of which what is followed lies some centimetres before or behind each point."""
    truth = make_opening(
        [seed, 91], "revolute", travel=0.6, points=POINTS, noise_m=2e-4, claimed_m=2e-4
    )
    tracks, rng = truth.tracks, np.random.default_rng([seed, 93])
    ray = truth.T_world_panel.rotation().matrix()[:, 1]
    relief = np.tile(RELIEF_M * ray, (*tracks.p_world.shape[:2], 1))
    p = tracks.p_world + rng.normal(size=POINTS)[:, None] * relief
    lasting = LastingErrors(np.zeros_like(p), relief)
    return replace(truth, tracks=PointTracks(p, tracks.cov_world, lasting))


def _nees(made: Callable[[int], Opening], knowing: bool) -> float:
    """Squared errors of axis and line in deviations, a number: mean of eight doors."""
    each = []
    for seed in range(8):
        truth = made(seed)
        tracks = truth.tracks if knowing else replace(truth.tracks, lasting=None)
        each.append(score_opening(fit_tracks(tracks), truth).nees / 4)
    return float(np.mean(each))


def test_regions_of_a_door_whose_few_points_slip_hold_its_hinge_and_are_no_larger() -> None:
    """Taken for new in every frame a slip of known growth costs more than it does."""
    assert 0.3 < _nees(_slipping, knowing=True) < 1.6
    assert _nees(_slipping, knowing=False) < 0.2


def test_regions_of_a_door_whose_points_lie_elsewhere_hold_its_hinge() -> None:
    assert 0.3 < _nees(_beside, knowing=True) < 1.6
    assert _nees(_beside, knowing=False) > 10
