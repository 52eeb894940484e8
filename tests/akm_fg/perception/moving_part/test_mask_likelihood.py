"""What another frame says of a pixel: a wall seen face on, whose every pixel is known."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.moving_part.mask_likelihood import (
    MaskLikelihoodConfig,
    MaskView,
    PixelLikelihood,
    gather_likelihood,
    mask_view,
    on_background,
)
from akm_fg.records import PinholeCamera, RgbdFrame

W, H, FX = 96, 72, 300.0
CAMERA = PinholeCamera(W, H, FX, FX, (W - 1) / 2, (H - 1) / 2)
CONFIG = MaskLikelihoodConfig()
NOISE = DepthNoiseModel()
WHOLE = (slice(None), slice(None))
INNER = (slice(10, -10), slice(10, -10))
GRAY = np.random.default_rng(0).integers(40, 215, (H, W))


def wall(z_m: float = 1.0, gray: np.ndarray = GRAY) -> MaskView:
    rgb = np.repeat(gray[..., None], 3, axis=2).astype(np.uint8)
    depth = np.full((H, W), z_m, np.float32)
    return mask_view(RgbdFrame(0.0, rgb, depth, CAMERA, gtsam.Pose3()), CONFIG)


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(), np.array([x, y, z]))


def told(view: MaskView, other: MaskView, motion: gtsam.Pose3) -> PixelLikelihood:
    return gather_likelihood(view, WHOLE, [(other, motion)], NOISE, CONFIG)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_point_is_looked_up_in_the_pixel_that_it_falls_into(axis: str, side: float):
    """Pixel centres are at integers: 0.45 px aside is the same pixel, 0.55 px aside the next."""
    view = wall()
    same = told(view, view, moved(**{axis: side * 0.45 / FX}))
    assert_allclose(same.moving, same.static, atol=1e-4)
    step = round(side)
    rolled = np.roll(GRAY, step, axis=1 if axis == "x" else 0)
    next_one = told(view, wall(gray=rolled), moved(**{axis: side * 0.55 / FX}))
    assert_allclose(next_one.moving[INNER], same.static[INNER], atol=1e-3)
    assert next_one.moving[INNER].mean() > next_one.static[INNER].mean() + 1.0


def test_the_ratio_of_depths_is_that_of_a_normal_against_a_range():
    """2 sigma^2 + 3 mm^2 of a difference of two readings, against 0.3 m; no texture."""
    flat = np.full((H, W), 128)
    view, off = wall(gray=flat), 0.004
    variance = 2 * float(NOISE.sigma_m(np.array(1.0), FX)) ** 2 + 0.003**2
    expected = np.log(0.3 / np.sqrt(2 * np.pi * variance)) - off**2 / (2 * variance)
    for sign in (1, -1):
        seen = told(view, wall(1.0 + sign * off, flat), moved(z=sign * off))
        assert_allclose(seen.static, expected, rtol=0.01)
        assert_allclose(seen.moving, expected + off**2 / (2 * variance), rtol=0.01)
        assert_allclose(seen.ratio, seen.moving - seen.static, atol=1e-5)


def test_what_lies_beyond_refutes_and_what_lies_before_only_hides():
    """3 % of readings are wrong: log 0.03 = -3.5; a hidden point says little."""
    flat = np.full((H, W), 128)
    gone, hidden = (told(wall(gray=flat), wall(z, flat), moved()) for z in (1.3, 0.7))
    assert_allclose(gone.static, np.log(0.03), atol=0.1)
    assert_allclose(hidden.static, -0.5)


def test_a_texture_found_again_speaks_for_the_spot_and_another_against_it():
    """log(1 + 2 v / s^2) / 2 of white gray levels, s = 8, after 3 x 3 smoothing; at most 2.5."""
    flat, view = np.full((H, W), 128), wall()
    plain = told(wall(gray=flat), wall(gray=flat), moved()).static
    again = (told(view, view, moved()).static - plain)[INNER]
    v = float(view.texture[INNER].var())
    assert_allclose(again.mean(), np.log(1 + 2 * v / 8.0**2) / 2, rtol=0.05)
    other = wall(gray=np.random.default_rng(9).integers(40, 215, (H, W)))
    unrelated = (told(view, other, moved()).static - plain)[INNER]
    assert unrelated.mean() < 0.0 and unrelated.min() >= -2.5 - 1e-5


def test_no_frame_says_more_than_its_bound_and_two_say_twice_as_much():
    flat = np.full((H, W), 128)
    view, far = wall(gray=flat), wall(1.3, flat)
    one = gather_likelihood(view, WHOLE, [(far, moved(z=0.3))], NOISE, CONFIG)
    assert_allclose(one.ratio, 3.0)
    two = gather_likelihood(view, WHOLE, [(far, moved(z=0.3))] * 2, NOISE, CONFIG)
    assert_allclose(two.ratio, 6.0)


def test_nothing_is_said_where_nothing_is_seen():
    view, blind = wall(), wall(np.nan)
    seen = told(view, blind, moved())
    assert not seen.static.any() and not seen.moving.any()
    beside = told(view, view, moved(x=1.0))  # out of the picture
    assert not beside.moving.any() and beside.static.any()
    behind = told(view, view, moved(z=-2.0))
    assert not behind.moving.any()


def test_pixels_on_the_background_are_found_at_rest_and_moved():
    view, background = wall(), wall(1.05)
    rest = on_background(view, WHOLE, background, None, NOISE, CONFIG)
    assert not rest.any()
    assert on_background(view, WHOLE, background, moved(z=0.05), NOISE, CONFIG).all()
    assert on_background(view, WHOLE, wall(), moved(z=0.3), NOISE, CONFIG).all()
