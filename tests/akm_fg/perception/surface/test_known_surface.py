"""A known surface is found again from several states at once as from each alone."""

import gtsam
import numpy as np
import pytest

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.surface.known_surface import KnownSurface, KnownSurfaceConfig
from akm_fg.records import PinholeCamera, RgbdFrame
from factors.joint import Joint

CAMERA = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5)
NOISE, CONFIG = DepthNoiseModel(), KnownSurfaceConfig()
OUT_M = 0.07  # the drawer's front has come towards the camera


def drawer() -> KnownSurface:
    """A front of 20 cm, a metre before the camera, that slides towards it."""
    T_world_joint = gtsam.Pose3(gtsam.Rot3.Ry(np.pi), np.array([0.0, 0.0, 1.0])).matrix()
    side = np.linspace(-0.1, 0.1, 12)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    points = np.stack([x, y, np.ones_like(x)], axis=1)
    return KnownSurface(
        Joint("prismatic", T_world_joint, 0.0), points, np.tile([0.0, 0.0, -1.0], (len(x), 1))
    )


def opened() -> RgbdFrame:
    depth = np.full((CAMERA.height, CAMERA.width), 1.3, np.float32)
    half = round(0.11 / (1.0 - OUT_M) * CAMERA.fx)
    depth[60 - half : 60 + half, 80 - half : 80 + half] = 1.0 - OUT_M
    rgb = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    return RgbdFrame(0.0, rgb, depth, CAMERA, gtsam.Pose3())


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (1, 3, 0, 2)])
def test_of_several_starts_the_one_that_finds_the_part_counts(order):
    starts = np.array([-0.2, 0.05, 0.3, 0.6])[list(order)]
    found = drawer().solved(opened(), NOISE, starts, CONFIG)
    assert found.q == pytest.approx(OUT_M, abs=1e-4)
    assert found.found == found.good.sum() == 144
    assert found.along_m == pytest.approx(1.0)
    (alone,) = (drawer().solved(opened(), NOISE, np.array([0.05]), CONFIG),)
    assert (found.q, found.information) == pytest.approx((alone.q, alone.information))


def test_from_where_nothing_is_seen_nothing_is_found():
    found = drawer().solved(opened(), NOISE, np.array([-0.2, 0.9]), CONFIG)
    assert found.found == 0 and found.information == 0.0 and found.q == -0.2
