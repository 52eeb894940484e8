"""What counts as a change of depth: a board before a wall, seen face on by a camera at rest."""

import gtsam
import numpy as np
import pytest

from akm_fg.perception.change.depth_change import (
    DepthChange,
    DepthChangeConfig,
    depth_change,
    explained_share,
    surface_points,
)
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import PinholeCamera, Recording, RgbdFrame
from akm_fg.steps import to_end

FX = 600.0
CAMERA = PinholeCamera(640, 480, FX, FX, 319.5, 239.5)
BOARD = (slice(150, 330), slice(200, 440))  # 0.3 m x 0.4 m at 1 m
NOISE = DepthNoiseModel()


def compared(
    nearer_m: float, z_m: float = 1.0, sigma_m: float = 0.0, noise: DepthNoiseModel = NOISE
) -> DepthChange:
    """A wall, and a second frame in which the board has come nearer (or gone back, below 0)."""
    rng = np.random.default_rng(0)
    rgb, frames = np.zeros((480, 640, 3), np.uint8), []
    for moved in (0.0, nearer_m):
        depth = np.full((480, 640), z_m)
        depth[BOARD] -= moved
        depth += sigma_m * rng.standard_normal(depth.shape)
        frames.append(RgbdFrame(moved, rgb, depth.astype(np.float32), CAMERA, gtsam.Pose3()))
    everywhere = np.ones((480, 640), bool)
    return to_end(depth_change(Recording("board", tuple(frames)), everywhere, noise))


@pytest.mark.parametrize("z_m", [0.7, 1.0, 2.0])
def test_what_moves_by_six_deviations_of_a_mean_and_the_systematic_error_has_changed(z_m: float):
    """sd of a reading 0.08 px z^2 / (600 px * 0.095 m), of a change sqrt 2 of it; the mean of a
    window of 9 px has (9 / 5)^2 = 3.24 independent ones. Systematic errors are 5 mm.
    """
    sd_m = np.sqrt(2) * np.hypot(0.08 * z_m**2 / (FX * 0.095), 0.0005) / np.sqrt(3.24)
    for sign, image in ((1, "nearer"), (-1, "farther")):
        enough, little = (compared(sign * (0.005 + k * sd_m), z_m) for k in (6.0, 0.5))
        seen = getattr(enough, image)[1]
        board = np.zeros((480, 640), bool)
        board[BOARD] = True
        board = board[::3, ::3]
        assert (seen & board).sum() > 0.9 * board.sum()
        assert not (seen & ~board).any()
        other = {"nearer": "farther", "farther": "nearer"}[image]
        assert not getattr(enough, other).any()
        assert not little.nearer.any() and not little.farther.any()


def test_noise_alone_changes_nothing_also_where_it_is_twice_what_is_claimed():
    for factor in (1.0, 2.0):
        sigma_m = factor * float(NOISE.sigma_m(np.array(1.0), FX))
        still = compared(0.0, sigma_m=sigma_m)
        assert not still.nearer.any() and not still.farther.any()


def test_the_changed_area_is_that_of_the_board():
    """180 x 240 px at 0.95 m: 0.285 m x 0.38 m."""
    change = compared(0.05)
    whole = (180 / FX * 0.95) * (240 / FX * 0.95)
    np.testing.assert_allclose(change.area_m2[1], whole, rtol=0.02)
    np.testing.assert_allclose(change.mask(1).mean() * 480 * 640, change.nearer[1].sum() * 9)


@pytest.mark.parametrize(("side_px", "seen"), [(15, False), (36, True)])
def test_a_change_smaller_than_furniture_is_none(side_px: int, seen: bool):
    """At 1 m a pixel is 1.67 mm wide: 2.5 cm squared are 6 cm^2 of the 15 asked for, 6 cm 36."""
    rgb, frames = np.zeros((480, 640, 3), np.uint8), []
    for moved in (0.0, 0.05):
        depth = np.full((480, 640), 1.0, np.float32)
        depth[201 : 201 + side_px, 300 : 300 + side_px] -= moved
        frames.append(RgbdFrame(moved, rgb, depth, CAMERA, gtsam.Pose3()))
    everywhere = np.ones((480, 640), bool)
    change = to_end(depth_change(Recording("x", tuple(frames)), everywhere, NOISE))
    assert bool(change.nearer.any()) is seen


def test_a_pixel_that_is_compared_lies_where_it_lay_in_the_whole_image():
    """Every third pixel from the first on, centres at integers: (u, v) was (3 u, 3 v)."""
    change = compared(0.05)
    assert change.stride == 3
    few = np.array([[0.0, 0.0], [100.0, 20.0], [213.0, 159.0]])
    np.testing.assert_allclose(
        change.camera.back_project(few, np.ones(3)), CAMERA.back_project(3 * few, np.ones(3))
    )
    p_world = surface_points(change, 1, change.nearer[1])
    v, u = np.nonzero(change.nearer[1])
    low, high = 3 * np.array([u.min(), v.min()]), 3 * np.array([u.max(), v.max()])
    corners = CAMERA.back_project(np.array([low, high], float), np.full(2, 0.95))
    assert (p_world >= corners[0] - 1e-6).all() and (p_world <= corners[1] + 1e-6).all()
    np.testing.assert_allclose(p_world[0, 1], corners[0, 1], atol=1e-6)


def test_the_boards_own_motion_explains_the_change_and_another_does_not():
    change = compared(0.05)
    R, known = np.tile(np.eye(3), (2, 1, 1)), np.ones(2, bool)
    right = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.05]])
    assert explained_share(change, R, right, known) > 0.95
    assert explained_share(change, R, -right, known) < 0.3
    assert explained_share(change, R, 0.4 * right, known) < 0.3


def test_a_mask_of_another_size_is_refused():
    frames = (RgbdFrame(0.0, np.zeros((480, 640, 3), np.uint8),
                        np.ones((480, 640), np.float32), CAMERA, gtsam.Pose3()),)  # fmt: skip
    with pytest.raises(ValueError, match="expected"):
        to_end(depth_change(Recording("x", frames), np.ones((4, 4), bool), NOISE))


def lifted(gaps_px: list[int]) -> DepthChange:
    """A wall with the board as the object, and plates that stand so many pixels above it."""
    rgb, frames = np.zeros((480, 640, 3), np.uint8), []
    for i, gap in enumerate([None, *gaps_px]):
        depth = np.full((480, 640), 1.5, np.float32)
        depth[BOARD] = 1.0
        if gap is not None:
            bottom = BOARD[0].start - gap
            depth[bottom - 60 : bottom, BOARD[1]] = 0.9
        frames.append(RgbdFrame(float(i), rgb, depth, CAMERA, gtsam.Pose3()))
    mask = np.zeros((480, 640), bool)
    mask[BOARD] = True
    return to_end(depth_change(Recording("lid", tuple(frames)), mask, NOISE))


def test_a_lid_that_stands_above_its_box_belongs_to_it_and_what_is_farther_away_does_not():
    """The edge of a lid and its shadow have no depth: a dozen pixels lie between it and its box."""
    assert lifted([12]).nearer[1].any()
    assert not lifted([40]).nearer[1].any()


def test_what_was_beside_the_object_a_frame_before_belongs_to_it():
    assert lifted([12, 40]).nearer[2].any()


def test_a_part_that_is_small_in_the_picture_is_compared_more_closely():
    """A lid of 75 x 7 px that has come nearer by 0.2 m before a wall at 2.8 m: 33 x 3 cm."""

    def seen(pitch_m: float) -> DepthChange:
        rgb, frames = np.zeros((480, 640, 3), np.uint8), []
        for moved in (0.0, 0.2):
            depth = np.full((480, 640), 2.8, np.float32)
            depth[199:206, 300:375] -= moved
            frames.append(RgbdFrame(moved, rgb, depth, CAMERA, gtsam.Pose3()))
        recording, config = Recording("lid", tuple(frames)), DepthChangeConfig(pitch_m=pitch_m)
        return to_end(depth_change(recording, np.ones((480, 640), bool), NOISE, config))

    close, wide = seen(DepthChangeConfig().pitch_m), seen(1.0)
    assert (close.stride, wide.stride) == (2, 3)
    assert close.nearer[1].any() and not wide.nearer[1].any()
