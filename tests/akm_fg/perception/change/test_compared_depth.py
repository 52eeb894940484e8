"""Depth images with holes held against each other: boards before a wall that a camera sees."""

import numpy as np
import pytest

from akm_fg.perception.change.change_config import DepthChangeConfig
from akm_fg.perception.change.compared_depth import (
    behind_what_moves,
    changed,
    compared,
    gate_factor,
)
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import BoolArray

FX, STRIDE = 600.0, 3
SHAPE = (160, 213)  # every third pixel of a VGA image
BOARD = (slice(40, 100), slice(60, 140))
NOISE, CONFIG = DepthNoiseModel(), DepthChangeConfig()


def lost(depth_m: np.ndarray, share: float, seed: int, side: int = 3) -> np.ndarray:
    """The image without a share of its squares, as of a dark surface."""
    small = np.random.default_rng(seed).random([-(-n // side) for n in SHAPE]) < share
    image = depth_m.astype(np.float32)
    image[small.repeat(side, axis=0).repeat(side, axis=1)[: SHAPE[0], : SHAPE[1]]] = np.nan
    return image


def nearer(first_m: np.ndarray, now_m: np.ndarray) -> tuple[BoolArray, float]:
    comparison = compared(first_m, now_m, FX, NOISE, CONFIG)
    factor = gate_factor(comparison, STRIDE, NOISE, CONFIG)
    everywhere = np.ones(SHAPE, bool)
    return changed(comparison, 1, factor, everywhere, STRIDE / FX, CONFIG)


def scene(board_m: float) -> np.ndarray:
    depth = np.full(SHAPE, 1.5)
    depth[BOARD] = board_m
    return depth


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_a_board_of_which_either_image_has_lost_a_share_is_found_whole(share: float):
    """60 x 80 windows' middles, 5 mm wide a metre away: so a metre away, 0.06 m^2 at 0.7 m."""
    first, now = lost(scene(1.0), share, 1), lost(scene(0.7), share, 2)
    found, area_m2 = nearer(first, now)
    board = np.zeros(SHAPE, bool)
    board[BOARD] = True
    inside = board.copy()
    inside[38:42] = inside[98:102] = inside[:, 58:62] = inside[:, 138:142] = False
    assert found[inside].mean() > 0.75
    assert not found[~board].mean() > 0.01
    np.testing.assert_allclose(area_m2, board.sum() * (0.7 * STRIDE / FX) ** 2, rtol=0.3)


def test_a_slanted_board_at_rest_that_is_lost_in_other_patches_each_time_has_not_changed():
    """72 deg off face on: 4.6 mm of depth from one pixel that is compared to the next."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    del v
    slanted = 1.0 + 3.0 * STRIDE / FX * (u - 100) * 0.3
    for seed in range(5):
        found, _ = nearer(lost(slanted, 0.6, seed), lost(slanted, 0.6, 100 + seed))
        assert not found.any()


def test_what_lies_behind_an_unknown_pixel_is_what_several_later_images_show_farthest_away():
    unknown, lid, gone = scene(np.nan), scene(0.8), scene(1.5)
    behind = behind_what_moves([unknown, lid, lid, gone, gone], FX, NOISE, CONFIG)
    np.testing.assert_allclose(behind, 1.5, atol=1e-6)
    assert nearer(behind.astype(np.float32), lid)[0][BOARD].mean() > 0.85


def test_one_image_alone_is_not_believed_to_show_what_lies_behind():
    behind = behind_what_moves([scene(np.nan), scene(np.nan), scene(1.4)], FX, NOISE, CONFIG)
    assert np.isnan(behind[BOARD]).all()


def test_what_the_first_image_knows_stays_as_it_is():
    behind = behind_what_moves([scene(0.8), scene(1.5), scene(1.5)], FX, NOISE, CONFIG)
    np.testing.assert_allclose(behind, scene(0.8).astype(np.float32))
