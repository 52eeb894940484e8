"""Planes of a frame are fitted anew only where more of it is asked for."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import DepthPlanesConfig, depth_planes
from akm_fg.perception.surface import remembered_planes
from akm_fg.perception.surface.remembered_planes import AHEAD_PX, GROWS_PX, RememberedPlanes
from akm_fg.records import PinholeCamera, RgbdFrame

CAMERA = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5)
NOISE, CONFIG = DepthNoiseModel(), DepthPlanesConfig()


def a_frame() -> RgbdFrame:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    depth = (1.0 + 0.001 * u + 0.0005 * v).astype(np.float32)
    rgb = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    return RgbdFrame(0.0, rgb, depth, CAMERA, gtsam.Pose3())


def around(top: int, left: int, size: int = 30) -> np.ndarray:
    mask = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    mask[top : top + size, left : left + size] = True
    return mask


@pytest.fixture
def fits(monkeypatch) -> list[np.ndarray]:
    """The masks that planes were fitted to."""
    masks: list[np.ndarray] = []

    def counted(frame, noise, mask, config):
        masks.append(mask)
        return depth_planes(frame, noise, mask, config)

    monkeypatch.setattr(remembered_planes, "depth_planes", counted)
    return masks


def test_a_frame_is_fitted_once_as_long_as_no_more_is_asked_for(fits):
    frame, planes = a_frame(), RememberedPlanes()
    first = planes.of(frame, NOISE, around(40, 60), CONFIG)
    grown = planes.of(frame, NOISE, around(40 - GROWS_PX, 60), CONFIG)
    assert grown is first and len(fits) == 1
    farther = planes.of(frame, NOISE, around(10, 60), CONFIG)
    assert len(fits) == 2 and farther.valid[18, 75]
    planes.of(frame, NOISE, around(40, 60), CONFIG)
    planes.of(frame, NOISE, np.zeros_like(fits[0]), CONFIG)
    assert len(fits) == 3, "what was fitted last holds less than what is asked for now"


def test_where_it_is_asked_for_it_is_what_the_whole_frame_gives():
    frame, asked = a_frame(), around(40, 60)
    near = RememberedPlanes().of(frame, NOISE, asked, CONFIG)
    whole = depth_planes(frame, NOISE)
    assert near.valid[asked].all()
    for name in ("inverse_depth", "slope_u", "slope_v"):
        assert_allclose(getattr(near, name)[asked], getattr(whole, name)[asked], atol=1e-6)


def test_another_noise_is_another_fit_and_the_oldest_frame_goes(fits):
    planes, (one, two, three) = RememberedPlanes(most=2), (a_frame() for _ in range(3))
    for frame in (one, two, one, three):  # two was not asked for longest
        planes.of(frame, NOISE, around(40, 60), CONFIG)
    assert len(fits) == 3
    planes.of(one, NOISE, around(40, 60), CONFIG)
    assert len(fits) == 3
    planes.of(two, NOISE, around(40, 60), CONFIG)
    assert len(fits) == 4
    planes.of(two, DepthNoiseModel(floor_m=0.002), around(40, 60), CONFIG)
    assert len(fits) == 5


def test_a_frame_that_was_prepared_is_there_when_it_is_asked_for(fits):
    first, later, planes = a_frame(), a_frame(), RememberedPlanes()
    planes.prepare([first])
    assert not fits, "nobody has asked for any place yet"
    planes.of(first, NOISE, around(60, 60), CONFIG)
    planes.prepare([first, later])
    assert len(fits) == 2
    assert planes.of(later, NOISE, around(60 - AHEAD_PX, 60), CONFIG).valid[62, 62]
    assert len(fits) == 2, "a little more of a frame than was asked for before is there, too"
    planes.of(later, replace(NOISE, disparity_sigma_px=0.2), around(60, 60), CONFIG)
    assert len(fits) == 3, "it was fitted for another noise"


def test_frames_that_are_not_kept_are_forgotten(fits):
    first, gone, planes = a_frame(), a_frame(), RememberedPlanes()
    for frame in (first, gone):
        planes.of(frame, NOISE, around(60, 60), CONFIG)
    planes.prepare([first, a_frame()])
    planes.of(first, NOISE, around(60, 60), CONFIG)
    assert len(fits) == 3
    planes.of(gone, NOISE, around(60, 60), CONFIG)
    assert len(fits) == 4
