"""Recordings of a board are read, and calibrations go into JSON and into recordings."""

import json
from dataclasses import replace

import cv2
import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.calibration.board_file import opencv_board
from akm_fg.calibration.calibrate import calibrate
from akm_fg.calibration.read import read_calibration_views
from akm_fg.calibration.records import BoardSpec, CalibrationConfig
from akm_fg.calibration.result_json import (
    calibration_as_line,
    largest_distortion_px,
    write_into_recording,
)
from akm_fg.errors import InputError

BOARD = BoardSpec(7, 5, 0.04, 0.03, "DICT_4X4_50")
CAMERA = {"width": 320, "height": 240, "fx": 300, "fy": 300, "cx": 159.5, "cy": 119.5}
POSES = [gtsam.Pose3(gtsam.Rot3.Rx(0.1 * i), np.array([0.0, 0.1 * i, 0.0])) for i in range(3)]


@pytest.fixture
def recording(tmp_path):
    """Three images of 320 x 240; the second is empty."""
    (tmp_path / "rgb").mkdir()
    drawn = opencv_board(BOARD).generateImage((280, 200))
    image = _framed(drawn)
    for i, picture in enumerate((image, np.full_like(image, 255), image)):
        cv2.imwrite(str(tmp_path / "rgb" / f"{i:06d}.png"), picture)
    describe(tmp_path)
    return tmp_path


def _framed(drawn):
    """With a white rim of 20 pixels."""
    return cv2.copyMakeBorder(drawn, 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=255)


def describe(folder, **changes):
    """Writes recording.json; a change to None leaves the field out."""
    fields = {
        "schema": "akm-fg/recording/1",
        "camera": CAMERA,
        "stamps_s": [0, 1, 2],
        "T_world_gripper": [T.matrix().tolist() for T in POSES],
        "truth": None,
    }
    fields.update(changes)
    kept = {name: value for name, value in fields.items() if value is not None}
    (folder / "recording.json").write_text(json.dumps(kept))


def test_views_come_with_their_poses_and_empty_images_are_skipped(recording):
    """No depth and no camera pose are needed."""
    data = read_calibration_views(recording, BOARD)
    assert [view.frame for view in data.views] == [0, 2] and data.skipped == (1,)
    assert all(view.corners.size == 24 for view in data.views)
    assert data.views[1].T_world_gripper.equals(POSES[2], 1e-12)
    # The drawing is 1000 pixels a metre, 20 pixels of rim, pixel centres at integers.
    expected = 1000.0 * BOARD.corners_m()[:, :2] + 20.0 - 0.5
    assert_allclose(data.views[0].uv, expected[data.views[0].corners], atol=0.1)


@pytest.mark.parametrize("printed", [True, False])
def test_a_board_of_the_other_pattern_is_recognised_and_named(recording, printed):
    board = replace(BOARD, squares_y=6, legacy_pattern=printed)
    drawn = opencv_board(board).generateImage((280, 240))
    for i in range(3):
        cv2.imwrite(str(recording / "rgb" / f"{i:06d}.png"), _framed(drawn))
    describe(recording, camera={**CAMERA, "height": 280})
    said = replace(board, legacy_pattern=not printed)
    data = read_calibration_views(recording, said)
    assert len(data.views) == 3 and data.board == board
    assert f'"legacy_pattern": {str(printed).lower()}' in data.notes[0]
    right = read_calibration_views(recording, board)
    assert right.notes == ()
    assert_allclose(data.views[0].uv, right.views[0].uv)


def test_an_image_without_the_board_anywhere_says_what_was_seen(recording):
    other = replace(BOARD, squares_x=9, squares_y=6)
    with pytest.raises(InputError, match=r"in none of 3 images; \d+ of its markers were read"):
        read_calibration_views(recording, other)
    with pytest.raises(InputError, match=r"none of its markers was read"):
        read_calibration_views(recording, replace(BOARD, dictionary="DICT_7X7_50"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T_world_gripper": None}, "`T_world_gripper` is missing"),
        ({"T_world_gripper": [np.eye(4).tolist()] * 2}, "`T_world_gripper` lists 2 poses"),
        ({"T_world_gripper": [(2 * np.eye(4)).tolist()] * 3}, "is not a rotation"),
        ({"camera": {"width": 320}}, "`camera.height` is missing"),
        ({"schema": "other"}, "`schema` is 'other'"),
    ],
)
def test_a_description_that_does_not_do_gets_one_line(recording, changes, message):
    describe(recording, **changes)
    with pytest.raises(InputError) as caught:
        read_calibration_views(recording, BOARD)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_an_image_that_is_missing_is_named(recording):
    (recording / "rgb" / "000001.png").unlink()
    with pytest.raises(InputError, match=r"000001\.png: is missing"):
        read_calibration_views(recording, BOARD)


def test_json_holds_every_number_with_its_uncertainty(synthetic):
    data, _ = synthetic(views=6)
    result = calibrate(replace(data, skipped=(4,)))
    said = json.loads(calibration_as_line(result))
    assert said["schema"] == "akm-fg/calibration/1" and said["skipped"] == [4]
    assert_allclose(said["T_world_cam"], result.T_mount_cam.matrix())
    assert_allclose(said["T_world_cam_cov"], result.T_mount_cam_cov)
    sd = np.sqrt(np.diag(result.T_mount_cam_cov))
    assert_allclose(said["T_world_cam_sd"]["rotation_deg"], np.rad2deg(sd[:3]))
    assert_allclose(said["T_world_cam_sd"]["translation_mm"], 1e3 * sd[3:])
    assert_allclose(said["intrinsics_sd"]["cx"] ** 2, said["intrinsics_cov"][2][2])
    assert [view["corners"] for view in said["views"]] == [24] * 6
    assert "T_gripper_board" in said and any("left out: 4" in w for w in said["warnings"])


def test_json_of_a_camera_in_the_gripper_names_its_frames(synthetic):
    data, _ = synthetic(views=6, camera_place="gripper")
    said = json.loads(calibration_as_line(calibrate(data, CalibrationConfig("gripper"))))
    assert "T_gripper_cam" in said and "T_world_board_cov" in said and "T_world_cam" not in said


@pytest.fixture
def pinhole(synthetic):
    data, _ = synthetic(views=6, lens=(0.0,) * 4)
    return calibrate(data, CalibrationConfig(distortion=False))


def test_a_calibration_goes_into_a_recording_and_leaves_the_rest_alone(recording, pinhole):
    size = {"width": 640, "height": 480, "fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0}
    describe(recording, camera=size, extra="kept")
    write_into_recording(recording, pinhole)
    said = json.loads((recording / "recording.json").read_text())
    assert_allclose(said["T_world_cam"], pinhole.T_mount_cam.matrix())
    assert said["camera"]["fx"] == pinhole.camera.fx and said["extra"] == "kept"
    assert said["stamps_s"] == [0, 1, 2]
    assert_allclose(said["cov_world_cam"], pinhole.T_mount_cam_cov)
    assert_allclose(said["cov_intrinsics"], pinhole.intrinsics_cov[:4, :4])
    assert "calibration" not in said


def test_a_calibration_replaces_what_was_said_of_the_camera_and_leaves_its_depth(
    recording, pinhole
):
    size = {"width": 640, "height": 480, "fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0}
    said = {"cov_world_cam": np.eye(6).tolist(), "focal_sd": 0.1, "depth_scale_sd": 0.01}
    describe(recording, camera=size, calibration=said)
    write_into_recording(recording, pinhole)
    said = json.loads((recording / "recording.json").read_text())
    assert said["calibration"] == {"depth_scale_sd": 0.01}


def test_it_does_not_go_into_a_recording_of_other_images(recording, pinhole):
    before = (recording / "recording.json").read_text()
    with pytest.raises(InputError, match="its images are 320x240"):
        write_into_recording(recording, pinhole)
    assert (recording / "recording.json").read_text() == before


def test_what_a_recording_cannot_hold_is_refused(recording, pinhole):
    for other in (
        replace(pinhole, camera_place="gripper"),
        replace(pinhole, distortion=np.full(4, 0.1)),
    ):
        with pytest.raises(ValueError, match="a fixed camera without distortion"):
            write_into_recording(recording, other)


def test_distortion_moves_the_far_corner_most(pinhole):
    """k1 alone moves a pixel by k1 r^2 of its distance r f from the centre."""
    bent = replace(pinhole, distortion=np.array([0.01, 0.0, 0.0, 0.0]))
    c = bent.camera
    u = max(c.cx, c.width - 1 - c.cx) / c.fx
    v = max(c.cy, c.height - 1 - c.cy) / c.fy
    r2 = u * u + v * v
    assert_allclose(largest_distortion_px(bent), 0.01 * r2 * np.hypot(u * c.fx, v * c.fy))
    assert largest_distortion_px(pinhole) == 0.0
