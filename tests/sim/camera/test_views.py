"""The fixed camera: one pose for every object, from which the whole of it is seen."""

from __future__ import annotations

import numpy as np
import pytest

from sim.camera.views import FixedViewConfig, fixed_view
from sim.episode import open_world


def test_every_object_is_seen_from_one_place_through_one_lens():
    cameras = []
    for name in ("door", "drawer"):
        with open_world(name, 1, "clean", placement="published") as episode:
            frame = episode.camera.capture()
            cameras.append((frame.camera, frame.T_world_cam.matrix()))
    assert cameras[0][0] == cameras[1][0]
    np.testing.assert_array_equal(cameras[0][1], cameras[1][1])
    np.testing.assert_array_equal(cameras[0][1], fixed_view(FixedViewConfig()).matrix())
    assert cameras[0][0].fy == pytest.approx(425.0)


def test_an_exploration_is_given_no_grasp():
    with open_world("door", 1, "clean", placement="published") as episode:
        with pytest.raises(ValueError, match="no grasp is given"):
            _ = episode.T_world_grasp
        assert episode.world.part_state() == 0.0
