"""What moved: tracks with known noise, doors down to the hinge, and nothing at all."""

import time

import numpy as np
import pytest

from akm_fg.errors import NoMotionObserved, TracksLost
from akm_fg.perception.moving_part.motion_config import MotionSegmentationConfig
from akm_fg.perception.moving_part.motion_segmentation import segment_motion
from akm_fg.records import PointTracks
from akm_fg.steps import to_end

SIGMA_M = np.array([0.001, 0.001, 0.003])


def simulate(
    kind: str, last: float, seed: int = 0, T: int = 20, n_part: int = 80, n_rest: int = 60,
    n_bad: int = 0, gaps: bool = False,
) -> tuple[PointTracks, np.ndarray]:  # fmt: skip
    """Tracks of a 0.5 m panel that swings about x = 0 or slides along z, and of a frame.

    Returns labels: 1 part, 0 at rest, -1 drifting on its own.
    """
    rng = np.random.default_rng(seed)
    part = rng.uniform([0, 0, 0], [0.5, 0.5, 0.02], (n_part, 3))
    rest = rng.uniform([-0.3, -0.2, -0.1], [0.8, 0.7, 0.0], (n_rest, 3))
    bad = rng.uniform([0, 0, 0], [0.5, 0.5, 0.1], (n_bad, 3))
    drift = rng.normal(scale=0.02, size=(T, n_bad, 3)).cumsum(axis=0)
    p = np.empty((T, n_part + n_rest + n_bad, 3))
    for t, q in enumerate(np.linspace(0, last, T)):
        c, s = np.cos(q), np.sin(q)
        R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        moved = part @ R.T if kind == "revolute" else part + np.array([0, 0, q])
        p[t] = np.concatenate([moved, rest, bad + drift[t]])
    p += rng.normal(size=p.shape) * SIGMA_M
    if gaps:
        start = rng.integers(0, T // 2, p.shape[1])
        p[np.arange(T)[:, None] < start[None]] = np.nan
        p[rng.random(p.shape[:2]) < 0.2] = np.nan
    cov = np.where(np.isfinite(p[..., :1, None]), np.diag(SIGMA_M**2), np.nan)
    return PointTracks(p, cov), np.repeat([1, 0, -1], [n_part, n_rest, n_bad])


CASES = [("revolute", 0.6), ("revolute", 0.15), ("prismatic", 0.2), ("prismatic", 0.02)]


@pytest.mark.parametrize(("kind", "last"), CASES)
@pytest.mark.parametrize("gaps", [False, True])
def test_moving_and_resting_tracks_are_told_apart(kind: str, last: float, gaps: bool) -> None:
    for seed in range(3):
        tracks, labels = simulate(kind, last, seed, n_bad=15, gaps=gaps)
        got = to_end(segment_motion(tracks, rng=np.random.default_rng(seed)))
        assert not (got.moving & got.static).any()
        assert (got.moving & (labels == 0)).sum() == 0
        assert (got.static & (labels == 1)).sum() <= 1
        assert got.moving[labels == 1].mean() > (0.9 if last > 0.15 else 0.7)
        assert got.static[labels == 0].mean() > (0.95 if last > 0.15 else 0.8)
        assert (got.moving | got.static)[labels == -1].mean() < 0.1  # drift is not motion
        assert got.p_nothing_moved < 1e-6
        got.require_motion()


def test_points_by_the_hinge_are_never_called_resting() -> None:
    tracks, labels = simulate("revolute", 0.6, seed=1, n_part=200)
    got = to_end(segment_motion(tracks))
    by_hinge = (labels == 1) & (tracks.p_world[0, :, 0] < 0.05)
    assert by_hinge.sum() > 10
    assert not got.static[by_hinge].any()


@pytest.mark.parametrize("seed", range(5))
def test_where_nothing_moves_nothing_moved(seed: int) -> None:
    tracks, labels = simulate("prismatic", 0.0, seed, n_bad=12)
    got = to_end(segment_motion(tracks, rng=np.random.default_rng(seed)))
    assert not got.moving.any()
    assert got.static[labels >= 0].mean() > 0.98
    assert not got.static[labels == -1].any()
    assert got.p_nothing_moved >= 0.5
    with pytest.raises(NoMotionObserved, match="nothing moved beyond the noise"):
        got.require_motion()


def test_noise_twice_as_large_as_claimed_is_still_no_motion() -> None:
    tracks, _ = simulate("prismatic", 0.0, 3)
    got = to_end(segment_motion(PointTracks(tracks.p_world, tracks.cov_world / 4)))
    assert not got.moving.any()
    assert got.noise_scale < 3


def test_a_part_alone_in_view_moved() -> None:
    tracks, _ = simulate("revolute", 0.5, n_rest=0)
    got = to_end(segment_motion(tracks))
    assert got.moving.mean() > 0.9


def test_tracks_too_short_to_judge_are_said_to_be_lost() -> None:
    tracks, _ = simulate("revolute", 0.5)
    p = tracks.p_world.copy()
    p[2:] = np.nan
    got = to_end(segment_motion(PointTracks(p, tracks.cov_world)))
    assert not (got.moving | got.static | got.rejected).any()
    with pytest.raises(TracksLost, match="fewer than 3 of 140 tracks"):
        got.require_motion()


@pytest.mark.slow
def test_a_thousand_tracks_over_sixty_frames_take_less_than_a_second() -> None:
    tracks, _ = simulate("revolute", 0.8, T=60, n_part=600, n_rest=350, n_bad=50, gaps=True)
    start = time.perf_counter()
    to_end(segment_motion(tracks))
    assert time.perf_counter() - start < 3.0  # 0.7 s on a free core


def swinging_hand(last: float, T: int = 20) -> np.ndarray:
    """(T, 3) of a gripper on the panel's handle, which moves as `simulate`'s revolute part."""
    q = np.linspace(0, last, T)
    return np.stack([0.45 * np.cos(q), np.full(T, 0.25), -0.45 * np.sin(q)], axis=-1)


def test_with_the_hand_a_few_tracks_suffice_among_many_that_drift() -> None:
    tracks, labels = simulate("revolute", 0.5, 2, n_part=5, n_bad=40)
    got = to_end(segment_motion(tracks, hand_world=swinging_hand(0.5)))
    assert got.moving[labels == 1].all()
    assert not got.moving[labels != 1].any()
    assert not to_end(segment_motion(tracks)).moving[labels == 1].all()  # alone they are too few


def test_a_hand_that_moves_without_the_part_moves_nothing() -> None:
    tracks, _ = simulate("prismatic", 0.0, 4, n_bad=12)
    assert not to_end(segment_motion(tracks, hand_world=swinging_hand(0.5))).moving.any()


def test_a_hand_that_is_not_known_in_some_frames_still_helps() -> None:
    tracks, labels = simulate("revolute", 0.5, 2, n_part=5, n_bad=40)
    hand = swinging_hand(0.5)
    hand[[3, 4, 12]] = np.nan
    got = to_end(segment_motion(tracks, hand_world=hand))
    assert got.moving[labels == 1].all()


@pytest.mark.parametrize(("n", "moved"), [(7, False), (9, True)])
def test_motion_is_believed_where_its_evidence_outweighs_what_its_freedom_costs(
    n: int, moved: bool
) -> None:
    """Exact tracks that jump by d half-way, with a sd s of each coordinate.

    At rest every reading is d / 2 off, so rest costs a track T d^2 / (8 s^2) nats: 45 for 20
    frames and d = sqrt(18) s. BIC (Schwarz, 1978) asks half a log of the 60 n readings for each
    of the 6 * 19 numbers of a motion: 57 log(420) = 344 nats against 7 * 45 = 315 for 7 tracks,
    57 log(540) = 359 nats against 9 * 45 = 405 for 9.
    """
    T, claimed_m, systematic_m = 20, 0.004, 0.0015
    x = np.random.default_rng(0).uniform(0, 0.5, (n, 3))
    jump = np.sqrt(18.0) * np.hypot(claimed_m, systematic_m) * (np.arange(T) >= T // 2)
    p = x + jump[:, None, None] * np.array([0.0, 0.0, 1.0])
    tracks = PointTracks(p, np.tile(claimed_m**2 * np.eye(3), (T, n, 1, 1)))
    config = MotionSegmentationConfig(systematic_m=systematic_m)
    got = to_end(segment_motion(tracks, config))
    assert got.moving.all() == moved and got.moving.any() == moved
    if moved:
        np.testing.assert_allclose(got.p_nothing_moved, np.exp(358.6 - 405.0), rtol=0.5)
