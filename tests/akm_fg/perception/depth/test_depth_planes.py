"""Local planes: exact where the scene is one, silent where it is not, and fast to look up."""

import gtsam
import numpy as np
import pytest

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import DepthPlanesConfig, bounding_box, depth_planes
from akm_fg.records import PinholeCamera, RgbdFrame

CAMERA = PinholeCamera(320, 240, 300.0, 310.0, 161.0, 118.0)
T_WORLD_CAM = gtsam.Pose3(gtsam.Rot3.RzRyRx(-1.9, 0.2, 0.4), np.array([1.0, 0.5, 0.8]))
NOISE = DepthNoiseModel()
NORMALS = [(0.0, 0.0, -1.0), (0.6, 0.0, -0.8), (-0.5, 0.4, -0.77)]


def plane_depth(uv: np.ndarray, normal: tuple, distance_m: float = 1.0) -> np.ndarray:
    """Depth (...) of the plane through (0, 0, distance) at pixels (..., 2)."""
    rays = CAMERA.back_project(uv, np.ones(uv.shape[:-1]))
    return distance_m * normal[2] / (rays @ np.array(normal))


def pixel_grid() -> np.ndarray:
    v, u = np.mgrid[:240, :320].astype(float)
    return np.stack([u, v], axis=-1)


def frame_of(depth: np.ndarray) -> RgbdFrame:
    rgb = np.zeros((240, 320, 3), np.uint8)
    return RgbdFrame(0.0, rgb, depth.astype(np.float32), CAMERA, T_WORLD_CAM)


def world_of(uv: np.ndarray, depth: np.ndarray) -> np.ndarray:
    p_cam = CAMERA.back_project(uv, depth)
    return p_cam @ T_WORLD_CAM.rotation().matrix().T + T_WORLD_CAM.translation()


@pytest.mark.parametrize("normal", NORMALS)
def test_points_and_normals_on_a_plane_are_exact_between_pixels(normal: tuple) -> None:
    uv = np.random.default_rng(0).uniform([20, 20], [299, 219], (300, 2))
    planes = depth_planes(frame_of(plane_depth(pixel_grid(), normal)), NOISE)
    at = planes.at(uv)
    np.testing.assert_allclose(at.p_world, world_of(uv, plane_depth(uv, normal)), atol=5e-6)
    want = np.array(normal) / np.linalg.norm(normal) @ T_WORLD_CAM.rotation().matrix().T
    np.testing.assert_allclose(at.normal_world, np.tile(want, (300, 1)), atol=1e-4)
    to_camera = T_WORLD_CAM.translation() - at.p_world
    assert ((to_camera * at.normal_world).sum(axis=1) > 0).all()


def test_noise_along_the_normal_of_a_slanted_wall_worked_by_hand() -> None:
    """A reading is off along its ray; 60 degrees of slant halve that along the normal."""
    normal = (np.sin(np.pi / 3), 0.0, -np.cos(np.pi / 3))
    planes = depth_planes(frame_of(plane_depth(pixel_grid(), normal)), NOISE)
    middle = np.array([[CAMERA.cx, CAMERA.cy]])
    np.testing.assert_allclose(
        planes.at(middle).sigma_normal_m, 0.5 * NOISE.sigma_m(np.ones(1), CAMERA.fx), rtol=1e-4
    )


def test_smoothing_leaves_half_the_noise_and_no_bias(depth_noise_image) -> None:
    exact = plane_depth(pixel_grid(), NORMALS[2], 1.2)
    noisy = exact + depth_noise_image(np.random.default_rng(3), exact, CAMERA.fx)
    planes = depth_planes(frame_of(noisy), NOISE)
    assert planes.valid[8:-8, 8:-8].mean() > 0.98
    e = (1 / planes.inverse_depth - exact)[planes.valid]
    raw = (noisy - exact)[planes.valid]
    assert e.std() < 0.5 * raw.std()
    assert abs(e.mean()) < 0.05 * raw.std()
    normals = planes.at(pixel_grid()[planes.valid]).normal_world
    want = np.array(NORMALS[2]) / np.linalg.norm(NORMALS[2]) @ T_WORLD_CAM.rotation().matrix().T
    angle_deg = np.degrees(np.arccos(np.clip(normals @ want, -1, 1)))
    assert np.median(angle_deg) < 6.0


def test_no_plane_across_a_step_nor_at_flying_pixels(depth_noise_image) -> None:
    rng = np.random.default_rng(2)
    depth = np.where(pixel_grid()[..., 0] < 160, 1.0, 1.03)
    depth = depth + depth_noise_image(rng, depth, CAMERA.fx)
    flying = rng.random(depth.shape) < 0.03
    planes = depth_planes(frame_of(np.where(flying, depth + 0.05, depth)), NOISE)
    assert planes.valid[:, 158:162].mean() < 0.03
    assert not planes.valid[flying].any()
    assert planes.valid[20:-20, 20:140][~flying[20:-20, 20:140]].mean() > 0.95
    left, right = planes.inverse_depth[:, :160], planes.inverse_depth[:, 160:]
    error = np.concatenate(
        [
            1 / left[planes.valid[:, :160]] - 1.0,
            1 / right[planes.valid[:, 160:]] - 1.03,
        ]
    )
    assert np.percentile(np.abs(error), 99.9) < 0.006


def test_windows_end_at_the_mask() -> None:
    """Beside a step only the masked side is fitted, right up to its border."""
    depth = np.where(pixel_grid()[..., 0] < 160, 1.0, 1.3)
    mask = pixel_grid()[..., 0] < 160
    planes = depth_planes(frame_of(depth), NOISE, mask)
    assert planes.valid[20:-20, 20:158].all()
    assert not planes.valid[:, 160:].any()
    np.testing.assert_allclose(planes.inverse_depth[planes.valid], 1.0, rtol=1e-5)


def test_outside_the_image_and_without_depth_there_is_nothing() -> None:
    depth = np.ones((240, 320))
    depth[:, :100] = np.nan
    planes = depth_planes(frame_of(depth), NOISE)
    uv = np.array([[50.0, 120.0], [-3.0, 120.0], [320.0, 120.0], [np.nan, 4.0], [200.0, 120.0]])
    at = planes.at(uv)
    np.testing.assert_array_equal(np.isfinite(at.p_world).all(axis=1), [0, 0, 0, 0, 1])
    np.testing.assert_array_equal(np.isfinite(at.normal_world).all(axis=1), [0, 0, 0, 0, 1])
    np.testing.assert_array_equal(np.isfinite(at.sigma_normal_m), [0, 0, 0, 0, 1])


def test_an_empty_mask_gives_no_planes_and_a_wrong_one_is_refused() -> None:
    frame = frame_of(np.ones((240, 320)))
    assert not depth_planes(frame, NOISE, np.zeros((240, 320), bool)).valid.any()
    with pytest.raises(ValueError, match="expected"):
        depth_planes(frame, NOISE, np.ones((10, 10), bool))


def test_a_surface_seen_edge_on_is_no_plane() -> None:
    slope = DepthPlanesConfig().max_slope
    for tangent, seen in ((0.9 * slope, True), (1.1 * slope, False)):
        depth = plane_depth(pixel_grid(), (tangent, 0.0, -1.0))
        frame = frame_of(np.where((depth > 0.3) & (depth < 3), depth, np.nan))
        assert depth_planes(frame, NOISE).valid[118, 161] == seen


def test_the_bounding_box_holds_the_mask_and_its_margin() -> None:
    mask = np.zeros((20, 30), bool)
    mask[5, 7] = mask[9, 29] = True
    assert bounding_box(mask, 2) == np.s_[3:12, 5:32]
    assert bounding_box(np.zeros((20, 30), bool), 2) is None
