"""Pixels to points: exact on planes, honest about noise, silent at edges and holes."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.interfaces import SeenPixels
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.tracking.lifting import lift, local_depth
from akm_fg.perception.tracking.track_store import TrackStore
from akm_fg.records import PinholeCamera, RgbdFrame

CAMERA = PinholeCamera(320, 240, 300.0, 310.0, 161.0, 118.0)
T_WORLD_CAM = gtsam.Pose3(gtsam.Rot3.RzRyRx(-1.9, 0.2, 0.4), np.array([1.0, 0.5, 0.8]))
NOISE = DepthNoiseModel()


def plane_depth(uv: np.ndarray, normal: tuple, distance: float = 1.0) -> np.ndarray:
    """Depth (...) of the plane normal . p = distance * normal_z at pixels (..., 2)."""
    rays = CAMERA.back_project(uv, np.ones(uv.shape[:-1]))
    return distance * normal[2] / (rays @ np.array(normal))


def pixel_grid() -> np.ndarray:
    v, u = np.mgrid[:240, :320].astype(float)
    return np.stack([u, v], axis=-1)


def frame_of(depth: np.ndarray) -> RgbdFrame:
    rgb = np.zeros((240, 320, 3), np.uint8)
    return RgbdFrame(0.0, rgb, depth.astype(np.float32), CAMERA, T_WORLD_CAM)


def queries(n: int = 400, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([10, 10], [309, 229], (n, 2))


def seen_at(uv: np.ndarray, sigma_px: float) -> SeenPixels:
    return SeenPixels(np.arange(len(uv)), uv, np.tile(sigma_px**2 * np.eye(2), (len(uv), 1, 1)))


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (-0.5, 0.4, 0.77)])
def test_depth_on_a_slanted_plane_is_exact_between_pixels(normal: tuple) -> None:
    uv = queries()
    local = local_depth(frame_of(plane_depth(pixel_grid(), normal)), uv, NOISE)
    np.testing.assert_allclose(local.depth_m, plane_depth(uv, normal), rtol=2e-6)
    step = 1e-3
    for axis in (0, 1):
        d = step * np.eye(2)[axis]
        slope = (plane_depth(uv + d, normal) - plane_depth(uv - d, normal)) / (2 * step)
        np.testing.assert_allclose(local.slope_m_per_px[:, axis], slope, atol=2e-6)


def test_a_depth_step_is_lost_and_both_sides_of_it_are_right() -> None:
    uv = pixel_grid()
    depth = np.where(uv[..., 0] < 160, 1.0, 1.3)
    row = np.stack([np.arange(140.0, 180.0), np.full(40, 100.0)], axis=-1)
    got = local_depth(frame_of(depth), row, NOISE).depth_m
    truth = np.where(row[:, 0] < 160, 1.0, 1.3)
    seen = np.isfinite(got)
    assert seen[:16].all() and seen[-16:].all()
    assert not seen[19:21].any()
    np.testing.assert_allclose(got[seen], truth[seen], atol=1e-5)


def test_flying_pixels_and_small_holes_do_not_matter() -> None:
    rng = np.random.default_rng(1)
    depth = plane_depth(pixel_grid(), (0.5, 0.1, 0.86))
    broken = rng.random(depth.shape)
    depth = np.where(broken < 0.08, np.nan, np.where(broken > 0.92, depth * 1.2, depth))
    uv = queries()
    got = local_depth(frame_of(depth), uv, NOISE).depth_m
    assert np.isfinite(got).mean() > 0.97
    error = np.abs(got - plane_depth(uv, (0.5, 0.1, 0.86)))
    assert np.nanpercentile(error, 98) < 0.002


def test_unknown_depth_border_and_lost_pixels_give_nan() -> None:
    depth = np.ones((240, 320))
    depth[:, :100] = np.nan
    uv = np.array([[50.0, 50.0], [1.0, 120.0], [319.0, 100.0], [np.nan, np.nan], [200.0, 100.0]])
    got = local_depth(frame_of(depth), uv, NOISE).depth_m
    np.testing.assert_array_equal(np.isfinite(got), [False, False, False, False, True])


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.6, 0.2, 0.77)])
def test_lifted_points_have_honest_covariances(normal: tuple, depth_noise_image) -> None:
    """NEES over 12 noisy images: 3 for three degrees of freedom, here held within 2 to 3.6."""
    rng = np.random.default_rng(2)
    sigma_px, nees = 0.4, []
    clean = plane_depth(pixel_grid(), normal)
    for _ in range(12):
        frame = frame_of(clean + depth_noise_image(rng, clean, CAMERA.fx))
        true_uv = queries(200, int(rng.integers(1 << 30)))
        uv = true_uv + rng.normal(scale=sigma_px, size=true_uv.shape)
        got = lift(seen_at(uv, sigma_px), frame, NOISE)
        p_cam = CAMERA.back_project(true_uv, plane_depth(true_uv, normal))
        e = got.p_world - [T_WORLD_CAM.transformFrom(p) for p in p_cam]
        nees.append(np.einsum("ni,nij,nj->n", e, np.linalg.inv(got.cov_world), e))
    assert np.isfinite(nees).all()
    assert 2.0 < np.mean(nees) < 3.6


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_texture_on_a_plane_has_no_relief(normal: tuple, depth_noise_image) -> None:
    """Readings within the gate of noise and mouldings are the plane's; few others are left."""
    rng = np.random.default_rng(0)
    clean = plane_depth(pixel_grid(), normal)
    frame = frame_of(clean + depth_noise_image(rng, clean, CAMERA.fx))
    rgb = rng.integers(0, 255, frame.rgb.shape, dtype=np.uint8)
    got = lift(seen_at(queries(), 0.3), replace(frame, rgb=rgb), NOISE)
    assert np.mean(np.linalg.norm(got.relief_world, axis=1) > 0) < 0.01


def test_what_a_patch_shows_before_its_plane_lasts_along_the_ray() -> None:
    """By hand: a post 6 cm before a plain door a metre away, and all edges that there are on it."""
    depth, rgb = np.ones((240, 320)), np.full((240, 320, 3), 128, np.uint8)
    depth[100:140, 164:172], rgb[100:140, 165:171] = 0.94, 200
    uv = np.array([[160.0, 120.0], [100.0, 120.0]])  # four pixels beside the post; far from it
    got = lift(seen_at(uv, 0.3), replace(frame_of(depth), rgb=rgb), NOISE)
    rays = CAMERA.back_project(uv, np.ones(2)) @ T_WORLD_CAM.rotation().matrix().T
    np.testing.assert_allclose(got.relief_world[0], 0.06 * rays[0], rtol=0.02)
    np.testing.assert_array_equal(got.relief_world[1], 0.0)
    store = TrackStore()
    store.add(got)
    np.testing.assert_array_equal(store.point_tracks().lasting.relief_world[0], got.relief_world)


def test_what_a_tracker_brings_along_is_lifted_onto_the_surface() -> None:
    seen = seen_at(queries(20), 0.5)
    along = np.array([0.4, 0.3])
    lasting = np.outer(along, along) + 1e-4 * np.eye(2)
    frame = frame_of(plane_depth(pixel_grid(), (0.6, 0.2, 0.77)))
    got = lift(replace(seen, lasting_px2=np.tile(lasting, (20, 1, 1))), frame, NOISE)
    moved = lift(replace(seen, uv=seen.uv + along), frame, NOISE)
    way = moved.p_world - got.p_world
    sign = np.sign((way * got.slip_world).sum(axis=1))[:, None]
    np.testing.assert_allclose(got.slip_world, sign * way, atol=3e-3 * np.abs(way).max())


def test_a_slip_keeps_its_sign_from_frame_to_frame() -> None:
    frame = frame_of(plane_depth(pixel_grid(), (0.0, 0.0, 1.0)))
    store, seen = TrackStore(), seen_at(queries(1), 0.5)
    for turn in np.deg2rad([0.0, 40.0, 80.0, 120.0, 160.0]):
        along = 0.4 * np.array([np.cos(turn), np.sin(turn)])
        lasting = np.outer(along, along)[None] + 1e-6 * np.eye(2)
        store.add(lift(replace(seen, lasting_px2=lasting), frame, NOISE))
    store.add(lift(seen, frame, NOISE))  # of this nothing is known
    slip = store.point_tracks().lasting.slip_world[:, 0]
    assert ((slip[:4] * slip[1:5]).sum(axis=1) > 0).all()
    assert (slip[0] * slip[4]).sum() < 0
    assert not slip[5].any()


def test_lost_tracks_stay_lost_and_lengths_must_agree() -> None:
    frame = frame_of(np.where(np.arange(320) < 200, 1.0, np.nan)[None].repeat(240, axis=0))
    uv = np.array([[100.0, 100.0], [250.0, 100.0]])
    seen, store = seen_at(uv, 0.3), TrackStore()
    store.add(lift(SeenPixels(np.array([0, 2]), seen.uv, seen.cov_px2), frame, NOISE))
    got = store.point_tracks()
    np.testing.assert_array_equal(got.observed, [[True, False, False]])
    assert np.isnan(got.cov_world[0, 1:]).all()
    np.testing.assert_array_equal(store.pixel_tracks().visible, [[True, False, True]])
    with pytest.raises(ValueError, match="2 points, but uv"):
        SeenPixels(np.array([0, 1]), uv[:1], seen.cov_px2)


def test_pixel_noise_moves_a_point_along_its_surface_never_off_it() -> None:
    normal = (0.6, 0.2, 0.77)
    exact = DepthNoiseModel(disparity_sigma_px=1e-5, floor_m=1e-7)
    frame = frame_of(plane_depth(pixel_grid(), normal))
    cov = lift(seen_at(queries(50), 0.5), frame, exact).cov_world
    n = T_WORLD_CAM.rotation().matrix() @ np.array(normal) / np.linalg.norm(normal)
    assert np.sqrt(np.einsum("i,nij,j->n", n, cov, n)).max() < 1e-5
    assert np.sqrt(np.trace(cov, axis1=1, axis2=2)).min() > 1e-3


def test_the_depth_of_a_window_is_as_sure_as_its_independent_readings_and_a_floor() -> None:
    """Face on at 1 m, by hand: a reading has hypot(0.08 / (300 * 0.095), 0.0005) = 2.851 mm.

    A window of 7 px holds (7 / 5)^2 = 1.96 independent ones, and the floor of 0.5 mm does not
    average: sqrt(2.851^2 / 1.96 + 0.5^2) = 2.097 mm along the ray.
    """
    middle = np.array([[CAMERA.cx, CAMERA.cy]])
    frame = frame_of(np.ones((240, 320)))
    cov = lift(seen_at(middle, 1e-9), frame, NOISE).cov_world[0]
    ahead = T_WORLD_CAM.rotation().matrix()[:, 2]
    np.testing.assert_allclose(np.sqrt(ahead @ cov @ ahead), 0.002097, rtol=1e-3)
    # What many windows average to can be no better than the floor.
    exact = DepthNoiseModel(disparity_sigma_px=1e-6)
    cov = lift(seen_at(middle, 1e-9), frame, exact).cov_world[0]
    assert np.sqrt(ahead @ cov @ ahead) >= 0.0005


@pytest.mark.parametrize(("tilt_deg", "known"), [(70.0, True), (77.0, True), (82.0, False)])
def test_what_is_seen_nearly_edge_on_has_no_depth(tilt_deg: float, known: bool) -> None:
    """Beyond 79 deg between ray and normal (tangent 5); at the picture's middle, noise-free."""
    tilt = np.deg2rad(tilt_deg)
    normal = (np.sin(tilt), 0.0, np.cos(tilt))
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = plane_depth(pixel_grid(), normal)
    depth = np.where((depth > 0.2) & (depth < 10.0), depth, np.nan)
    got = local_depth(frame_of(depth), np.array([[CAMERA.cx, CAMERA.cy]]), NOISE).depth_m
    assert bool(np.isfinite(got[0])) is known
