"""One exploration with a real arm and camera, every attempt recorded as it goes."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from akm_fg.cli.exploring.kept import RESULT, Explored, read_request, write_result
from akm_fg.cli.exploring.outcome import write_outcome, write_part_model
from akm_fg.cli.exploring.recorder import Recorder
from akm_fg.cli.exploring.stages import explorer_of, perceiver_of
from akm_fg.config import AkmConfig
from akm_fg.errors import ArmStopped, CameraFailed, DryRunEnded
from akm_fg.exploration.analogy.remembering import remember
from akm_fg.exploration.explore import explore
from akm_fg.exploration.explore_json import exploration_as_dict
from akm_fg.exploration.records import Exploration
from akm_fg.hardware.opening import HardwareConfig, HardwareRequest, open_hardware
from akm_fg.report.wording import printable
from akm_fg.stages import Stages


@dataclass(frozen=True, slots=True)
class RobotConfig(AkmConfig):
    """All settings of an exploration with real devices."""

    hardware: HardwareConfig = field(default_factory=HardwareConfig)


@dataclass(frozen=True, slots=True)
class RobotRequest:
    """What to explore with, and where to write."""

    hardware: HardwareRequest
    name: str  # of what is explored: nobody knows better than which robot stands before it
    seed: int
    folder: Path
    config: RobotConfig
    stages: Stages
    command: str
    remember: Path | None = None  # memory of contacts that grows by what opens


def explore_on_robot(request: RobotRequest, device: Any = None) -> Explored:
    """The exploration; what was tried stays readable when it is interrupted, or the arm stops.

    Args:
        request: what to do.
        device: librealsense's camera; without one, the first that is connected.

    Raises:
        ArmStopped: no robot, or it cannot be commanded.
        CameraFailed: no camera, or not the one that was calibrated.
        InputError: the calibration or the settings cannot be used.
        MissingDependency: a device's package is not installed.
        OutputError: something cannot be written.
    """
    exploration = Exploration()
    if (request.folder / RESULT).exists():
        exploration = read_request(request.folder, request.name, request.seed)
    explored = Explored(exploration, request.folder)
    config = request.config

    def keep() -> None:
        told = {"object": request.name, "seed": request.seed, **exploration_as_dict(exploration)}
        write_result(request.folder, told)

    with open_hardware(request.hardware, config.hardware, tell=_tell, device=device) as rig:
        perceived = perceiver_of(config, request.stages, None, exploration.notes)
        explorer = explorer_of(
            config, request.stages, perceived, rig.calibration, request.folder, request.seed,
            keep,
        )  # fmt: skip
        recorder = Recorder(request.folder, rig.calibration, keep)
        if rig.correction is not None:
            recorder.stage(rig.correction.words())
        try:
            explore(rig.arm, rig.camera, explorer, exploration, recorder)
        except KeyboardInterrupt:
            explored.interrupted = True
            exploration.failure = "interrupted"
        except (ArmStopped, CameraFailed, DryRunEnded) as end:
            exploration.failure = str(end)
            explored.planned = isinstance(end, DryRunEnded)
        if request.remember is not None:
            count = remember(request.remember, exploration, perceived, request.name, "")
            if count is not None:
                recorder.stage(f"{count} contacts are remembered in {request.remember}")
    explored.model = write_part_model(request.folder, exploration, config)
    keep()
    write_outcome(request.name, request.command, request.seed, explored, config)
    return explored


def _tell(words: str) -> None:
    print(f"would move  {printable(words)}", file=sys.stderr, flush=True)
