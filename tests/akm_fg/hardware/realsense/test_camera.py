"""The camera against librealsense's software device, and a recording that was made of it."""

from __future__ import annotations

import importlib.util
import time
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.arm.depth_from_arm import DepthCorrection
from akm_fg.errors import CameraFailed, InputError, MissingDependency
from akm_fg.hardware.mounted_camera import read_mounted_camera
from akm_fg.hardware.realsense.camera import RealSenseCamera
from akm_fg.hardware.realsense.config import RealSenseConfig
from akm_fg.hardware.realsense.streams import RealSenseStreams
from akm_fg.io.sources.source import Lens
from akm_fg.records import PinholeCamera
from tests.akm_fg.hardware.calibration_file import write_calibration
from tests.akm_fg.hardware.software_realsense import SoftwareRealSense

COLOUR = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5)
DEPTH = PinholeCamera(212, 120, 105.0, 105.0, 105.5, 59.5)
BESIDE_M = 0.015  # the depth camera's place, right of the colour camera
PATIENT = RealSenseConfig(patience_s=5.0)
T_WORLD_CAM = gtsam.Pose3(gtsam.Rot3.RzRyRx(-2.0, 0.1, -1.5), np.array([0.1, -0.6, 0.9]))

needs_library = pytest.mark.skipif(
    importlib.util.find_spec("pyrealsense2") is None,
    reason="pyrealsense2 is not installed: `make test-hardware` installs it",
)


def numbered(number):
    """A wall whose distance and colour say which picture it is."""
    rgb = np.full((COLOUR.height, COLOUR.width, 3), number % 250, np.uint8)
    return rgb, np.full((DEPTH.height, DEPTH.width), 1000 + number, np.uint16)


def step(number):
    """A wall at 1 m, and right of the optical axis one at 2 m, for the depth camera; a hole."""
    rgb, depth_mm = numbered(number)
    depth_mm[:] = 1000
    depth_mm[:, 106:] = 2000
    depth_mm[:20] = 0
    return rgb, depth_mm


@pytest.fixture
def mounted(tmp_path):
    return read_mounted_camera(write_calibration(tmp_path / "rig.json", COLOUR, T_WORLD_CAM))


@needs_library
def test_a_frame_was_taken_after_it_was_asked_for(mounted):
    with (
        SoftwareRealSense(numbered, COLOUR, DEPTH) as real,
        RealSenseCamera(mounted, None, PATIENT, real.device) as camera,
    ):
        camera.capture()
        time.sleep(0.3)  # pictures of the past are waiting now
        asked_s = time.monotonic()
        frame = camera.capture()
        number = round(float(np.nanmedian(frame.depth_m)) * 1000.0) - 1000
        assert real.fed_s[number] >= asked_s
        assert frame.rgb[60, 80, 0] == number % 250
        assert frame.stamp_s == pytest.approx(number / 30.0)
        assert frame.T_world_cam.equals(T_WORLD_CAM, 1e-12)


@needs_library
def test_depth_is_registered_to_colour_and_unknown_is_nan(mounted):
    with (
        SoftwareRealSense(step, COLOUR, DEPTH, BESIDE_M) as real,
        RealSenseCamera(mounted, None, PATIENT, real.device) as camera,
    ):
        frame = camera.capture()
    # The near wall ends at x = 0.005 m before the depth camera, 0.02 m before the colour camera.
    edge_px = COLOUR.fx * (BESIDE_M + 0.5 / DEPTH.fx) / 1.0 + COLOUR.cx
    row = frame.depth_m[60]
    near = np.flatnonzero(np.abs(row - 1.0) < 1e-3)
    assert near.max() == pytest.approx(edge_px, abs=1.5)
    assert np.nanmax(row) == pytest.approx(2.0, abs=1e-3)
    assert np.isnan(frame.depth_m[0]).all()


@needs_library
def test_the_robot_is_taken_out_of_every_frame(mounted):
    def without_left_half(frame):
        depth_m = frame.depth_m.copy()
        depth_m[:, :80] = np.nan
        return replace(frame, depth_m=depth_m)

    with (
        SoftwareRealSense(numbered, COLOUR, DEPTH) as real,
        RealSenseCamera(mounted, without_left_half, PATIENT, real.device) as camera,
    ):
        depth_m = camera.capture().depth_m
    assert np.isnan(depth_m[:, :80]).all()
    assert np.isfinite(depth_m[60, 80:]).all()


@needs_library
def test_a_correction_of_depth_is_made_before_the_robot_is_taken_out(mounted):
    def farther_than_2m(frame):
        return replace(frame, depth_m=np.where(frame.depth_m > 2.0, np.nan, frame.depth_m))

    with (
        SoftwareRealSense(step, COLOUR, DEPTH) as real,
        RealSenseCamera(mounted, farther_than_2m, PATIENT, real.device) as camera,
    ):
        before = camera.capture().depth_m
        camera.correct_depth(DepthCorrection(0.01, 0.002, np.eye(2), 40))
        measured, after = camera.measured().depth_m, camera.capture().depth_m
    assert np.nanmax(before) == pytest.approx(2.0, abs=1e-3)
    assert np.nanmax(measured) == pytest.approx(2.0, abs=1e-3)  # as it comes
    near = np.abs(before - 1.0) < 1e-3
    np.testing.assert_allclose(after[near], 1.01 * before[near] + 0.002, rtol=1e-5)
    assert np.nanmax(after) < 2.0  # the wall, by its corrected depth


@needs_library
def test_a_camera_that_falls_silent_is_one_line(mounted):
    impatient = RealSenseConfig(patience_s=0.4)
    with (
        SoftwareRealSense(numbered, COLOUR, DEPTH) as real,
        RealSenseCamera(mounted, None, impatient, real.device) as camera,
    ):
        camera.capture()
        real.fall_silent()
        with pytest.raises(CameraFailed, match="no picture") as failed:
            camera.capture()
            camera.capture()
    assert "\n" not in str(failed.value)


@needs_library
def test_pictures_of_another_size_than_calibrated_are_refused():
    real = SoftwareRealSense(numbered, COLOUR, DEPTH)
    with pytest.raises(CameraFailed, match="no colour pictures of 640x480"):
        RealSenseStreams((640, 480), PATIENT, real.device).__enter__()


@needs_library
def test_a_calibration_of_another_camera_is_refused(mounted):
    other = replace(mounted, lens=Lens(replace(COLOUR, fx=190.0, fy=190.0)))
    real = SoftwareRealSense(numbered, COLOUR, DEPTH)
    with pytest.raises(CameraFailed, match="is not of this camera"):
        RealSenseCamera(other, None, PATIENT, real.device).__enter__()


@needs_library
def test_a_recording_of_it_is_a_camera_too(mounted, tmp_path):
    import pyrealsense2 as rs

    path = SoftwareRealSense(numbered, COLOUR, DEPTH).recorded(tmp_path / "rig.db3", 20)
    device = rs.context().load_device(str(path))
    with RealSenseCamera(mounted, None, PATIENT, device) as camera:
        frame = camera.capture()
    number = round(float(np.nanmedian(frame.depth_m)) * 1000.0) - 1000
    assert 1 <= number <= 20
    assert frame.rgb[60, 80, 0] == number


@needs_library
def test_a_recording_of_it_is_read_by_the_reader_of_recordings(tmp_path):
    from akm_fg import read_recording

    path = SoftwareRealSense(numbered, COLOUR, DEPTH).recorded(tmp_path / "rig.db3", 20)
    frames = read_recording(path).frames
    assert len(frames) > 10 and frames[0].camera == COLOUR
    numbers = [int(frame.rgb[60, 80, 0]) for frame in frames]
    assert numbers == sorted(set(numbers)) and 1 <= numbers[0] and numbers[-1] <= 20
    for number, frame in zip(numbers, frames, strict=True):
        assert np.nanmedian(frame.depth_m) == pytest.approx(1.0 + 0.001 * number, abs=1e-6)
        assert frame.stamp_s - frames[0].stamp_s == pytest.approx((number - numbers[0]) / 30.0)


@needs_library
def test_no_camera_is_one_line():
    import pyrealsense2 as rs

    if len(rs.context().query_devices()):
        pytest.skip("a RealSense is connected to this computer")
    with pytest.raises(CameraFailed, match="no RealSense is connected"):
        RealSenseStreams((640, 480)).__enter__()


def test_an_absent_library_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingDependency, match=r"install akm-fg\[hardware\]"):
        RealSenseStreams((640, 480))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"schema": "akm-fg/recording/1"}, "its schema is"),
        ({"camera_place": "gripper"}, "camera in the gripper"),
        ({"T_world_cam_cov": np.diag([-1.0] * 6).tolist()}, "no less than 0"),
        ({"T_world_cam": [[0.0] * 4] * 4}, "is not a rotation"),
    ],
)
def test_a_calibration_that_is_none_is_refused(tmp_path, change, says):
    path = write_calibration(tmp_path / "rig.json", COLOUR, T_WORLD_CAM, change)
    with pytest.raises(InputError, match=says):
        read_mounted_camera(path)


def test_the_calibrations_uncertainty_goes_along(mounted):
    assert mounted.errors.cov_world_cam[3, 3] == pytest.approx(1e-6)
    assert mounted.errors.cov_intrinsics is not None
    assert mounted.errors.depth_scale_sd == pytest.approx(0.01)
    assert 0.0 <= mounted.age_days() < 1.0
