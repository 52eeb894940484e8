"""Colour and depth of different cameras: on planes whose depth is known at every ray."""

from __future__ import annotations

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.io.sources.registration import Registration
from akm_fg.io.sources.source import Lens
from akm_fg.records import PinholeCamera

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
COLOUR = PinholeCamera(320, 240, 300.0, 298.0, 161.0, 118.0)
BROWN = (0.12, -0.2, 0.002, -0.001, 0.05)
FISHEYE = (0.02, -0.01, 0.003, 0.0)
T_COLOUR_DEPTH = gtsam.Pose3(gtsam.Rot3.Ypr(0.02, -0.01, 0.015), np.array([0.05, 0.004, -0.01]))
NORMAL, DISTANCE = np.array([0.25, -0.15, -1.0]), 1.2  # of the wall, in colour's frame
NEAR = 0.7  # of the board before it, half of the picture


def rays_of(lens: Lens) -> np.ndarray:
    """(H, W, 3) at depth 1, by OpenCV."""
    c = lens.camera
    v, u = np.mgrid[: c.height, : c.width].astype(float)
    K = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])
    uv = np.stack([u, v], -1).reshape(-1, 1, 2)
    if lens.fisheye:
        xy = cv2.fisheye.undistortPoints(uv, K, np.array(lens.distortion))
    else:
        xy = cv2.undistortPointsIter(
            uv, K, np.array(lens.distortion or np.zeros(5)), None, None, (3, 100, 1e-12)
        )
    xy = xy.reshape(c.height, c.width, 2)
    return np.concatenate([xy, np.ones((*xy.shape[:2], 1))], -1)


def wall(lens: Lens, T_colour_cam: gtsam.Pose3 | None = None) -> np.ndarray:
    """Depth (H, W) of the wall as a lens sees it."""
    T = T_colour_cam or gtsam.Pose3()
    rays = rays_of(lens) @ T.rotation().matrix().T
    return -(DISTANCE + NORMAL @ T.translation()) / (rays @ NORMAL)


def painted(p: np.ndarray) -> np.ndarray:
    """Colour (..., 3) of a point of the wall."""
    waves = np.stack([np.sin(9 * p[..., 0]), np.cos(8 * p[..., 1]), np.sin(7 * p.sum(-1))], -1)
    return np.rint(127 + 100 * waves).astype(np.uint8)


def photo(lens: Lens) -> np.ndarray:
    return painted(rays_of(lens) * wall(lens)[..., None])


def depth_lens(scale: float, bends: tuple[float, ...] = (), fisheye: bool = False) -> Lens:
    width, height = round(320 * scale), round(240 * scale)
    f = 300.0 * scale * 0.9
    return Lens(PinholeCamera(width, height, f, f, width / 2 - 1, height / 2 + 1), bends, fisheye)


@pytest.mark.parametrize("bends", [(), BROWN])
@pytest.mark.parametrize("scale", [1.0, 2.0, 0.6])
@pytest.mark.parametrize("apart", [True, False])
def test_depth_of_another_camera_is_found_at_the_colour_pixels(bends, scale, apart):
    T = T_COLOUR_DEPTH if apart else None
    colour, depth = Lens(COLOUR), depth_lens(scale, bends)
    registration = Registration(colour, depth, T)
    got = registration.depth(wall(depth, T).astype(np.float32))
    true = wall(Lens(registration.camera))
    known = np.isfinite(got)
    assert known[20:-20, 40:-20].mean() > 0.97
    np.testing.assert_allclose(got[known], true[known], rtol=4e-4)  # half a pixel beyond the rim


@pytest.mark.parametrize(("bends", "fisheye"), [(BROWN, False), (FISHEYE, True)])
def test_distortion_is_removed_from_colour_and_registered_depth(bends, fisheye):
    lens = Lens(COLOUR, bends, fisheye)
    registration = Registration(lens, lens)
    assert registration.camera == COLOUR and registration.largest_bend_px() > 1.0
    rgb = registration.colour(photo(lens))
    depth = registration.depth(wall(lens).astype(np.float32))
    inner = np.s_[30:-30, 30:-30]
    off = np.abs(rgb[inner].astype(int) - photo(Lens(COLOUR))[inner])
    assert off.max() <= 3
    assert np.abs(photo(lens)[inner].astype(int) - photo(Lens(COLOUR))[inner]).max() > 10
    np.testing.assert_allclose(depth[inner], wall(Lens(COLOUR))[inner], rtol=2e-4)


def test_what_needs_nothing_is_left_as_it_is():
    registration = Registration(Lens(COLOUR), Lens(COLOUR))
    rgb, depth = photo(Lens(COLOUR)), wall(Lens(COLOUR)).astype(np.float32)
    depth[3, 4] = np.nan
    assert not registration.changes_depth and registration.reduction == 1
    np.testing.assert_array_equal(registration.colour(rgb), rgb)
    np.testing.assert_array_equal(registration.depth(depth), depth)


def test_colour_is_reduced_to_the_resolution_of_coarse_depth():
    coarse = Lens(PinholeCamera(80, 60, 75.0, 74.5, (161 + 0.5) / 4 - 0.5, (118 + 0.5) / 4 - 0.5))
    registration = Registration(Lens(COLOUR), coarse)
    assert registration.reduction == 4
    assert (registration.camera.width, registration.camera.height) == (80, 60)
    reduced = Lens(registration.camera)
    got = registration.depth(wall(coarse).astype(np.float32))
    np.testing.assert_allclose(got, wall(reduced), rtol=1e-4)
    rgb = registration.colour(photo(Lens(COLOUR))).astype(int)
    assert np.abs(rgb - painted(rays_of(reduced) * wall(reduced)[..., None])).max() <= 4


def board_and_wall(lens: Lens, T_colour_cam: gtsam.Pose3) -> np.ndarray:
    """Depth with a board that ends at x = 0 of colour's frame before the wall."""
    rays = rays_of(lens) @ T_colour_cam.rotation().matrix().T
    behind, t = wall(lens, T_colour_cam), T_colour_cam.translation()
    z = (NEAR - t[2]) / rays[..., 2]
    return np.where(t[0] + z * rays[..., 0] < 0, z, behind)


@pytest.mark.parametrize("scale", [1.0, 0.6])
def test_at_an_edge_depth_is_of_one_surface_or_unknown(scale):
    depth = depth_lens(scale)
    registration = Registration(Lens(COLOUR), depth, T_COLOUR_DEPTH)
    got = registration.depth(board_and_wall(depth, T_COLOUR_DEPTH).astype(np.float32))
    true = board_and_wall(Lens(registration.camera), gtsam.Pose3())
    board, behind = np.full_like(true, NEAR), wall(Lens(registration.camera))
    known = np.isfinite(got)
    away = np.minimum(np.abs(got - board), np.abs(got - behind)) / true
    assert away[known].max() < 3e-3
    assert known[20:-20, 40:-20].mean() > 0.85  # what the depth camera does not see is not made up
    wrong = np.abs(got - true) > 0.01 * true
    assert wrong[known].mean() < 0.01
    assert (wrong & known).sum(1).max() <= 3 / scale  # a pixel or two along the edge


def test_unknown_depth_stays_unknown():
    depth = depth_lens(0.6)
    image = wall(depth, T_COLOUR_DEPTH).astype(np.float32)
    image[60:80, 80:110] = np.nan
    got = Registration(Lens(COLOUR), depth, T_COLOUR_DEPTH).depth(image)
    assert 600 < np.isnan(got[40:-40, 60:-40]).sum() < 2500
    assert np.isnan(Registration(Lens(COLOUR), depth, T_COLOUR_DEPTH).depth(image * np.nan)).all()
