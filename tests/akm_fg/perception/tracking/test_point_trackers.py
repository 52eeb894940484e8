"""The contract of every PointTracker, and how far the default one can be trusted."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from akm_fg.interfaces import PointTracker
from akm_fg.perception.tracking.affine_match import (
    AffineMatchConfig,
    cut_templates,
    match,
    smooth,
)
from akm_fg.perception.tracking.clips import track_clip
from akm_fg.perception.tracking.flow_tracker import FlowTracker
from akm_fg.perception.tracking.seeding import SeedingConfig, seed_points
from akm_fg.perception.tracking.track_store import pixel_tracks

BACKENDS = [FlowTracker]
PART = 2


@pytest.fixture(params=BACKENDS, ids=lambda backend: backend.__name__)
def tracker(request: pytest.FixtureRequest) -> PointTracker:
    return request.param()


def seeds_on(clip, n: int = 150) -> np.ndarray:
    mask = np.isin(clip.labels[0], (1, 2))
    return seed_points(clip.frames[0], mask, np.random.default_rng(0), SeedingConfig(number=n))


def test_queries_come_back_in_order_from_their_frames_on(tracker, door) -> None:
    uv = seeds_on(door)[:8]
    starts = [0, 3, 0, 6, 2, 0, 7, 1]
    tracks = track_clip(tracker, door.frames[:8], uv, starts)
    assert tracks.uv.shape == (8, 8, 2)
    np.testing.assert_array_equal(tracks.uv[starts, range(8)], uv)
    for i, start in enumerate(starts):
        assert not tracks.visible[:start, i].any()
        assert tracks.visible[start, i]


def test_lost_means_nan_and_seen_means_finite(tracker, door_behind_robot) -> None:
    clip = door_behind_robot
    uv = seeds_on(clip)
    tracks = track_clip(tracker, clip.frames, uv, [0] * len(uv))
    assert not tracks.visible.all()
    np.testing.assert_array_equal(tracks.visible, np.isfinite(tracks.uv).all(axis=-1))
    np.testing.assert_array_equal(tracks.visible, np.isfinite(tracks.cov_px2).all(axis=(2, 3)))
    assert (np.linalg.eigvalsh(tracks.cov_px2[tracks.visible]) > 0).all()


def test_tracking_does_not_depend_on_the_company(tracker, door) -> None:
    uv = seeds_on(door)[:20]
    together = track_clip(tracker, door.frames[:5], uv, [0] * 20)
    alone = track_clip(tracker, door.frames[:5], uv[:3], [0] * 3)
    np.testing.assert_allclose(together.uv[:, :3], alone.uv, atol=1e-3)


def test_no_queries_give_no_tracks(tracker, door) -> None:
    tracks = track_clip(tracker, door.frames[:3], np.empty((0, 2)), [])
    assert tracks.visible.shape == (3, 0)


@pytest.mark.parametrize(
    ("uv", "starts", "message"),
    [
        ([[1.0, 1.0]], [3], "query frames"),
        ([[1.0, 1.0]], [-1], "query frames"),
        ([[400.0, 1.0]], [0], "outside"),
        ([[np.nan, 1.0]], [0], "not finite"),
        ([[1.0, 1.0]], [0, 1], "1 queries"),
    ],
)
def test_bad_queries_are_refused(tracker, door, uv, starts, message) -> None:
    with pytest.raises(ValueError, match=message):
        track_clip(tracker, door.frames[:3], np.array(uv), starts)


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_the_parts_tracks_stay_within_a_fraction_of_a_pixel(tracker, name, request) -> None:
    clip = request.getfixturevalue(name)
    uv = seeds_on(clip)
    tracks = track_clip(tracker, clip.frames, uv, [0] * len(uv))
    points, labels = clip.true_points(uv, np.zeros(len(uv), int))
    true_uv, seen = clip.true_pixels(points)
    error = np.linalg.norm(tracks.uv - true_uv, axis=-1)[:, labels == PART]
    visible, seen = tracks.visible[:, labels == PART], seen[:, labels == PART]
    assert visible[-1].sum() > 0.9 * seen[-1].sum()  # hardly any is lost
    assert np.nanmedian(error[-1]) < 0.3
    assert np.nanpercentile(error[-1], 95) < 1.5
    off = (tracks.uv - true_uv)[:, labels == PART][1:][visible[1:] & seen[1:]]
    cov_px2 = tracks.cov_px2[:, labels == PART][1:][visible[1:] & seen[1:]]
    normalised = np.sqrt(np.einsum("ni,nij,nj->n", off, np.linalg.inv(cov_px2), off))
    assert np.mean(normalised > 3.5) < 0.03  # never much surer than right


def test_points_behind_the_robot_are_lost_and_resting_ones_come_back(
    tracker, door_behind_robot
) -> None:
    clip = door_behind_robot
    uv = seeds_on(clip)
    tracks = track_clip(tracker, clip.frames, uv, [0] * len(uv))
    points, labels = clip.true_points(uv, np.zeros(len(uv), int))
    _, seen = clip.true_pixels(points)
    covered = np.zeros_like(tracks.visible)
    for t in range(len(clip.frames)):
        at = np.rint(np.nan_to_num(tracks.uv[t])).astype(int)
        covered[t] = tracks.visible[t] & (clip.labels[t, at[:, 1], at[:, 0]] == 3)
    assert covered.sum() <= 0.002 * tracks.visible.sum()
    resting = (labels == 1) & (~tracks.visible).any(axis=0) & seen[-1]
    assert resting.sum() >= 3
    assert tracks.visible[-1, resting].mean() > 0.6


def test_seeds_spread_over_the_mask_and_keep_off_depth_edges(door) -> None:
    mask = np.isin(door.labels[0], (1, 2))
    uv = seed_points(door.frames[0], mask, np.random.default_rng(0), SeedingConfig(number=100))
    assert 60 <= len(uv) <= 180
    u, v = uv.astype(int).T
    assert mask[v, u].all() and np.isfinite(door.frames[0].depth_m[v, u]).all()
    z = door.depth[0]
    for du, dv in ((4, 0), (-4, 0), (0, 4), (0, -4)):
        assert (np.abs(z[v + dv, u + du] - z[v, u]) < 0.08).all()


def test_plain_surfaces_get_no_seeds_and_their_textured_spot_gets_many(door) -> None:
    frame = door.frames[0]
    rng = np.random.default_rng(3)
    rgb = np.full_like(frame.rgb, 120)
    spot = np.zeros(frame.depth_m.shape, bool)
    spot[90:130, 120:170] = True
    rgb[spot] = rng.integers(60, 180, (int(spot.sum()), 3))
    mask = np.isin(door.labels[0], (1, 2))
    uv = seed_points(replace(frame, rgb=rgb), mask, rng, SeedingConfig(number=100))
    u, v = uv.astype(int).T
    near = cv2.dilate(spot.astype(np.uint8), np.ones((11, 11), np.uint8)) > 0
    assert near[v, u].all()  # the window of a corner reaches beyond the texture
    assert len(uv) > 1.3 * 100 * spot.sum() / mask.sum()  # denser than over the whole object


def test_an_empty_mask_gives_no_seeds(door) -> None:
    mask = np.zeros(door.labels[0].shape, bool)
    assert seed_points(door.frames[0], mask, np.random.default_rng(0)).shape == (0, 2)


def test_new_seeds_are_set_only_where_nothing_is_followed(door, tracker) -> None:
    masks = {t: np.isin(door.labels[t], (1, 2)) for t in (0, 8)}
    config = SeedingConfig(number=120)
    session, rows, rng = tracker.begin(), [], np.random.default_rng(0)
    for t, frame in enumerate(door.frames):
        seen = session.advance(frame)
        if t in masks:
            new_uv = seed_points(frame, masks[t], rng, config, seen.uv)
            seen = seen.joined(session.follow(new_uv))
        rows.append(seen)
    tracks = pixel_tracks(rows, 1 + max(int(row.index.max()) for row in rows))
    started = tracks.visible.argmax(axis=0)
    assert set(started) == {0, 8}
    old, new = tracks.uv[8, started == 0], tracks.uv[8, started == 8]
    gaps = np.linalg.norm(new[:, None] - old[None], axis=-1)
    assert np.nanmin(gaps) > 5


def test_what_was_seen_does_not_depend_on_what_comes_after(door, tracker) -> None:
    uv = seeds_on(door)[:20]
    whole = track_clip(tracker, door.frames[:8], uv, [0] * 20)
    short = track_clip(tracker, door.frames[:4], uv, [0] * 20)
    np.testing.assert_array_equal(whole.uv[:4], short.uv)
    np.testing.assert_array_equal(whole.cov_px2[:4], short.cov_px2)


def test_nothing_is_followed_before_the_first_frame(tracker) -> None:
    with pytest.raises(ValueError, match="no frame yet"):
        tracker.begin().follow(np.array([[1.0, 1.0]]))


def test_two_streams_of_one_tracker_share_nothing(tracker, door, drawer) -> None:
    uv = seeds_on(door)[:10]
    alone = track_clip(tracker, door.frames[:4], uv, [0] * 10)
    other, session = tracker.begin(), tracker.begin()
    for frame, foreign in zip(door.frames[:4], drawer.frames[:4], strict=True):
        seen = session.advance(frame)
        other.advance(foreign)
        for each in (session, other):
            if frame is door.frames[0]:
                each.follow(uv)
    np.testing.assert_array_equal(alone.uv[3, seen.index], seen.uv)


def test_a_point_whose_equations_are_singular_is_lost_and_the_others_go_on(door) -> None:
    config, uv = AffineMatchConfig(), seeds_on(door)[:6]
    image = smooth(door.frames[0].rgb, config)
    templates, flat = cut_templates(image, uv, config), np.tile(np.eye(2), (6, 1, 1))
    prior, every = np.tile(np.eye(2), (6, 1, 1)), np.arange(6)
    whole = match(image, templates, every, uv, flat, prior, config)
    prior[2] = 0.0
    shape = flat.copy()
    shape[4] = 0.0
    found = match(image, templates, every, uv, shape, prior, config)
    others = [0, 1, 3, 5]
    np.testing.assert_allclose(found.uv[others], whole.uv[others], atol=1e-6)
    assert np.isfinite(found.cov_px2[others]).all()
    assert np.isnan(found.uv[2]).all() and np.isnan(found.cov_px2[4]).all()
