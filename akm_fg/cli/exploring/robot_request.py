"""What the flags of `akm-fg explore --robot` ask for, and what does not go with them."""

from __future__ import annotations

from dataclasses import replace

from akm_fg.backends.registry import stages_of
from akm_fg.cli.config_argument import CONFIG, chosen_config, write_tree
from akm_fg.cli.demo import make_run_folder
from akm_fg.cli.exploring.explore import (
    ExploreArguments,
    chosen_explore,
    command_of,
    exploring_default,
    memory_folder,
    with_memory,
)
from akm_fg.cli.exploring.kept import read_request
from akm_fg.cli.exploring.on_robot import RobotConfig, RobotRequest
from akm_fg.errors import InputError
from akm_fg.hardware.mounted_camera import read_mounted_camera
from akm_fg.hardware.opening import HardwareRequest


def refuse_what_is_simulated(arguments: ExploreArguments) -> None:
    """Flags that mean nothing before a real robot, and the one that it needs.

    Raises:
        InputError: there is such a flag, or the camera's calibration is missing.
    """
    usual = ExploreArguments()
    for flag in ("object", "joint", "scale", "allow", "rig_errors", "locked", "zero_shot"):
        if getattr(arguments, flag) != getattr(usual, flag):
            word = f"--{flag.replace('_', '-')}"
            raise InputError(word, "is of the simulator", "--robot without it")
    if arguments.calibration is None:
        wanted = "--calibration FILE, by akm-fg calibrate --json"
        raise InputError("--robot", "needs to know where the camera stands", wanted)


def robot_request(arguments: ExploreArguments) -> RobotRequest:
    """What is to be done with real devices, and the folder for it."""
    assert arguments.robot is not None and arguments.calibration is not None
    default = exploring_default(RobotConfig())
    given = arguments.config, arguments.tracker, arguments.segmenter
    config = chosen_config(default, *given)
    config = replace(config, explore=chosen_explore(arguments, config.explore))
    config = with_memory(arguments, config)
    read_mounted_camera(arguments.calibration)  # refused before anything is written
    dry = arguments.dry_run
    hardware = HardwareRequest(arguments.robot, arguments.calibration, arguments.floor, dry)
    name, command = f"robot {arguments.robot}", command_of(arguments)
    if arguments.resume is not None:
        folder = arguments.resume
        read_request(folder, name, arguments.seed)
    else:
        folder = make_run_folder(arguments.out, "explore-robot")
        write_tree(folder / CONFIG, config, f"All settings of {command}")
    remember = memory_folder(arguments) if arguments.remember else None
    return RobotRequest(
        hardware, name, arguments.seed, folder, config, stages_of(config), command, remember
    )
