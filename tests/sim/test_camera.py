from __future__ import annotations

from collections.abc import Iterator

import gtsam
import numpy as np
import pytest

from akm_fg.records import PinholeCamera
from sim.bullet import load_urdf, p, quiet
from sim.camera import CameraConfig, render, rendered_intrinsics
from sim.episode import SimEpisode, open_world
from sim.noise import NOISE_LEVELS, noisy_depth, noisy_rgb
from sim.views import look_at

PLANE_X_M = 1.1


@pytest.fixture(scope="module")
def episode() -> Iterator[SimEpisode]:
    with open_world("door", seed=0, noise="clean") as opened:
        yield opened


def render_plane(config: CameraConfig) -> tuple[np.ndarray, gtsam.Pose3]:
    """Depth of the plane x = PLANE_X_M, seen askew."""
    T_world_cam = look_at(np.array([0.0, 0.3, 0.2]), np.array([PLANE_X_M, -0.2, 0.5]))
    with quiet():
        client = p.connect(p.DIRECT)
    half = [0.05, 5.0, 5.0]
    shape = p.createVisualShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
    p.createMultiBody(0, -1, shape, [PLANE_X_M + 0.05, 0, 0], physicsClientId=client)
    _, depth = render(client, T_world_cam, config)
    p.disconnect(physicsClientId=client)
    return depth, T_world_cam


def distance_to_plane(
    depth: np.ndarray, camera: PinholeCamera, T_world_cam: gtsam.Pose3
) -> np.ndarray:
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    p_cam = camera.back_project(np.stack([u, v], axis=-1), depth)
    p_world = p_cam @ T_world_cam.rotation().matrix().T + T_world_cam.translation()
    return np.abs(p_world[..., 0] - PLANE_X_M)


def test_a_rendered_plane_projects_back_within_a_tenth_of_a_millimetre():
    config = CameraConfig()
    depth, T_world_cam = render_plane(config)
    camera = rendered_intrinsics(config.width, config.height, config.focal_px)
    assert np.isfinite(depth).all()
    assert distance_to_plane(depth, camera, T_world_cam).max() < 1e-4
    # The usual principal point would be wrong by more than that: the test can fail.
    usual = PinholeCamera(
        config.width, config.height, config.focal_px, config.focal_px, 319.5, 239.5
    )
    assert distance_to_plane(depth, usual, T_world_cam).max() > 1e-4


def test_pixels_of_the_robot_carry_no_depth(episode: SimEpisode):
    world, camera = episode.world, episode.camera
    frame = camera.capture()
    eye, R = camera.T_world_cam.translation(), camera.T_world_cam.rotation().matrix()
    c = camera.config
    x, y = 2 * c.focal_px / c.width, 2 * c.focal_px / c.height
    segmentation = p.getCameraImage(
        c.width,
        c.height,
        p.computeViewMatrix(eye.tolist(), (eye + R[:, 2]).tolist(), (-R[:, 1]).tolist()),
        [x, 0, 0, 0, 0, y, 0, 0, 0, 0, -1.02, -1, 0, 0, -0.2, 0],
        renderer=p.ER_TINY_RENDERER,
        physicsClientId=world.client,
    )[4]
    robot = np.reshape(segmentation, (c.height, c.width)) == world.robot_id
    assert robot.sum() > 5000
    assert np.isnan(frame.depth_m[robot]).all()


def test_the_front_keeps_most_of_its_depth(episode: SimEpisode):
    frame = episode.camera.capture()
    T = episode.world.placement.T_world_object
    spec = episode.world.spec
    x = np.linspace(-0.4, 0.4, 20) * spec.size_m[0]
    z = spec.size_m[2] - np.linspace(0.1, 0.9, 20) * spec.front_height_m
    front = np.array([[a, -spec.size_m[1] / 2, b] for a in x for b in z])
    p_cam = (
        front @ T.rotation().matrix().T + T.translation() - frame.T_world_cam.translation()
    ) @ frame.T_world_cam.rotation().matrix()
    uv = frame.camera.project(p_cam)
    i = uv.round().astype(int)
    assert (i >= 0).all() and (i < [frame.camera.width, frame.camera.height]).all()
    error = frame.depth_m[i[:, 1], i[:, 0]] - p_cam[:, 2]
    assert (np.abs(error) < 0.004).mean() > 0.8
    assert frame.rgb[i[:, 1], i[:, 0]].astype(float).std(axis=0).mean() > 8.0  # textured


def test_drawing_what_stands_still_once_changes_no_pixel():
    with open_world("furniture-dev/door-003", seed=0, noise="clean") as opened:
        world, camera = opened.world, opened.camera
        p.resetJointState(world.object_id, world.part_joint, 0.4, physicsClientId=world.client)
        rgb, depth = camera.exact()
        assert np.isnan(depth).mean() < 0.5
        for urdf, T_world_body in world.still:  # all in one picture
            load_urdf(world.client, urdf, T_world_body)
        rgb_at_once, depth_at_once = render(world.client, camera.T_world_cam, camera.config)
        np.testing.assert_array_equal(rgb, rgb_at_once)
        np.testing.assert_array_equal(depth, depth_at_once)


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


def test_noise_keeps_the_image_range_and_the_clean_level_adds_none(episode: SimEpisode):
    a, b = episode.camera.capture(), episode.camera.capture()
    np.testing.assert_array_equal(a.rgb, b.rgb)
    np.testing.assert_array_equal(a.depth_m, b.depth_m)
