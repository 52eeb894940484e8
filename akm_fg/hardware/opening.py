"""The one place where real devices are opened: a camera and an arm, as `sim.episode.open_world`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from akm_fg.arm.depth_from_arm import DepthCorrection, DepthFromArmConfig
from akm_fg.hardware.franka.arm import FrankaArm
from akm_fg.hardware.franka.config import FrankaArmConfig
from akm_fg.hardware.franka.dry_run import DryRunArm
from akm_fg.hardware.franka.planning import ArmPlanner
from akm_fg.hardware.mounted_camera import DepthErrors, MountedCamera, read_mounted_camera
from akm_fg.hardware.realsense.camera import RealSenseCamera
from akm_fg.hardware.realsense.config import RealSenseConfig
from akm_fg.records import CalibrationErrors


@dataclass(frozen=True, slots=True)
class HardwareConfig:
    """Settings of a rig of real devices."""

    arm: FrankaArmConfig = field(default_factory=FrankaArmConfig)
    camera: RealSenseConfig = field(default_factory=RealSenseConfig)
    depth: DepthErrors = field(default_factory=DepthErrors)
    depth_from_arm: DepthFromArmConfig = field(default_factory=DepthFromArmConfig)


@dataclass(frozen=True, slots=True)
class HardwareRequest:
    """Which devices, and what is known of the place."""

    robot: str  # host of the robot's control interface
    calibration: Path  # of the camera, by `akm-fg calibrate --json`
    floor_m: float = 0.0  # height of what the robot's base stands on; nothing goes below
    dry_run: bool = False  # plan and say, connect no arm and move nothing


@dataclass(frozen=True, slots=True)
class HardwareRig:
    """An opened camera and arm, behind the Protocols of `akm_fg.interfaces`."""

    arm: FrankaArm | DryRunArm
    camera: RealSenseCamera
    mounted: MountedCamera
    correction: DepthCorrection | None = None  # of the camera's depth, where it sees the arm

    @property
    def calibration(self) -> CalibrationErrors:
        """What is not known of the camera."""
        errors = self.mounted.errors
        return errors if self.correction is None else self.correction.left(errors)


@contextmanager
def open_hardware(
    request: HardwareRequest,
    config: HardwareConfig | None = None,
    *,
    tell: Callable[[str], None],
    device: Any = None,
) -> Iterator[HardwareRig]:
    """Opens camera and arm, and closes them again; the arm is left at rest.

    What the camera's depth is off where it sees the arm is corrected.

    Args:
        request: which.
        config: settings.
        tell: takes the lines of a dry run.
        device: librealsense's camera; without one, the first that is connected.

    Raises:
        ArmStopped: no robot, or it cannot be commanded.
        CameraFailed: no camera, or not the one that was calibrated.
        InputError: the calibration cannot be read.
        MissingDependency: a device's package is not installed.
    """
    config = config or HardwareConfig()
    mounted = read_mounted_camera(request.calibration, config.depth)
    planner = ArmPlanner(request.floor_m, config.arm)
    with ExitStack() as stack:
        arm: FrankaArm | DryRunArm
        if request.dry_run:
            arm = DryRunArm(planner, tell)
        else:
            arm = stack.enter_context(FrankaArm(request.robot, planner))
        camera = RealSenseCamera(mounted, arm.masked, config.camera, device)
        stack.enter_context(camera)
        correction = None
        if isinstance(arm, FrankaArm):  # where a dry run's stands is not known
            correction = arm.correct_depth_of(camera, mounted.errors, config.depth_from_arm)
        yield HardwareRig(arm, camera, mounted, correction)
