"""The tree of settings of runs in the simulator: everybody's, and the simulator's own."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from akm_fg.arm.depth_from_arm import DepthFromArmConfig
from akm_fg.cli.config_argument import chosen_config
from akm_fg.config import AkmConfig
from sim.camera.camera import CameraConfig
from sim.camera.rig import PERFECT, RigErrors
from sim.camera.views import ViewConfig
from sim.robot.franka_config import FrankaConfig
from sim.world import WorldConfig


@dataclass(frozen=True, slots=True)
class SimulatorConfig:
    """World, robot and camera, and how these err."""

    world: WorldConfig = field(default_factory=WorldConfig)
    franka: FrankaConfig = field(default_factory=FrankaConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    view: ViewConfig = field(default_factory=ViewConfig)
    rig: RigErrors = PERFECT
    depth_from_arm: DepthFromArmConfig = field(default_factory=DepthFromArmConfig)


@dataclass(frozen=True, slots=True)
class DemoConfig(AkmConfig):
    """All settings of `akm-fg demo`."""

    sim: SimulatorConfig = field(default_factory=SimulatorConfig)


class SimulatorFlags(Protocol):
    """Of a command that runs in the simulator."""

    @property
    def config(self) -> Path | None:
        """TOML file with settings that differ from the defaults."""

    @property
    def tracker(self) -> str | None:
        """What follows points."""

    @property
    def segmenter(self) -> str | None:
        """What finds the object."""

    @property
    def rig_errors(self) -> bool:
        """Camera and arm err as a calibrated rig does."""


def demo_config(arguments: SimulatorFlags, default: DemoConfig | None = None) -> DemoConfig:
    """What the command line says, over the defaults.

    Raises:
        InputError: a file that cannot be used.
    """
    default = default or DemoConfig()
    erring = arguments.rig_errors
    if erring:
        default = replace(default, sim=replace(default.sim, rig=RigErrors()))
    config = chosen_config(default, arguments.config, arguments.tracker, arguments.segmenter)
    if erring and config.sim.rig == PERFECT:  # by a file with all settings: the flag goes before
        config = replace(config, sim=replace(config.sim, rig=RigErrors()))
    return config
