"""Frames one at a time: the same answer as all at once, whatever comes and goes."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.errors import InsufficientData, TracksLost
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.stream.incremental import IncrementalConfig, IncrementalFit
from akm_fg.estimation.stream.kind_comparison import Snapshot, StreamSettings, compare_kinds
from akm_fg.geometry.rigid_motion import RigidMotionConfig
from akm_fg.records import PointTracks

SIGMA_M = 0.003
FEW = IncrementalConfig(max_keyframes=12)
# No kernel, and no track rejected on either side.
GAUSSIAN = replace(
    FitConfig(), dof=1e6, max_frames=60, rigid_motion=RigidMotionConfig(inlier_sigmas=100.0)
)


def _fed(tracks, config=None, frames=slice(None), fit_config=None):
    """A fit that was given these frames, and what it said after each."""
    fit = IncrementalFit(config=config, fit=fit_config)
    pairs = zip(tracks.p_world[frames], tracks.cov_world[frames], strict=True)
    return fit, [fit.add(p, cov) for p, cov in pairs]


def _joined(*parts):
    """Clips of the same tracks, one after the other."""
    return PointTracks(
        np.concatenate([part.p_world for part in parts]),
        np.concatenate([part.cov_world for part in parts]),
    )


def _of_keyframes(truth, fit):
    """The truth, with the states of the keyframes alone."""
    return replace(truth, q=truth.q[list(fit.keyframes)])


def _apart_in_sd(a, b):
    """Largest difference of two joints' axes and pivots, in standard deviations of b."""
    T = np.linalg.inv(b.T_world_joint) @ a.T_world_joint
    crossing = T[:3, 3] - T[:3, 2] * T[2, 3] / T[2, 2]
    xi = np.array([-T[1, 2], T[0, 2], *crossing[:2]])
    sd = np.sqrt(np.diag(b.cov))[[0, 1, 3, 4]]
    return np.max(np.abs(xi[sd > 0] / sd[sd > 0]))


@pytest.fixture(scope="module", params=["revolute", "prismatic"])
def stream(request, opening):
    """Seventy frames in random order of state, twelve keyframes."""
    truth = opening(11, request.param, frames=70)
    return (truth, *_fed(truth.tracks, FEW))


def test_frames_that_are_all_keyframes_give_what_fit_tracks_gives(kind, opening):
    truth = opening(4, kind, frames=15, noise_m=3e-4, claimed_m=3e-4)
    config = replace(FitConfig(), rigid_motion=RigidMotionConfig(inlier_sigmas=100.0))
    fit, _ = _fed(truth.tracks, fit_config=config)
    assert fit.keyframes == tuple(range(15))
    # The last keyframe may have been comparing's turn: it is solved for a frame later.
    joint = fit.add(np.full_like(truth.tracks.p_world[0], np.nan), truth.tracks.cov_world[0]).joint
    got, want = fit.posterior(), fit_tracks(truth.tracks, "stream", config=config)
    assert got.kind == want.kind == kind
    for name, alternative in want.alternatives.items():
        assert_allclose(got.alternatives[name].log_evidence, alternative.log_evidence, rtol=1e-9)
    assert_allclose(got.best.joint.T_world_joint, want.best.joint.T_world_joint, atol=1e-9)
    assert_allclose(got.best.joint.cov, want.best.joint.cov, rtol=1e-6)
    assert_allclose(got.best.states.mean, want.best.states.mean, atol=1e-9)
    assert_allclose(got.best.states.sd, want.best.states.sd, rtol=1e-6)
    # The graph that was solved on, keyframe by keyframe, has arrived in the same place.
    assert _apart_in_sd(joint, want.best.joint) < 0.1
    assert_allclose(joint.axis_sd_rad, want.best.joint.axis_sd_rad, rtol=0.1)


def test_pooled_frames_give_what_fit_tracks_gives_on_the_averages(stream):
    _, fit, _ = stream
    got, want = fit.posterior(), fit_tracks(fit.keyframe_tracks)
    assert len(fit.keyframes) == FEW.max_keyframes
    assert_allclose(got.best.joint.T_world_joint, want.best.joint.T_world_joint, atol=1e-9)
    assert_allclose(got.kind_probability["revolute"], want.kind_probability["revolute"])


def test_averaging_fifty_frames_into_twelve_loses_next_to_nothing(kind, opening):
    """A batch fit of twelve of them would be twice as vague."""
    truth = opening(11, kind, frames=50)
    fit, updates = _fed(truth.tracks, IncrementalConfig(max_keyframes=12), fit_config=GAUSSIAN)
    got, want = fit.posterior().best.joint, fit_tracks(truth.tracks, config=GAUSSIAN).best.joint
    assert _apart_in_sd(got, want) < 0.25
    # While kinds are compared, pooled frames wait: up to eight of the fifty.
    assert _apart_in_sd(updates[-1].joint, want) < 1.0
    assert_allclose(got.axis_sd_rad, want.axis_sd_rad, rtol=0.06)


def test_frames_are_moved_along_the_joint_before_they_are_averaged(opening):
    """Eight keyframes on a way of ninety degrees: what becomes one was centimetres apart."""
    truth = opening(12, "revolute", travel=np.pi / 2, frames=50)
    fit, _ = _fed(truth.tracks, IncrementalConfig(max_keyframes=8), fit_config=GAUSSIAN)
    got, want = fit.posterior().best.joint, fit_tracks(truth.tracks, config=GAUSSIAN).best.joint
    assert _apart_in_sd(got, want) < 0.4
    assert_allclose(got.axis_sd_rad, want.axis_sd_rad, rtol=0.06)


def test_twelve_keyframes_tell_what_seventy_frames_tell_robustly(stream):
    """A mean and a Student-t estimate of the same frames differ, but as estimates may."""
    truth, fit, _ = stream
    all_frames = fit_tracks(truth.tracks, config=replace(FitConfig(), max_frames=70))
    got, want = fit.posterior().best.joint, all_frames.best.joint
    assert all_frames.kind == fit.posterior().kind == truth.kind
    assert _apart_in_sd(got, want) < 1.0
    assert_allclose(got.axis_sd_rad, want.axis_sd_rad, rtol=0.15)


def test_every_state_is_told_at_once_and_within_its_deviation(stream):
    truth, _, updates = stream
    z = [(u.state - truth.q[u.number]) / u.state_sd for u in updates if u.state is not None]
    assert len(z) > 55
    assert np.max(np.abs(z)) < 4.5
    # They share the noise of the first frame: half of the variance.
    assert 0.3 < np.mean(np.square(z)) < 3.0
    batch = fit_tracks(truth.tracks).best.states.sd
    late = [u for u in updates[40:] if not u.is_keyframe]
    assert_allclose([u.state_sd for u in late], batch[[u.number for u in late]], rtol=0.2)


def test_states_of_pooled_keyframes_are_as_uncertain_as_one_frame(stream):
    truth, fit, _ = stream
    posterior, batch = fit.posterior(), fit_tracks(truth.tracks)
    got = posterior.best.states.sd[1:]
    assert_allclose(np.median(got), np.median(batch.best.states.sd[1:]), rtol=0.15)
    z = (posterior.best.states.mean - truth.q[list(fit.keyframes)])[1:] / got
    assert np.max(np.abs(z)) < 4


def test_kind_is_named_soon_and_stays(stream):
    truth, _, updates = stream
    assert updates[0].kind == "undecided"
    assert {u.kind for u in updates[30:]} == {truth.kind}
    assert all(u.warning is None for u in updates[30:])


def test_frames_after_a_pause_refine_the_joint(kind, opening, score):
    """Sixty frames more of the same range: sd by the square root of the numbers."""
    truth = opening(21, kind, frames=80)
    fit, _ = _fed(truth.tracks, frames=slice(0, 20))
    before = fit.posterior().best.joint
    for p, cov in zip(truth.tracks.p_world[20:], truth.tracks.cov_world[20:], strict=True):
        fit.add(p, cov)
    after = fit.posterior().best.joint
    assert 1.6 < before.axis_sd_rad / after.axis_sd_rad < 2.5  # sqrt(80 / 20) = 2
    result = score(fit.posterior(), _of_keyframes(truth, fit))
    assert result.nees < stats.chi2.ppf(0.999, result.dimensions)


def test_tracks_that_start_late_carry_on_for_those_that_are_lost(opening):
    """Every ten frames a fifth of the tracks is lost and as many start: none lasts."""
    truth = opening(7, "revolute", points=90, frames=80, steady=True)
    first = 10 * (np.arange(90) // 10) - 40
    frames = np.arange(80)[:, None]
    alive = (frames >= first) & (frames < first + 50)
    p = np.where(alive[..., None], truth.tracks.p_world, np.nan)
    fit = IncrementalFit()
    updates = []
    for t in range(80):
        count = np.flatnonzero(alive[: t + 1].any(axis=0)).max() + 1
        updates.append(fit.add(p[t, :count], truth.tracks.cov_world[t, :count]))
    assert updates[-1].kind == "revolute"
    late = [(u.state - truth.q[u.number]) / u.state_sd for u in updates[40:]]
    assert np.max(np.abs(late)) < 4.5


def test_lost_tracks_beyond_the_limit_are_forgotten(opening):
    """Those that are kept still tie the last frame to the first."""
    truth = opening(7, "revolute", points=160, frames=60, steady=True)
    first = 4 * (np.arange(160) // 10) - 20
    frames = np.arange(60)[:, None]
    alive = (frames >= first) & (frames < first + 24)
    p = np.where(alive[..., None], truth.tracks.p_world, np.nan)
    fit, updates = _fed(PointTracks(p, truth.tracks.cov_world), IncrementalConfig(max_tracks=120))
    assert fit.keyframe_tracks.p_world.shape[1] <= 120 < (alive.sum(axis=0) > 0).sum()
    assert updates[-1].kind == "revolute"
    assert updates[-1].zero_frame == 0
    assert abs(updates[-1].state - truth.q[-1]) < 5 * updates[-1].state_sd


@pytest.mark.parametrize("seed", [2, 3])
def test_nothing_moves_and_nothing_is_claimed(seed, opening):
    """Frames of one place must not be averaged by how their noise happens to lie."""
    still = opening(seed, "prismatic", travel=0.0, frames=60)
    fit, updates = _fed(still.tracks)
    assert {u.kind for u in updates} <= {"undecided", "rigid"}
    assert fit.posterior().kind_probability["rigid"] > 0.8  # of few frames: the rest is undecided
    assert updates[-1].joint is None and updates[-1].state is None
    assert len(fit.keyframes) == 1 + IncrementalConfig().resting_keyframes


def test_a_drawer_that_is_opened_after_a_rest_is_found(opening, score):
    truth = opening(5, "prismatic", frames=40, steady=True)
    rest = np.repeat(truth.tracks.p_world[:1], 50, axis=0)
    rest += SIGMA_M * np.random.default_rng(5).normal(size=rest.shape)
    tracks = _joined(PointTracks(rest, truth.tracks.cov_world[[0] * 50]), truth.tracks)
    fit, updates = _fed(tracks)
    assert updates[49].kind in ("rigid", "undecided")
    assert updates[-1].kind == "prismatic"
    assert abs(updates[-1].state - truth.q[-1]) < 4 * updates[-1].state_sd
    q = np.concatenate([np.zeros(50), truth.q])
    result = score(fit.posterior(), replace(truth, q=q[list(fit.keyframes)]))
    assert result.nees < stats.chi2.ppf(0.999, result.dimensions)


def test_wild_tracks_are_rejected(kind, opening, score):
    truth = opening(9, kind, frames=60, wild_share=0.2)
    fit, updates = _fed(truth.tracks)
    posterior = fit.posterior()
    assert posterior.kind == updates[-1].kind == kind
    assert posterior.fit.tracks_rejected == 8
    result = score(posterior, _of_keyframes(truth, fit))
    assert result.nees < stats.chi2.ppf(0.999, result.dimensions)


def test_frames_without_the_part_have_no_state_and_do_no_harm(opening):
    truth = opening(2, "revolute", frames=40)
    p = truth.tracks.p_world.copy()
    p[[0, 7, 20, 21]] = np.nan
    p[30, 2:] = np.nan
    fit, updates = _fed(PointTracks(p, truth.tracks.cov_world))
    assert [u.number for u in updates if u.number > 15 and u.state is None] == [20, 21, 30]
    assert fit.keyframes[0] == 1
    assert updates[-1].kind == "revolute"
    moved = truth.q[-1] - truth.q[1]
    assert abs(abs(updates[-1].state) - abs(moved)) < 5 * updates[-1].state_sd


@pytest.mark.parametrize("points", [1, 2, 3])
def test_few_points_never_end_it(points, opening):
    truth = opening(6, "revolute", points=points, frames=30)
    fit, updates = _fed(truth.tracks)
    if points < 3:
        assert fit.keyframes == ()
        with pytest.raises(TracksLost, match="no frame with 3 tracks"):
            fit.posterior()
    else:
        assert updates[-1].number == 29


def test_points_on_a_line_never_end_it_and_the_open_direction_is_named(opening):
    """Sliding along the line they lie on, their turn about it stays open."""
    rng = np.random.default_rng(0)
    p = np.zeros((30, 6, 3))
    p[..., 0] = np.linspace(0, 0.3, 6) + np.linspace(0, 0.2, 30)[:, None]
    p += 1e-4 * rng.normal(size=p.shape)
    fit = IncrementalFit()
    for frame in p:
        fit.add(frame, np.tile(1e-8 * np.eye(3), (6, 1, 1)))
    try:
        assert fit.posterior().kind in ("prismatic", "undecided")
    except InsufficientData as error:
        assert "T_world_joint" in str(error) or "rigid part" in str(error)


def test_no_frame_is_no_posterior():
    with pytest.raises(TracksLost):
        IncrementalFit().posterior()


def test_broken_frames_are_refused_and_change_nothing(opening):
    truth = opening(1, "revolute", frames=12)
    fit, _ = _fed(truth.tracks)
    p, cov = truth.tracks.p_world[0], truth.tracks.cov_world[0]
    before = fit.keyframes
    for bad_p, bad_cov, words in [
        (p[:, :2], cov, "expected"),
        (p, cov[:-1], "expected"),
        (p[:-1], cov[:-1], "39 tracks after 40"),
        (p, -cov, "positive definite"),
        (p, np.full_like(cov, np.nan), "positive definite"),
    ]:
        with pytest.raises(ValueError, match=words):
            fit.add(bad_p, bad_cov)
    assert fit.keyframes == before
    assert fit.add(p, cov).number == 12


def test_stamps_must_grow(opening):
    truth = opening(1, "revolute", frames=3)
    fit, (p, cov) = IncrementalFit(), (truth.tracks.p_world, truth.tracks.cov_world)
    fit.add(p[0], cov[0], stamp_s=1.0)
    for stamp in (1.0, 0.5, np.nan):
        with pytest.raises(ValueError, match="expected to grow"):
            fit.add(p[1], cov[1], stamp_s=stamp)
    assert fit.add(p[1], cov[1], stamp_s=1.1).stamp_s == 1.1


def test_more_keyframes_than_a_graph_takes_are_refused():
    with pytest.raises(ValueError, match="max_keyframes 100, expected 3 to 60"):
        IncrementalFit(config=IncrementalConfig(max_keyframes=100))


def test_what_is_kept_stays_the_same_size(stream):
    """And goes when it is dropped, without waiting for the collector of cycles."""
    truth, fit, _ = stream
    assert max(fit._keyframes.counts) <= FEW.max_pooled
    assert fit.keyframe_tracks.p_world.shape == (12, 40, 3)
    other, _ = _fed(truth.tracks, FEW, slice(0, 20))
    gone = weakref.ref(other)
    gc.disable()
    try:
        del other
        assert gone() is None
    finally:
        gc.enable()


def test_who_compares_may_be_handed_in_and_asks_for_more_at_once(opening):
    """First by a part of what is known, then by the whole; and the frames are its own."""
    truth, asked = opening(4, "prismatic", frames=30), []
    settings = StreamSettings("given", True, 0, 0.0, FitConfig(), 2)

    def compare(led):
        asked.append(led)
        n = 10 if led else 5
        tracks = PointTracks(truth.tracks.p_world[:n], truth.tracks.cov_world[:n])
        every = np.arange(40)
        snapshot = Snapshot(tracks, every, np.arange(n), np.ones(n, dtype=int), 0)
        found = yield from compare_kinds(snapshot, settings)
        return replace(found, version=None, whole=led)

    fit = IncrementalFit(compare=compare)
    updates = [fit.add(truth.tracks.p_world[t], truth.tracks.cov_world[t]) for t in range(30)]
    assert asked[:2] == [False, True]
    by_part = [u for u in updates if u.joint is not None and u.kind == "undecided"]
    assert by_part and all(u.warning.startswith("the joint is provisional") for u in by_part)
    assert updates[-1].kind == "prismatic" and updates[-1].warning is None
    assert fit.lead is not None and fit.lead.numbers[0] == 0
    assert fit.lead.fit.kind == "prismatic"


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "travel"), [("revolute", 0.5), ("prismatic", 0.15)])
def test_covariance_stays_true_as_frames_are_added(kind, travel, opening, score):
    """NEES over seeds after 25 frames and 55 more, beside a batch fit of all eighty frames.

    What the seeds' luck does to one, it does to the other: the ratio is the sharper check.
    """
    runs, config = 60, IncrementalConfig(max_keyframes=24)
    joints, newest, batch = {25: 0.0, 80: 0.0}, 0.0, 0.0
    for seed in range(runs):
        truth = opening(500 + seed, kind, travel, points=20, frames=80)
        fit = IncrementalFit(config=config)
        for t in range(80):
            update = fit.add(truth.tracks.p_world[t], truth.tracks.cov_world[t])
            if t + 1 in joints:
                result = score(fit.posterior(), _of_keyframes(truth, fit))
                joints[t + 1] += result.nees
        newest += ((update.state - truth.q[-1]) / update.state_sd) ** 2
        everything = fit_tracks(truth.tracks, config=replace(FitConfig(), max_frames=80))
        batch += score(everything, truth).nees
    assert joints[80] < 1.15 * batch
    low, high = stats.chi2.interval(0.999, runs * result.dimensions)
    assert low <= joints[25] <= high
    assert low <= joints[80] <= high
    low, high = stats.chi2.interval(0.999, runs)
    assert low <= newest <= high
