"""`akm-fg calibrate`: from a simulated board to JSON, a picture and a recording."""

import json
import shutil
from pathlib import Path

import cv2
import gtsam
import numpy as np
import pytest
from scipy import stats

from akm_fg.calibration.board_file import read_board
from akm_fg.calibration.calibrate import calibrate
from akm_fg.calibration.read import read_calibration_views
from akm_fg.cli.main import main
from akm_fg.cli.recordings.board_recording import write_simulated_board
from akm_fg.config import AkmConfig
from akm_fg.io.config_file import read_config

pytest.importorskip("pybullet")
from sim.camera.charuco_board import PoseConfig

VIEWS = 6


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Six views, drawn only twice as large: coarser corners, but quick."""
    out = tmp_path_factory.mktemp("board") / "recording"
    write_simulated_board(out, VIEWS, "d455", seed=1, config=PoseConfig(supersample=2))
    return out


def _json(capfd):
    return json.loads(capfd.readouterr().out)


def _complaint(capfd):
    told = capfd.readouterr().err.strip()
    assert told.startswith("akm-fg: ") and told.count("\n") == 0
    return told


def _pose_error(said, folder):
    truth = json.loads((folder / "truth.json").read_text())
    found = gtsam.Pose3(np.array(said["T_world_cam"]))
    return gtsam.Pose3.Logmap(found.between(gtsam.Pose3(np.array(truth["T_world_cam"]))))


def test_a_simulated_recording_holds_no_truth_but_in_its_own_file(recording):
    said = json.loads((recording / "recording.json").read_text())
    truth = json.loads((recording / "truth.json").read_text())
    assert said["truth"] is None
    np.testing.assert_allclose(said["T_world_cam"], np.eye(4))
    assert abs(said["camera"]["fx"] - truth["camera"]["fx"]) > 10
    assert len(said["T_world_gripper"]) == VIEWS


def test_the_camera_comes_back_with_its_covariance(recording, capfd):
    assert main(["calibrate", str(recording), "--json", "-"]) == 0
    said = _json(capfd)
    xi = _pose_error(said, recording)
    nees = xi @ np.linalg.solve(said["T_world_cam_cov"], xi)
    assert nees < stats.chi2.ppf(0.999, 6)
    assert np.linalg.norm(xi[3:]) < 5e-3 and np.linalg.norm(xi[:3]) < np.deg2rad(1.0)
    assert len(said["views"]) == VIEWS


def test_a_table_a_score_and_a_picture(recording, capfd, tmp_path):
    picture = tmp_path / "residuals.png"
    truth = str(recording / "truth.json")
    assert main(["calibrate", str(recording), "--picture", str(picture), "--truth", truth]) == 0
    printed = capfd.readouterr().out
    assert "T_world_cam, place" in printed and "against the truth" in printed
    image = cv2.imread(str(picture))
    assert image.shape[0] > 400 and image.std() > 20


def test_a_folder_whose_name_looks_like_markup_is_named(recording, capfd, tmp_path):
    folder = tmp_path / "[red]x"
    shutil.copytree(recording, folder)
    assert main(["calibrate", str(folder)]) == 0
    assert "[red]x" in capfd.readouterr().out


def test_the_calibration_goes_into_a_recording(recording, capfd, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(recording, copy)
    assert main(["calibrate", str(recording), "--no-distortion", "--write", str(copy)]) == 0
    said = json.loads((copy / "recording.json").read_text())
    xi = _pose_error(said, recording)
    assert np.linalg.norm(xi[3:]) < 5e-3
    capfd.readouterr()


def _spoilt(recording, tmp_path, **changes):
    copy = tmp_path / "spoilt"
    shutil.copytree(recording, copy)
    path = copy / "recording.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))
    return copy


def _board(folder, **changes):
    path = folder / "board.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    ("board", "message"),
    [
        ({"squares_x": 5, "squares_y": 7}, "the board is in none of 6 images"),
        ({"dictionary": "DICT_6X6_50"}, "none of its markers was read"),
        ({"square_m": 0.05}, "`square_m` says 50 mm, but by the robot's motion it is 4"),
        ({"dictionary": "DICT_NONE"}, "dictionary 'DICT_NONE'"),
    ],
)
def test_a_wrong_board_gets_one_line(recording, tmp_path, capfd, board, message):
    copy = _spoilt(recording, tmp_path)
    _board(copy, **board)
    assert main(["calibrate", str(copy)]) == 2
    assert message in _complaint(capfd)


def test_poses_that_are_missing_get_one_line(recording, tmp_path, capfd):
    assert main(["calibrate", str(_spoilt(recording, tmp_path, T_world_gripper=None))]) == 2
    assert "`T_world_gripper` is missing" in _complaint(capfd)


def test_an_arm_that_stood_still_gets_one_line_that_names_the_variable(recording, tmp_path, capfd):
    still = [np.eye(4).tolist()] * VIEWS
    assert main(["calibrate", str(_spoilt(recording, tmp_path, T_world_gripper=still))]) == 2
    assert "translation of T_world_cam is open" in _complaint(capfd)


def test_images_without_the_board_are_skipped_and_named_until_too_few_are_left(
    recording, tmp_path, capfd
):
    copy = _spoilt(recording, tmp_path)
    empty = np.full((480, 640, 3), 90, dtype=np.uint8)
    cv2.imwrite(str(copy / "rgb" / "000002.png"), empty)
    assert main(["calibrate", str(copy), "--json", "-"]) == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["skipped"] == [2]
    assert "frames without the board, left out: 2" in captured.err
    for frame in (0, 1, 3):
        cv2.imwrite(str(copy / "rgb" / f"{frame:06d}.png"), empty)
    assert main(["calibrate", str(copy)]) == 2
    assert "seen in 2 of 6 images" in _complaint(capfd)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["calibrate"], "no recording"),
        (["calibrate", "nowhere"], "nowhere: does not exist"),
        (["calibrate", "--simulate", "out", "--noise", "loud"], "--noise: 'loud'"),
        (["calibrate", "--simulate", "out", "--views", "0"], "--views: 0"),
    ],
)
def test_bad_arguments_get_one_line(arguments, message, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert message in _complaint(capfd)
    assert not (tmp_path / "out").exists()


def test_options_that_make_no_sense_get_one_line(recording, capfd):
    assert main(["calibrate", str(recording), "--robot-mm", "0"]) == 2
    assert "robot_sd_m is 0" in _complaint(capfd)


def test_settings_come_from_a_file_and_options_go_before_it(recording, tmp_path, capfd):
    mine, out = tmp_path / "mine.toml", tmp_path / "out.json"
    mine.write_text("calibration.robot_sd_m = 5e-4\ncalibration.checks.weak_cam_m = 1e-9\n")
    assert main(["calibrate", str(recording), "--config", str(mine), "--json", str(out)]) == 0
    tuned, written = json.loads(out.read_text()), Path(f"{out}.config.toml")
    assert any("translation" in warning for warning in tuned["warnings"])
    again = tmp_path / "again.json"
    command = ["calibrate", str(recording), "--config", str(written), "--json", str(again)]
    assert main(command) == 0
    # Not the last digits: the order in which threads add up is not the same every time.
    cov = json.loads(again.read_text())["T_world_cam_cov"]
    np.testing.assert_allclose(cov, tuned["T_world_cam_cov"], rtol=1e-6, atol=1e-18)
    assert main([*command, "--robot-mm", "0.1"]) == 0
    kept = read_config(Path(f"{again}.config.toml"), AkmConfig()).calibration
    assert kept.robot_sd_m == 1e-4 and kept.checks.weak_cam_m == 1e-9


@pytest.mark.slow
def test_rendered_calibrations_err_as_much_as_they_say(tmp_path):
    """Four recordings of 30 views each: within 1 mm and 0.1 deg, mean NEES in its 99.9 % band."""
    nees, trials = [], 4
    for seed in range(1, 1 + trials):
        folder = tmp_path / str(seed)
        write_simulated_board(folder, 30, "d455", seed)
        result = calibrate(read_calibration_views(folder, read_board(folder / "board.json")))
        said = {"T_world_cam": result.T_mount_cam.matrix()}
        xi = _pose_error(said, folder)
        assert np.linalg.norm(xi[3:]) < 1e-3 and np.linalg.norm(xi[:3]) < np.deg2rad(0.1)
        nees.append(xi @ np.linalg.solve(result.T_mount_cam_cov, xi))
    low, high = stats.chi2.ppf([0.0005, 0.9995], 6 * trials) / trials
    assert low < np.mean(nees) < high
