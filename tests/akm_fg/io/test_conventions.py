"""Poses and depth as a person says they are, against what the file says."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.io.conventions import GL_FROM_CV, InputConventions
from akm_fg.io.inputs import read_input
from akm_fg.io.read_options import ReadOptions
from akm_fg.io.recording import write_recording
from akm_fg.records import PinholeCamera, Recording, RgbdFrame

T_WORLD_CAM = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.8, 1.9), np.array([1.0, -2.0, 0.5]))


def test_a_point_before_an_opengl_camera_has_negative_z_and_y_up():
    below_and_before = np.array([0.1, 0.2, 3.0])  # ours: y down, z forward
    np.testing.assert_allclose(GL_FROM_CV.transformFrom(below_and_before), [0.1, -0.2, -3.0])


@pytest.mark.parametrize("convention", [None, "opencv", "opengl"])
@pytest.mark.parametrize("invert", [None, True])
def test_every_way_to_write_a_pose_gives_the_same_camera(convention, invert):
    written = T_WORLD_CAM * GL_FROM_CV if convention == "opengl" else T_WORLD_CAM
    written = written.inverse() if invert else written
    got = InputConventions(convention, invert).T_world_cam(written)
    np.testing.assert_allclose(got.matrix(), T_WORLD_CAM.matrix(), atol=1e-12)


def test_what_is_said_goes_before_what_a_recording_says(tmp_path: Path):
    camera = PinholeCamera(8, 6, 9.0, 9.0, 4.0, 3.0)
    rgb, depth = np.zeros((6, 8, 3), np.uint8), np.full((6, 8), 1.5, np.float32)
    depth[0, 0] = np.nan
    written = (T_WORLD_CAM * GL_FROM_CV).inverse()
    frames = tuple(RgbdFrame(0.1 * i, rgb, depth, camera, written) for i in range(2))
    write_recording(tmp_path / "a", Recording("a", frames), depth_unit_m=1e-3)
    said = InputConventions("opengl", invert_pose=True, depth_unit_m=2e-4)
    got = read_input(tmp_path / "a", options=ReadOptions(conventions=said))
    for frame in got.frames:
        np.testing.assert_allclose(frame.T_world_cam.matrix(), T_WORLD_CAM.matrix(), atol=1e-12)
        np.testing.assert_allclose(frame.depth_m[1:], 0.3, rtol=1e-6)
        assert np.isnan(frame.depth_m[0, 0])


@pytest.mark.parametrize(("up", "vector"), [("z", (0, 0, 1)), ("-y", (0, -1, 0)), (None, None)])
def test_up_is_an_axis_of_the_world(up, vector):
    got = InputConventions(up=up).up_world
    assert (got is None) if vector is None else np.array_equal(got, vector)


@pytest.mark.parametrize("unit", [0.0, -1.0, np.nan, np.inf])
def test_a_unit_that_is_no_length_is_refused(unit):
    with pytest.raises(ValueError, match="depth_unit_m"):
        InputConventions(depth_unit_m=unit)
