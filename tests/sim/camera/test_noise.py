from __future__ import annotations

import numpy as np
import pytest

from sim.camera.noise import (
    NOISE_LEVELS,
    NoiseConfig,
    Surface,
    _incidence_cos,
    noisy_depth,
    noisy_rgb,
)
from sim.camera.pictures import rendered_intrinsics
from sim.camera.sensor import NoisySensor

D455 = NOISE_LEVELS["d455"]


def surface_of(grey: int, specular: float, size: tuple[int, int] = (240, 320)) -> Surface:
    """One material all over."""
    return Surface(
        np.full((*size, 3), grey, dtype=np.uint8), np.full(size, specular, dtype=np.float32)
    )


def lost_share(surface: Surface, tilt: float = 0.0, config: NoiseConfig = D455) -> float:
    """Share of a plane 1.2 m away, tilted by `tilt` rad about the image's x axis, without depth."""
    camera = rendered_intrinsics(320, 240, 300.0)
    y = (np.arange(240) - camera.cy)[:, None] / camera.fy
    plane = 1.2 / (1.0 - np.tan(tilt) * np.broadcast_to(y, (240, 320)))
    noisy = noisy_depth(plane, camera, config, np.random.default_rng(0), surface)
    return float(np.isnan(noisy[40:200, 40:280]).mean())


def test_depth_noise_grows_with_the_square_of_distance():
    camera = rendered_intrinsics(320, 240, 300.0)
    rng = np.random.default_rng(0)
    sd = []
    for z in (0.8, 1.6, 3.2):
        depth = noisy_depth(np.full((240, 320), z), camera, NOISE_LEVELS["d455"], rng)
        sd.append(np.nanstd(depth))
    np.testing.assert_allclose(np.array(sd[1:]) / sd[:-1], 4.0, rtol=0.1)
    expected = 1.6**2 / (425.0 * 0.095) * 0.08
    np.testing.assert_allclose(sd[1], expected, rtol=0.1)


@pytest.mark.parametrize("level", ["d455", "harsh"])
def test_noise_has_the_strength_and_reach_that_its_level_says(level: str):
    camera, config = rendered_intrinsics(640, 480, 600.0), NOISE_LEVELS[level]
    rng = np.random.default_rng(0)
    error = noisy_depth(np.full((480, 640), 1.6), camera, config, rng) - 1.6
    expected = 1.6**2 / (config.depth_focal_px * config.baseline_m) * config.disparity_sigma_px
    np.testing.assert_allclose(error.std(), expected, rtol=0.1)
    # Two blurs of one Gaussian: correlation exp(-d^2 / (4 s^2)); quantisation takes a little.
    apart = round(config.correlation_px)
    r = np.corrcoef(error[:, apart:].ravel(), error[:, :-apart].ravel())[0, 1]
    np.testing.assert_allclose(r, np.exp(-(apart**2) / (4.0 * config.correlation_px**2)), atol=0.08)
    grey = np.full((480, 640, 3), 120, dtype=np.uint8)
    images = np.array([noisy_rgb(grey, config, rng).astype(float) for _ in range(30)])
    np.testing.assert_allclose(images[0].std(), config.rgb_sigma, rtol=0.05)
    means = images.mean(axis=(1, 2, 3))
    np.testing.assert_allclose(means.std(), 120.0 * config.rgb_gain_sd, rtol=0.5, atol=0.05)


def test_disparity_comes_in_steps_of_a_thirty_second_of_a_pixel():
    """Intel's D4 ASIC has 5 bits below the pixel: at z depths are z^2 / (32 f b) apart.

    At 2 m, with 425 px and 95 mm: 4 / (32 * 425 * 0.095) = 3.10 mm.
    """
    camera = rendered_intrinsics(320, 240, 300.0)
    noisy = noisy_depth(np.full((240, 320), 2.0), camera, D455, np.random.default_rng(0))
    levels = np.unique(noisy[np.isfinite(noisy)])
    assert levels.size > 5
    middle = np.diff(levels)[levels.size // 2 - 2 : levels.size // 2 + 2]
    np.testing.assert_allclose(middle, 0.00310, rtol=0.02)


@pytest.mark.parametrize("tilt", [0.0, 0.6, 1.2])
def test_incidence_is_the_angle_between_ray_and_normal(tilt: float):
    """Of a plane through (0, 0, 1.2) m with normal (0, -sin, -cos); every inner pixel."""
    camera = rendered_intrinsics(320, 240, 600.0)
    v, u = np.mgrid[:240, :320].astype(float)
    rays = camera.back_project(np.stack([u, v], axis=-1), np.ones_like(u))
    normal = np.array([0.0, -np.sin(tilt), -np.cos(tilt)])
    depth = 1.2 * normal[2] / (rays @ normal)
    expected = -(rays @ normal) / np.linalg.norm(rays, axis=-1)
    got = _incidence_cos(depth.astype(np.float32), camera)
    np.testing.assert_allclose(got[2:-2, 2:-2], expected[2:-2, 2:-2], atol=2e-3)


def test_edge_pixels_that_are_seen_at_all_fly_between_the_two_surfaces():
    """A quarter flies, evenly over the half metre behind the nearer one: 0.8 from 1.05 to 1.45 m.

    An edge is also seen edge-on (1 / z falls by 0.25 a pixel, cosine 1 / 75), which loses
    0.9 (1 - 4 / 75) = 0.852 of all: 0.25 * 0.8 * 0.148 = 0.030 are left.
    """
    camera = rendered_intrinsics(320, 240, 300.0)
    depth = np.full((240, 320), 2.0)
    depth[:, :160] = 1.0
    rng = np.random.default_rng(0)
    edge = np.array([noisy_depth(depth, camera, D455, rng)[:, 159:161] for _ in range(20)])
    between = (edge > 1.05) & (edge < 1.45)
    np.testing.assert_allclose(between.mean(), 0.030, atol=0.006)


def test_levels_grow_harsher():
    clean, d455, harsh = (NOISE_LEVELS[name] for name in ("clean", "d455", "harsh"))
    assert clean.disparity_sigma_px is None and clean.rgb_sigma == 0.0
    assert d455.disparity_sigma_px < harsh.disparity_sigma_px
    assert d455.edge_hole < harsh.edge_hole and d455.rgb_sigma < harsh.rgb_sigma


def test_depth_is_lost_at_edges_and_kept_on_smooth_surfaces():
    camera = rendered_intrinsics(320, 240, 300.0)
    depth = np.full((240, 320), 1.6)
    depth[:, 160:] = 1.0
    noisy = noisy_depth(depth, camera, NOISE_LEVELS["d455"], np.random.default_rng(0))
    assert np.isnan(noisy[:, 150:164]).mean() > 0.3
    assert np.isnan(noisy[:, 180:300]).mean() < 0.01


def test_dark_surfaces_lose_depth_the_more_the_darker_and_bright_ones_none():
    shares = [lost_share(surface_of(grey, 0.0)) for grey in (120, 60, 40, 20, 5)]
    assert shares[0] == shares[1] == 0.0
    assert 0.05 < shares[2] < shares[3] < shares[4]
    np.testing.assert_allclose(shares[4], 0.9, atol=0.05)
    # Linear reflectance (40 / 255)^2.2 = 0.017, against 0.026.
    np.testing.assert_allclose(shares[2], 0.9 * (1.0 - 0.0170 / 0.026), atol=0.06)


def test_a_shiny_surface_is_lost_where_it_mirrors_the_projector_and_where_little_scatters():
    satin = surface_of(140, 0.6)
    assert lost_share(satin, tilt=0.6) == 0.0  # enough is scattered
    facing = noisy_depth(
        np.full((240, 320), 1.2),
        rendered_intrinsics(320, 240, 300.0),
        D455,
        np.random.default_rng(0),
        satin,
    )
    assert 0.3 < np.isnan(facing[100:140, 140:180]).mean() < 0.9  # within the glare
    assert np.isnan(facing[:, :60]).mean() == 0.0  # beyond it
    assert lost_share(surface_of(50, 0.9), tilt=0.6) > 0.7  # dark glass


def test_dark_holes_come_in_patches_and_change_from_frame_to_frame():
    camera, rng = rendered_intrinsics(320, 240, 300.0), np.random.default_rng(0)
    plane, dark = np.full((240, 320), 1.2), surface_of(30, 0.0)
    first, second = (np.isnan(noisy_depth(plane, camera, D455, rng, dark)) for _ in range(2))
    neighbours = np.corrcoef(first[:, 1:].ravel(), first[:, :-1].ravel())[0, 1]
    # A neighbour lies in the same square of 7 with 6 chances of 7.
    np.testing.assert_allclose(neighbours, 6.0 / 7.0, atol=0.05)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.1


def test_what_lies_left_of_something_near_is_hidden_from_the_second_imager():
    camera = rendered_intrinsics(640, 480, 600.0)
    depth = np.full((480, 640), 2.0)
    depth[:, 300:] = 1.0
    noisy = noisy_depth(depth, camera, D455, np.random.default_rng(0))
    lost = np.isnan(noisy).mean(axis=0)
    width = 600.0 * 0.095 * (1.0 / 1.0 - 1.0 / 2.0)  # 28.5 px
    first = 300 - round(width)
    assert (lost[first + 2 : 299] == 1.0).all()
    assert (lost[: first - 2] == 0.0).all() and (lost[305:] == 0.0).all()


def test_a_band_on_the_left_is_lost_where_the_image_is_as_wide_as_the_depth_stream():
    camera = rendered_intrinsics(848, 480, 425.0)
    noisy = noisy_depth(np.full((480, 848), 1.0), camera, D455, np.random.default_rng(0))
    lost = np.isnan(noisy).mean(axis=0)
    band = 425.0 * 0.095 / 1.0  # 40 px
    assert (lost[: round(band) - 1] == 1.0).all() and (lost[round(band) + 1 :] == 0.0).all()
    # The default image is narrower: none of the band is in it.
    camera = rendered_intrinsics(640, 480, 600.0)
    noisy = noisy_depth(np.full((480, 640), 0.6), camera, D455, np.random.default_rng(0))
    assert np.isfinite(noisy).all()


def test_the_filtered_level_is_quieter_by_what_the_average_takes_and_remembers():
    camera, config = rendered_intrinsics(320, 240, 300.0), NOISE_LEVELS["d455-filtered"]
    assert config.temporal is not None
    bright, plane = surface_of(150, 0.0), np.full((240, 320), 1.6)
    sensor = NoisySensor(config, camera, np.random.default_rng(0))
    errors = np.array([sensor.depth(plane, bright) - 1.6 for _ in range(24)])[12:]
    alpha = config.temporal.alpha
    raw = 1.6**2 / (config.depth_focal_px * config.baseline_m) * config.disparity_sigma_px
    expected = raw * np.sqrt(alpha / (2.0 - alpha))
    np.testing.assert_allclose(np.nanstd(errors), expected, rtol=0.05)
    for lag in (1, 2, 3):
        a, b = errors[lag:].ravel(), errors[:-lag].ravel()
        np.testing.assert_allclose(np.corrcoef(a, b)[0, 1], (1.0 - alpha) ** lag, atol=0.05)


def test_raw_levels_do_not_remember_the_frame_before():
    camera, bright = rendered_intrinsics(320, 240, 300.0), surface_of(150, 0.0)
    sensor = NoisySensor(D455, camera, np.random.default_rng(0))
    a, b = (sensor.depth(np.full((240, 320), 1.6), bright) - 1.6 for _ in range(2))
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.05


def test_the_light_wanders_with_the_square_root_of_time_where_the_level_says_so():
    camera, harsh = rendered_intrinsics(32, 24, 30.0), NOISE_LEVELS["harsh"]
    steps, grey = [], surface_of(120, 0.0, (24, 32))
    for seed in range(300):
        sensor = NoisySensor(harsh, camera, np.random.default_rng(seed))
        before, after = (sensor.rgb(grey, t).mean() for t in (0.0, 9.0))
        steps.append(np.log(after / before))
    walk, flicker = harsh.rgb_drift_per_sqrt_s * 3.0, harsh.rgb_gain_sd
    tint = harsh.rgb_tint_sd / np.sqrt(3.0)
    expected = np.sqrt(walk**2 + 2.0 * flicker**2 + 2.0 * tint**2)
    np.testing.assert_allclose(np.std(steps), expected, rtol=0.15)
    sensor = NoisySensor(D455, camera, np.random.default_rng(0))
    assert abs(sensor.rgb(grey, 0.0).mean() - sensor.rgb(grey, 100.0).mean()) < 0.3


def test_the_tint_moves_the_colours_apart():
    grey = surface_of(120, 0.0, (24, 32)).rgb
    harsh, rng = NOISE_LEVELS["harsh"], np.random.default_rng(0)
    means = np.array([noisy_rgb(grey, harsh, rng).mean(axis=(0, 1)) for _ in range(200)])
    apart = (means[:, 0] - means[:, 1]).std()
    # Two independent tints, white noise of 768 pixels, and grey levels rounded.
    expected = np.sqrt(2.0) * np.hypot(120.0 * harsh.rgb_tint_sd, harsh.rgb_sigma / np.sqrt(768.0))
    np.testing.assert_allclose(apart, expected, rtol=0.2)
