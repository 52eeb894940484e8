"""A dark board before a bright wall: its depth is lost in patches, and told by what is left."""

import gtsam
import numpy as np
import pytest

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.holes import without_holes
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter
from akm_fg.records import FloatArray, PinholeCamera, RgbdFrame

CAMERA = PinholeCamera(640, 480, 600.0, 600.0, 319.5, 239.5)
NOISE = DepthNoiseModel()
PATCH_PX = 7


def exact(tilt: float = 0.4, wall_m: float = 1.6) -> tuple[FloatArray, FloatArray]:
    """Depth (H, W) of a tilted board before a wall, and where the board is."""
    v, u = np.mgrid[:480, :640]
    board = (np.abs(u - 320) < 90) & (np.abs(v - 240) < 70)
    x = (u - CAMERA.cx) / CAMERA.fx
    return np.where(board, 1.0 / (1.0 + tilt * x), wall_m), board


def seen(known_share: float, tilt: float = 0.4, seed: int = 0) -> tuple[RgbdFrame, FloatArray]:
    """The board with so many of its patches, the wall whole; noise of a stereo camera."""
    rng = np.random.default_rng(seed)
    z, board = exact(tilt)
    kept = rng.random((480 // PATCH_PX + 1, 640 // PATCH_PX + 1)) < known_share
    kept = kept.repeat(PATCH_PX, axis=0).repeat(PATCH_PX, axis=1)[:480, :640]
    noisy = z + rng.standard_normal(z.shape) * NOISE.sigma_m(z, CAMERA.fx)
    depth = np.where(board & ~kept, np.nan, noisy).astype(np.float32)
    return RgbdFrame(0.0, np.zeros((480, 640, 3), np.uint8), depth, CAMERA, gtsam.Pose3()), board


@pytest.mark.parametrize("known_share", (0.15, 0.25, 0.5))
def test_most_of_a_board_that_is_lost_in_patches_is_told_within_the_noise_of_a_reading(
    known_share: float,
) -> None:
    frame, board = seen(known_share)
    filled = without_holes(frame, NOISE)
    lost = board & np.isnan(frame.depth_m)
    told = lost & np.isfinite(filled.depth_m)
    assert told.sum() > 0.5 * lost.sum()
    off = (filled.depth_m - exact()[0])[told] / NOISE.sigma_m(np.array(1.0), CAMERA.fx)
    assert np.sqrt((off**2).mean()) < 1.0
    assert np.abs(off).max() < 8.0  # and nowhere the wall's, 200 off


def test_readings_stay_as_they_are_and_nothing_is_told_beside_the_board() -> None:
    frame, board = seen(0.2)
    filled = without_holes(frame, NOISE)
    known = np.isfinite(frame.depth_m)
    np.testing.assert_array_equal(filled.depth_m[known], frame.depth_m[known])
    assert not (np.isfinite(filled.depth_m) & ~known & ~board).any()


def test_a_whole_picture_is_returned_as_it_is_and_so_is_one_with_one_large_hole() -> None:
    whole, _ = seen(1.0)
    assert without_holes(whole, NOISE) is whole
    masked, _ = seen(0.0)
    assert without_holes(masked, NOISE) is masked


def test_two_boards_that_meet_at_an_edge_are_not_told_as_one_that_lies_between() -> None:
    frame, board = seen(0.25)
    step = np.where(np.mgrid[:480, :640][0] < 240, np.float32(0.0), np.float32(0.15))
    frame = RgbdFrame(0.0, frame.rgb, frame.depth_m + step * board, CAMERA, gtsam.Pose3())
    filled = without_holes(frame, NOISE).depth_m
    off = np.abs(filled - exact()[0])[board & np.isfinite(filled)]
    between = (off > 0.03) & (off < 0.12)
    assert between.mean() < 0.01


def test_the_whole_board_is_the_object_and_not_one_patch_of_it() -> None:
    frame, board = seen(0.25)
    mask = DepthObjectSegmenter().segment(without_holes(frame, NOISE))
    assert (mask & board).sum() > 0.8 * board.sum()


def test_the_ragged_rim_of_what_is_masked_out_is_no_dark_surface() -> None:
    """A robot cut out of a bright wall, its rim gnawed by a camera that loses a third of it."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:480, :640]
    out = np.hypot(u - 320, v - 240) - 120
    lost = (out < 0) | ((out < 6) & (rng.random(out.shape) < 0.35))
    depth = np.where(lost, np.nan, 1.6).astype(np.float32)
    frame = RgbdFrame(0.0, np.zeros((480, 640, 3), np.uint8), depth, CAMERA, gtsam.Pose3())
    assert without_holes(frame, NOISE) is frame
