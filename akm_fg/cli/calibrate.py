"""`akm-fg calibrate`: camera intrinsics and hand-eye calibration from images of a board."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro

from akm_fg.cli.console.lines import complain, console
from akm_fg.cli.exit_codes import DONE
from akm_fg.cli.output import json_output, write_line
from akm_fg.errors import InputError
from akm_fg.report.wording import printable

if TYPE_CHECKING:
    from akm_fg.calibration.records import (
        BoardSpec,
        CalibrationConfig,
        CalibrationViews,
        HandEyeCalibration,
    )
    from akm_fg.config import AkmConfig


@dataclass(frozen=True)
class CalibrateArguments:
    """Example: akm-fg calibrate board-recording --json calibration.json --write kitchen/recording

    Finds the camera's intrinsics, its pose and that of the ChArUco board, each with its
    covariance, from images of the board and the robot's poses. FOLDER is a recording
    (recording.json with T_world_gripper, rgb/) with the board described in board.json.
    To try it: akm-fg calibrate --simulate runs/board, then akm-fg calibrate runs/board.
    """

    folder: Annotated[Path | None, tyro.conf.Positional] = None
    """Recording with images of the board and one gripper pose an image."""
    board: Path | None = None
    """Description of the board; FOLDER/board.json where none is given."""
    camera_place: Literal["fixed", "gripper"] | None = None
    """fixed: the gripper holds the board; gripper: it carries the camera, the board stands. Fixed
    if absent."""
    fixed_intrinsics: bool = False
    """Keep the camera of recording.json as it is, without distortion."""
    no_distortion: bool = False
    """Estimate a camera without distortion (rectified images, as recordings have them)."""
    robot_mm: float | None = None
    """Standard deviation of the robot's reported positions, each axis; 0.1 if absent."""
    robot_deg: float | None = None
    """Standard deviation of the robot's reported rotations, each axis; 0.05 if absent."""
    config: Path | None = None
    """TOML file with settings that differ from the defaults, such as calibration.dof = 4.0; other
    options go before it. All settings are written beside OUT of --json OUT, as OUT.config.toml."""
    json: str | None = None
    """Write the calibration as one JSON object to this file; - is standard output (no table)."""
    picture: Path | None = None
    """Draw corners and residuals to this PNG."""
    write: Path | None = None
    """Put camera and T_world_cam, and their covariances, into this recording; its images must be
    free of distortion."""
    truth: Path | None = None
    """Say how far the result is from this truth.json of a simulated recording."""
    simulate: Path | None = None
    """Write a simulated recording of a board in a Franka's hand to this new folder instead."""
    views: int = 40
    """Of --simulate: poses in which the board is shown."""
    noise: str = "d455"
    """Of --simulate: clean, d455 or harsh."""
    seed: int = 0
    """Of --simulate; the calibration itself uses no random numbers."""


def calibrate(arguments: CalibrateArguments) -> int:
    """Run the command.

    Raises:
        InputError: no such recording, no board in it, options that do not go together.
        AxisUnobservable: the poses leave a direction of a variable open.
        OutputError: a result cannot be written.
    """
    if arguments.simulate is not None:
        return _simulate(arguments, arguments.simulate)
    folder = arguments.folder
    if folder is None:
        raise InputError("calibrate", "no recording", "a folder, or --simulate OUT to make one")
    config = _config(arguments)
    if arguments.write is not None and config.calibration.camera_place != "fixed":
        raise InputError("--write", "of a camera in the gripper", "--camera-place fixed")
    from akm_fg.calibration.calibrate import calibrate as calibrate_views
    from akm_fg.calibration.result_json import calibration_as_line
    from akm_fg.cli.config_argument import write_beside

    with json_output(arguments.json) as stream:
        data = _read(folder, arguments.board)
        result = calibrate_views(data, config.calibration)
        write_beside(arguments.json, config)
        if stream is not None:
            write_line(stream, calibration_as_line(result))
    if arguments.picture is not None:
        from akm_fg.calibration.picture import write_picture

        write_picture(arguments.picture, result, folder)
    if arguments.write is not None:
        _write(arguments.write, data, result, config.calibration)
    for warning in result.warnings:
        complain(warning)
    if arguments.json != "-":
        _print(result, config.calibration, arguments.truth)
    return DONE


def _simulate(arguments: CalibrateArguments, out: Path) -> int:
    from akm_fg.cli.recordings.board_recording import write_simulated_board

    if arguments.folder is not None:
        raise InputError("--simulate", "goes without a recording to read", "one of the two")
    write_simulated_board(out, arguments.views, arguments.noise, arguments.seed)
    place = printable(str(out))
    print(f"{arguments.views} views of a board in {place}; next: akm-fg calibrate {place}")
    return DONE


def _read(folder: Path, board_path: Path | None) -> CalibrationViews:
    from akm_fg.calibration.board_file import read_board
    from akm_fg.calibration.read import open_recording, read_calibration_views

    open_recording(folder)
    board: BoardSpec = read_board(folder / "board.json" if board_path is None else board_path)
    return read_calibration_views(folder, board)


def _config(arguments: CalibrateArguments) -> AkmConfig:
    """What the options say over what the file says."""
    from akm_fg.cli.config_argument import chosen_config
    from akm_fg.config import AkmConfig

    config = chosen_config(AkmConfig(), arguments.config)
    given: dict[str, Any] = {}
    if arguments.camera_place is not None:
        given["camera_place"] = arguments.camera_place
    if arguments.fixed_intrinsics:
        given["fixed_intrinsics"] = True
    if arguments.no_distortion:
        given["distortion"] = False
    if arguments.robot_mm is not None:
        given["robot_sd_m"] = 1e-3 * arguments.robot_mm
    if arguments.robot_deg is not None:
        given["robot_sd_rad"] = float(np.deg2rad(arguments.robot_deg))
    try:
        return replace(config, calibration=replace(config.calibration, **given))
    except ValueError as error:
        raise InputError("--robot-mm, --robot-deg", str(error), "both above 0") from error


def _write(
    recording: Path,
    data: CalibrationViews,
    result: HandEyeCalibration,
    config: CalibrationConfig,
) -> None:
    """A recording has no distortion: what is written is fitted without."""
    from akm_fg.calibration.calibrate import calibrate as calibrate_views
    from akm_fg.calibration.result_json import largest_distortion_px, write_into_recording

    bent_px = largest_distortion_px(result)
    if bent_px > config.checks.written_distortion_px:
        raise InputError(
            recording,
            f"the camera's distortion moves pixels by up to {bent_px:.1f}",
            "images that are rectified first: a recording holds no distortion",
        )
    if result.distortion.any():
        result = calibrate_views(data, replace(config, distortion=False))
    write_into_recording(recording, result)


def _print(result: HandEyeCalibration, config: CalibrationConfig, truth: Path | None) -> None:
    from akm_fg.calibration.checks import limit_off_px
    from akm_fg.calibration.table import calibration_table, score_line

    out = console()
    table = calibration_table(result)
    table.title = printable(result.name)
    out.print(table)
    seen, corners = len(result.views), sum(len(view.uv) for view in result.views)
    out.print(
        f"{corners} corners in {seen} views, {result.rms_px:.3f} px rms; noise scale of a "
        f"corner's coordinate {result.corner_scale_px:.3f} px; the limit of half of the corners is "
        f"{limit_off_px(result.camera, config):.1f} px"
    )
    if truth is not None:
        out.print(score_line(result, truth))
