"""A simulated calibration recording: a Franka shows a ChArUco board to its camera."""

from __future__ import annotations

import importlib.util
import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import gtsam

from akm_fg.errors import InputError, MissingDependency

if TYPE_CHECKING:
    from akm_fg.records import PinholeCamera
    from sim.camera.charuco_board import BoardTruth, PoseConfig

SCENE = "furniture-dev/door-003"  # what stands in front of the robot; free room beside it
NOMINAL_FOCAL = 0.97  # of the true focal length: a data sheet's figure, to start from


def write_simulated_board(
    out: Path, views: int, noise: str, seed: int, config: PoseConfig | None = None
) -> None:
    """Write recording, board.json and truth.json to a new folder.

    The recording says what is known before a calibration: a nominal camera, and no place of it
    (the identity). truth.json is for scoring alone.

    Raises:
        MissingDependency: the simulator is not installed.
        InputError: an unknown noise level or too few views.
        OutputError: the folder is not empty or cannot be written.
    """
    _require_simulator()
    from akm_fg.calibration.board_file import write_board
    from akm_fg.calibration.records import BoardSpec
    from akm_fg.io.recording import RecordingWriter
    from sim.camera.charuco_board import PoseConfig, board_shots, open_board_rig
    from sim.camera.noise import NOISE_LEVELS

    if noise not in NOISE_LEVELS:
        raise InputError("--noise", f"{noise!r}", f"one of {', '.join(NOISE_LEVELS)}")
    if views < 1:
        raise InputError("--views", f"{views}", "1 or more")
    config = replace(config or PoseConfig(), views=views)
    with RecordingWriter(out) as writer, open_board_rig(SCENE, seed, noise, config=config) as rig:
        start = _nominal(rig.truth.camera)
        for count, shot in enumerate(board_shots(rig, seed, config), 1):
            frame = replace(shot.frame, camera=start, T_world_cam=gtsam.Pose3())
            writer.add(frame, T_world_gripper=shot.T_world_gripper)
            _show_progress(count, views)
        spec = rig.spec
        board = BoardSpec(
            spec.squares_x, spec.squares_y, spec.square_m, spec.marker_m, spec.dictionary
        )
        write_board(out / "board.json", board)
        _write_truth(out / "truth.json", rig.truth)


def _nominal(camera: PinholeCamera) -> PinholeCamera:
    focal = NOMINAL_FOCAL * camera.fx
    middle = (camera.width - 1) / 2.0, (camera.height - 1) / 2.0
    return replace(camera, fx=focal, fy=focal, cx=middle[0], cy=middle[1])


def _write_truth(path: Path, truth: BoardTruth) -> None:
    from akm_fg.calibration.table import TRUTH_SCHEMA
    from akm_fg.io.png import replace_file

    described = {
        "schema": TRUTH_SCHEMA,
        "camera": asdict(truth.camera),
        "T_world_cam": truth.T_world_cam.matrix().tolist(),
        "T_gripper_board": truth.T_gripper_board.matrix().tolist(),
    }
    replace_file(path, (json.dumps(described, allow_nan=False) + "\n").encode())


def _require_simulator() -> None:
    absent = [m for m in ("pybullet", "pinocchio") if importlib.util.find_spec(m) is None]
    if absent:
        raise MissingDependency(
            f"--simulate needs {' and '.join(absent)}; install akm-fg[sim] (Python 3.11)"
        )


def _show_progress(count: int, total: int) -> None:
    if sys.stderr.isatty():
        end = "\n" if count == total else ""
        print(f"\r\033[K{count}/{total} views", end=end, file=sys.stderr, flush=True)
