"""Surfaces in the graph: which keyframes, how many readings count, what registration gains."""

import json
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.errors import TracksLost
from akm_fg.estimation.between_kinds.starts import starts_of_part
from akm_fg.estimation.config import FitConfig, SurfaceConfig
from akm_fg.estimation.fit import fit_surface, fit_tracks
from akm_fg.estimation.given.problem import problem_of_surface, problem_of_tracks
from akm_fg.estimation.given.surface_registration import (
    SurfaceToRegister,
    readings_as_one,
    register,
    spread_by_state,
)
from akm_fg.estimation.sources.source import FirstFit
from akm_fg.estimation.sources.surface import SURFACE
from akm_fg.estimation.sources.tracks import TRACKS
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.io.posteriors.posterior_json import posterior_as_line
from akm_fg.records import PointTracks
from akm_fg.steps import to_end
from factors.joint import Joint
from factors.measurements.dense_registration import DenseCost, PatchObservations

# Readings in these tests are as independent as they claim.
EXACT = replace(
    FitConfig(),
    surface_systematic_m=0.0,
    surface=replace(SurfaceConfig(), keyframes=5, keyframes_alone=10),
)


def _guess(truth, size=0.0, seed=5):
    """The true joint moved by `size` radians and metres."""
    rng = np.random.default_rng(seed)
    T = gtsam.Pose3(truth.T_world_joint).compose(gtsam.Pose3.Expmap(rng.normal(0, size, 6)))
    q = truth.q + np.r_[0.0, rng.normal(0, size, truth.q.size - 1)]
    return JointGuess(Joint(truth.kind, T.matrix(), 0.0), q)


def _none(frames):
    return PointTracks(np.zeros((frames, 0, 3)), np.zeros((frames, 0, 3, 3)))


def _fit(truth, surface, size=0.01, config=EXACT):
    centroid = truth.rest_world.mean(axis=0)
    return fit_surface(surface, _guess(truth, size), centroid, _none(truth.q.size), config=config)


def _off_m(guess, truth, frames):
    """(K, 3, N) how far a joint takes the panel's points from where they are."""
    R, t = guess.joint.motion(guess.q)
    R0, t0 = truth.joint.motion(truth.q[frames])
    p = truth.rest_world.T
    return R @ p + t[:, :, None] - (R0 @ p + t0[:, :, None])


def test_keyframes_are_the_first_and_those_farthest_apart_in_state():
    q = np.array([0.0, 0.1, 0.52, 0.3, 1.0, 0.9])
    assert spread_by_state(q, 3).tolist() == [0, 2, 4]
    assert spread_by_state(q, 4).tolist() == [0, 2, 3, 4]
    assert spread_by_state(q, 1).tolist() == [0]


def test_all_frames_are_keyframes_where_they_are_few_and_none_twice():
    assert spread_by_state(np.array([0.2, 0.5, 0.3]), 9).tolist() == [0, 1, 2]
    assert spread_by_state(np.array([0.0, 0.4, 0.4, 0.0]), 4).tolist() == [0, 1]
    assert spread_by_state(np.zeros(5), 3).tolist() == [0]


def _readings(e, uv, seen=None):
    """readings_as_one of errors (K, S) in units of their deviation at pixels uv (S, 2)."""
    K, S = e.shape
    seen = np.ones((K, S), dtype=bool) if seen is None else seen
    patches = PatchObservations(np.zeros((K, 3, S)), seen.astype(float), np.ones((3, S)))
    e = np.where(seen, e, 0.0)
    cost = DenseCost(0.0, e, e**2, seen.astype(float), np.zeros((3, S)), 0.0)
    return readings_as_one(cost, patches, np.tile(uv, (K, 1, 1)))


GRID = np.stack(np.meshgrid(np.arange(0, 256, 2.0), np.arange(0, 256, 2.0)), -1).reshape(-1, 2)


def test_white_readings_count_each_for_itself():
    """The largest of four variance ratios; the coarsest has 32 x 5 blocks: sd 0.11."""
    for seed in range(3):
        e = np.random.default_rng(seed).normal(size=(5, len(GRID)))
        assert 1.0 <= _readings(e, GRID) < 1.35


@pytest.mark.parametrize("side_px", [8, 16])
def test_readings_alike_over_a_block_count_as_one_a_block(side_px):
    """Of a block 8 pixels wide every second pixel is read: 16 readings; of 16 pixels 64."""
    block = np.floor(GRID / side_px) @ [1, 1000]
    _, index = np.unique(block, return_inverse=True)
    got = []
    for seed in range(5):
        e = np.random.default_rng(seed).normal(size=(5, index.max() + 1))[:, index]
        got.append(_readings(e, GRID))
    want = (side_px / 2) ** 2
    assert_allclose(np.mean(got), want, rtol=0.25)
    assert_allclose(got, want, rtol=0.5)


def test_one_wild_reading_does_not_make_its_neighbours_alike():
    e = np.random.default_rng(0).normal(size=(5, len(GRID)))
    before = _readings(e, GRID)
    e[2, 700] = 300.0
    assert_allclose(_readings(e, GRID), before, rtol=0.05)


def test_wild_readings_do_not_hide_that_others_err_together():
    rng = np.random.default_rng(2)
    _, index = np.unique(np.floor(GRID / 8) @ [1, 1000], return_inverse=True)
    e = rng.normal(size=(5, index.max() + 1))[:, index]
    e[:, rng.choice(len(GRID), 100, replace=False)] = 50.0 * rng.normal(size=(5, 100))
    assert 11 < _readings(e, GRID) < 20


def test_readings_alike_over_small_blocks_count_as_one_where_the_fit_took_up_their_long_waves():
    """Nothing is left of their sums over 64 pixels."""
    _, index = np.unique(np.floor(GRID / 8) @ [1, 1000], return_inverse=True)
    _, large = np.unique(np.floor(GRID / 64) @ [1, 1000], return_inverse=True)
    e = np.random.default_rng(3).normal(size=(5, index.max() + 1))[:, index]
    for row in e:
        row -= (np.bincount(large, row) / np.bincount(large))[large]
    assert 12 < _readings(e, GRID) < 18


def test_readings_that_are_not_seen_do_not_count():
    rng = np.random.default_rng(1)
    e, seen = rng.normal(size=(5, len(GRID))), rng.random((5, len(GRID))) < 0.5
    before = _readings(e, GRID, seen)
    assert _readings(np.where(seen, e, 50.0), GRID, seen) == before


def _registered(problem, guess, surface, as_one=1.0):
    """The problem with the surface, and the joint that it leads to; None where it does not."""
    known = {TRACKS: problem.tracks.first_scale, SURFACE: 1.0}
    first = FirstFit(guess, np.zeros(guess.q.size), known, as_one)
    found = to_end(register(problem, first, surface, problem.config.surface.keyframes_alone))
    return None if found is None else (found[0], found[1].guess)


def test_where_the_surface_leads_a_few_tracks_cost_no_keyframes(opening, surface_of):
    """A plain door's edges: four of them take nothing from the ten frames that it is read in."""
    truth = opening(4, "revolute", points=4)
    surface, guess = surface_of(truth), _guess(truth, 0.002)
    centroid = truth.rest_world.mean(axis=0)
    led = fit_surface(surface, guess, centroid, truth.tracks, config=EXACT)
    assert led.fit.tracks_used == 4
    assert len(led.fit.keyframes_registered) == 10


@pytest.fixture(scope="module", params=["revolute", "prismatic"])
def perturbed(request, opening, surface_of):
    """An opening, its surface, and registrations of it from a joint a degree and more off."""
    truth = opening(4, request.param)
    surface = surface_of(truth)
    centroid = truth.rest_world.mean(axis=0)
    guess = _guess(truth, 0.012)
    problem = problem_of_surface("test", _none(truth.q.size), guess, centroid, EXACT)
    start = JointGuess(guess.joint, problem.guesses[0].q)
    return truth, start, _registered(problem, start, surface)


def test_registration_brings_a_joint_a_centimetre_off_to_the_surface(perturbed):
    truth, start, (problem, found) = perturbed
    frames = problem.keyframes
    before = np.abs(_off_m(start, truth, np.arange(20))).max()
    after = np.abs(_off_m(found, truth, frames)).max()
    assert before > 0.009
    assert after < 1e-3  # millimetre readings, six hundred of them


def test_registration_keeps_its_frames_readings_and_noise_level(perturbed):
    truth, _, (problem, found) = perturbed
    surface = problem.sources[1]
    assert problem.keyframes.size == 10 and problem.keyframes[0] == 0
    assert (np.diff(problem.keyframes) > 0).all()
    assert surface.frames.tolist() == list(range(10))
    assert found.q[0] == 0.0 and found.q.size == 10
    assert 1.0 <= surface.count_as_one < 2.0  # white noise
    assert_allclose(surface.first_scale, 0.92, atol=0.08)  # Student-t over normal, see config
    assert surface.patches.seen.mean() > 0.9  # edges seen at a grazing angle are not
    centroid = problem.centroid_world - truth.rest_world.mean(axis=0)
    assert np.abs(centroid).max() < 0.05  # of what is drawn on a panel of 0.4 m


def test_more_readings_alike_count_less(opening, surface_of):
    truth = opening(4, "revolute")
    guess = _guess(truth, 0.002)
    problem = problem_of_surface("test", _none(20), guess, truth.rest_world.mean(axis=0), EXACT)
    start = JointGuess(guess.joint, problem.guesses[0].q)
    blocks = surface_of(truth, patches=1500, block_px=24)
    together = _registered(problem, start, blocks)[0].sources[1].count_as_one
    assert together > 4.0
    half, _ = _registered(problem, start, blocks, as_one=2.0)
    assert_allclose(half.sources[1].count_as_one, together / 2, rtol=0.1)


def test_a_surface_seen_in_one_keyframe_or_in_too_few_places_is_no_registration(
    opening, surface_of
):
    truth = opening(4, "revolute")
    problem = problem_of_tracks("test", truth.tracks, True, 0, EXACT)
    start = next(s for s in starts_of_part(problem, problem.motions) if s.guess.kind == "revolute")
    for surface in (
        surface_of(truth, hidden=range(1, 20)),
        surface_of(truth, hidden=range(20)),
        surface_of(truth, patches=EXACT.surface.min_patches - 1),
    ):
        assert _registered(problem, start.guess, surface) is None
        same = fit_tracks(truth.tracks, sources=[SurfaceToRegister(surface)], config=EXACT)
        assert same.fit.keyframes_registered == () and same.fit.patches_used == 0
        assert same.fit.patches_rms_m is None and same.fit.patches_as_one is None


def test_a_surface_alone_that_is_not_seen_again_is_lost(opening, surface_of):
    truth = opening(4, "revolute")
    for surface in (
        surface_of(truth, hidden=range(1, 20)),
        surface_of(truth, patches=EXACT.surface.min_patches - 1),
    ):
        with pytest.raises(TracksLost, match="seen again in two keyframes; expected at least 50"):
            _fit(truth, surface)


def test_the_surface_alone_gives_kind_joint_and_states_of_what_it_sees(
    kind, opening, surface_of, score
):
    truth = opening(6, kind)
    posterior = _fit(truth, surface_of(truth, hidden=(7,)))
    assert posterior.kind == kind
    error = score(posterior, truth)
    assert np.degrees(error.axis_error_rad) < 0.2
    assert error.pivot_error_m < 0.002
    keyframes = np.array(posterior.fit.keyframes_registered)
    assert 2 < keyframes.size <= 10 and 7 not in keyframes
    states = posterior.best.states
    seen = np.isin(np.arange(20), keyframes)
    assert np.isfinite(states.mean[seen]).all() and np.isfinite(states.sd[seen]).all()
    assert np.isnan(states.mean[~seen]).all() and np.isnan(states.sd[~seen]).all()
    late = seen & (np.arange(20) > 0)
    assert np.abs(error.state_error[late] / states.sd[late]).max() < 4
    assert posterior.fit.tracks_used == 0 and posterior.fit.patches_used > 500
    assert_allclose(posterior.fit.patches_rms_m, 0.001, rtol=0.15)


def test_states_of_unseen_frames_are_null_in_the_json(opening, surface_of):
    truth = opening(6, "revolute")
    posterior = _fit(truth, surface_of(truth))
    fields = json.loads(posterior_as_line(posterior))
    seen = fields["fit"]["keyframes_registered"]
    assert len(seen) == 10
    for key in ("mean", "sd"):
        values = fields["states"][key]
        assert [k for k, v in enumerate(values) if v is not None] == seen
    assert fields["fit"]["patches_used"] == posterior.fit.patches_used


def test_surface_and_tracks_together_are_surer_than_tracks_alone(kind, opening, surface_of, score):
    truth = opening(7, kind)
    alone = fit_tracks(truth.tracks, config=EXACT)
    both = fit_tracks(truth.tracks, sources=[SurfaceToRegister(surface_of(truth))], config=EXACT)
    assert both.kind == alone.kind == kind
    assert len(both.fit.keyframes_registered) == EXACT.surface.keyframes
    assert both.best.joint.axis_sd_rad < 0.7 * alone.best.joint.axis_sd_rad
    assert score(both, truth).axis_error_rad < 4 * both.best.joint.axis_sd_rad
    assert np.isfinite(both.best.states.mean).all()
    assert both.fit.tracks_used == alone.fit.tracks_used


@pytest.mark.slow
@pytest.mark.parametrize("block_px", [0, 24])
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_over_sixty_surfaces_the_joint_is_as_far_off_as_it_says(
    kind, block_px, opening, surface_of, score
):
    scores, kinds = [], []
    for seed in range(60):
        truth = opening(seed, kind)
        posterior = _fit(truth, surface_of(truth, seed, block_px=block_px))
        scores.append(score(posterior, truth))
        kinds.append(posterior.kind == kind)
    dof = sum(s.dimensions for s in scores)
    nees = sum(s.nees for s in scores)
    low, high = stats.chi2.interval(0.99, dof)
    if block_px:  # how much errs together is estimated
        low *= 0.5
        high *= 1.3
    assert low <= nees <= high, nees / dof
    assert np.mean(kinds) > 0.95


def test_readings_weigh_more_beside_tracks_that_count_less(opening, surface_of):
    """Four tracks counting as one: a reading weighs four times as much beside them."""
    truth = opening(0, "revolute")
    problem = problem_of_surface(
        "x", truth.tracks, _guess(truth), truth.rest_world.mean(axis=0), EXACT
    )
    registered, _ = _registered(problem, _guess(truth), surface_of(truth))
    surface, counted = registered.sources[1], registered.counting(4.0).sources[1]
    assert_allclose(counted.count_as_one, surface.count_as_one / 4)
    assert counted.patches is surface.patches


def test_systematic_errors_of_depth_are_not_averaged_away(opening, surface_of):
    """n readings of variance s^2 average to s^2 / n, systematic b^2 in four ways to b^2 / 4.

    So b = 1 mm beside 400 patches in 10 keyframes, each of 0.1 mm, makes the drawer's variances
    larger by n b^2 / (4 s^2): for s a Student-t scale, 0.92 of the noise's, 118,000 times.
    """
    truth = opening(4, "prismatic")
    surface = surface_of(truth, patches=400, sigma_m=1e-4)
    exact, systematic = (
        _fit(truth, surface, config=replace(EXACT, surface_systematic_m=b, systematic_modes=4))
        for b in (0.0, 1e-3)
    )
    n, s_m = exact.fit.patches_used * 10, 0.92e-4
    wider = (systematic.best.joint.axis_sd_rad / exact.best.joint.axis_sd_rad) ** 2
    assert_allclose(wider, n * 1e-3**2 / (4 * s_m**2), rtol=0.2)
