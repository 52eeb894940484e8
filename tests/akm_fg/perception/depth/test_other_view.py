"""A frame carried over to another camera pose shows what is seen from there."""

from dataclasses import replace

import gtsam
import numpy as np

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.object_now import object_now
from akm_fg.perception.depth.other_view import seen_from, stands_still
from tests.akm_fg.conftest import BACKGROUND, Cabinet, render

T_CAM_MOVED = gtsam.Pose3(gtsam.Rot3.Ry(-0.1), np.array([0.15, 0.0, 0.05]))


def other_place(still, q: float = 0.0):
    """Depth and object of the scene from the moved camera."""
    scene: Cabinet = still.scene
    T = scene.T_world_cam * T_CAM_MOVED
    _, depth, label = render(scene.camera, T, scene.at(q))
    return T, depth, label != BACKGROUND


def test_depth_and_mask_are_those_of_the_other_place(still) -> None:
    T, depth, on_object = other_place(still)
    noise_free = replace(still.frames[0], depth_m=still.depth[0].astype(np.float32))
    view = seen_from(noise_free, T)
    known = np.isfinite(view.frame.depth_m)
    assert known.mean() > 0.8
    off = np.abs(view.frame.depth_m - depth)[known]
    assert np.quantile(off, 0.9) < 0.01  # half a pixel of slanted floor
    carried = view.carried(still.labels[0] != BACKGROUND)
    assert (carried & on_object).sum() / (carried | on_object).sum() > 0.9
    np.testing.assert_array_equal(view.frame.T_world_cam.matrix(), T.matrix())


def test_from_the_same_place_it_is_the_same(still) -> None:
    frame = still.frames[0]
    view = seen_from(frame, frame.T_world_cam)
    known = np.isfinite(frame.depth_m)
    np.testing.assert_allclose(view.frame.depth_m[known], frame.depth_m[known], rtol=1e-6)
    np.testing.assert_array_equal(view.frame.rgb[known], frame.rgb[known])


def test_the_object_is_followed_by_a_camera_that_moves(still) -> None:
    T, depth, on_object = other_place(still, q=0.4)
    first = still.frames[0]
    now = replace(first, depth_m=depth.astype(np.float32), T_world_cam=T)
    assert not stands_still((first, now)) and stands_still((first, first))
    mask = object_now(first, still.labels[0] != BACKGROUND, now, DepthNoiseModel())
    assert (mask & on_object).sum() / (mask | on_object).sum() > 0.85
