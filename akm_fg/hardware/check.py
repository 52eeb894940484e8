"""Is this rig fit to move? Versions, control rate, calibration, workspace; nothing moves here."""

from __future__ import annotations

import importlib.metadata
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from akm_fg.arm.body.kinematics import FrankaKinematics
from akm_fg.errors import AkmError
from akm_fg.hardware.franka.config import FrankaArmConfig
from akm_fg.hardware.franka.hand_frame import checked_hand
from akm_fg.hardware.franka.link import FrankaLink, is_realtime
from akm_fg.hardware.mounted_camera import MountedCamera, read_mounted_camera
from akm_fg.hardware.realsense.camera import RealSenseCamera
from akm_fg.hardware.realsense.config import RealSenseConfig
from akm_fg.records import FloatArray

State = Literal["ok", "warning", "problem"]
PACKAGES = ("franky-control", "pyrealsense2")
STRANGER = "franky"  # a distribution of this name is another project, and hides the right one


@dataclass(frozen=True, slots=True)
class CheckConfig:
    """What is still well."""

    arm: FrankaArmConfig = field(default_factory=FrankaArmConfig)
    camera: RealSenseConfig = field(default_factory=RealSenseConfig)
    listen_s: float = 1.0  # to the robot's clock
    rate_least: float = 0.95  # of its milliseconds that arrive in time
    gap_most_s: float = 0.01  # between two states: ten packets
    joint_margin_rad: float = 0.05
    age_most_days: float = 30.0  # of a calibration: mounts creep, and people bump into them
    rms_most_px: float = 1.0
    place_sd_most_m: float = 0.005
    pictures: int = 3
    depth_least: float = 0.5  # of the pixels
    # Where handles are (docs/objects.md): ahead of the base, m, heights above the floor.
    reach_low: tuple[float, float, float] = (0.35, -0.35, 0.10)
    reach_high: tuple[float, float, float] = (0.75, 0.35, 0.80)
    seen_least: float = 0.7  # of that, in the picture
    clear_m: float = 0.05  # of the hand above the floor


@dataclass(frozen=True, slots=True)
class RigCheck:
    """One thing that was looked at."""

    name: str
    state: State
    words: str


def check_rig(
    robot: str | None,
    calibration: Path | None,
    floor_m: float = 0.0,
    config: CheckConfig | None = None,
    device: Any = None,
) -> Iterator[RigCheck]:
    """Look at everything that is named, one thing after the other.

    Args:
        robot: address of a Franka; None: no arm is looked at.
        calibration: of the camera; None: neither it nor the camera are looked at.
        floor_m: height of the floor, world.
        config: what is still well.
        device: librealsense's; without one, the first that is connected.
    """
    config = config or CheckConfig()
    yield from (_package(name) for name in PACKAGES)
    yield _stranger()
    yield _kernel()
    if robot is not None:
        yield from _checked("robot", lambda: _robot(robot, floor_m, config))
    if calibration is None:
        return
    mounted: list[MountedCamera] = []

    def read() -> Iterator[RigCheck]:
        mounted.append(read_mounted_camera(calibration))
        yield _calibration(mounted[0], config)
        yield _workspace(mounted[0], floor_m, config)

    yield from _checked("calibration", read)
    if mounted:
        yield from _checked("camera", lambda: _camera(mounted[0], config, device))


def _checked(name: str, look: Callable[[], Iterator[RigCheck]]) -> Iterator[RigCheck]:
    try:
        yield from look()
    except AkmError as error:
        yield RigCheck(name, "problem", str(error))


def _package(name: str) -> RigCheck:
    try:
        return RigCheck(name, "ok", importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        return RigCheck(name, "problem", "not installed; install akm-fg[hardware]")


def _stranger() -> RigCheck:
    try:
        version = importlib.metadata.version(STRANGER)
    except importlib.metadata.PackageNotFoundError:
        return RigCheck("franky", "ok", "is that of franky-control")
    words = f"the distribution franky {version} is another project: remove it, then reinstall"
    return RigCheck("franky", "problem", f"{words} franky-control")


def _kernel() -> RigCheck:
    if is_realtime():
        return RigCheck("kernel", "ok", "real-time")
    words = "not real-time: a real robot will stop when a packet is late (docs/hardware.md)"
    return RigCheck("kernel", "warning", words)


def _robot(host: str, floor_m: float, config: CheckConfig) -> Iterator[RigCheck]:
    with FrankaLink(host, config.arm) as link:
        kinematics, state = FrankaKinematics(), link.state()
        checked_hand(state, kinematics, config.arm)
        yield RigCheck("robot", "ok", f"answers at {host}, with the hand that is described")
        yield _rate(link, config)
        low, high = link.joint_limits()
        margin = float(np.minimum(state.q - low, high - state.q).min())
        well: State = "ok" if margin >= config.joint_margin_rad else "problem"
        yield RigCheck("joints", well, f"{margin:.2f} rad from the nearest limit")
        above_m = float(kinematics.T_world_gripper(state.q).translation()[2]) - floor_m
        well = "ok" if above_m >= config.clear_m else "problem"
        yield RigCheck("hand", well, f"{100 * above_m:.0f} cm above the floor, as --floor has it")
        widest_m, wanted_m = link.widest_m(), config.arm.grasp.open_m
        homed = widest_m > wanted_m - config.arm.grasp.nothing_m
        words = f"opens to {1e3 * widest_m:.0f} mm"
        yield RigCheck(
            "fingers", "ok" if homed else "problem", words if homed else f"{words}: home it in Desk"
        )


def _rate(link: FrankaLink, config: CheckConfig) -> RigCheck:
    """Each state is read as it comes: the robot's clock against this computer's."""
    began_s, first = time.monotonic(), link.state()
    stamps = [first.time_s]
    while time.monotonic() - began_s < config.listen_s:
        stamps.append(link.state().time_s)
    share = (stamps[-1] - first.time_s) / (time.monotonic() - began_s)
    gap_s = float(np.diff(stamps).max(initial=0.0))
    words = (
        f"{1e3 * share:.0f} of 1000 Hz, longest gap {1e3 * gap_s:.0f} ms, "
        f"{100 * first.success:.0f} % of the last commands in time"
    )
    well = share >= config.rate_least and gap_s <= config.gap_most_s
    return RigCheck("control rate", "ok" if well else "warning", words)


def _calibration(mounted: MountedCamera, config: CheckConfig) -> RigCheck:
    days, place = mounted.age_days(), np.diag(mounted.errors.cov_world_cam)[3:]
    sd_m = float(np.sqrt(place.max()))
    words = (
        f"{days:.0f} days old by the file's date, {mounted.rms_px:.2f} px rms, "
        f"place known to {1e3 * sd_m:.1f} mm"
    )
    doubts = []
    if days > config.age_most_days:
        doubts.append(f"older than {config.age_most_days:.0f} days: calibrate again")
    if mounted.rms_px > config.rms_most_px:
        doubts.append(f"rms above {config.rms_most_px:g} px")
    if sd_m > config.place_sd_most_m:
        doubts.append(f"place not known to {1e3 * config.place_sd_most_m:g} mm")
    return RigCheck("calibration", "warning" if doubts else "ok", "; ".join([words, *doubts]))


def _workspace(mounted: MountedCamera, floor_m: float, config: CheckConfig) -> RigCheck:
    camera, T_world_cam = mounted.lens.camera, mounted.T_world_cam
    p_world = _grid(np.array(config.reach_low), np.array(config.reach_high))
    p_world[:, 2] += floor_m
    R, t = T_world_cam.rotation().matrix(), T_world_cam.translation()
    uv = camera.project((p_world - t) @ R)
    inside = (uv >= 0).all(1) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
    seen = float(inside.mean())
    words = f"the camera sees {100 * seen:.0f} % of where handles may be"
    if t[2] < floor_m:
        return RigCheck("workspace", "problem", f"{words}, and stands below the floor")
    return RigCheck("workspace", "ok" if seen >= config.seen_least else "warning", words)


def _grid(low: FloatArray, high: FloatArray, steps: int = 5) -> FloatArray:
    """Points (N, 3) all over a box."""
    axes = [np.linspace(a, b, steps) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)


def _camera(mounted: MountedCamera, config: CheckConfig, device: Any) -> Iterator[RigCheck]:
    with RealSenseCamera(mounted, None, config.camera, device) as camera:
        frames = [camera.capture() for _ in range(config.pictures)]
        known = float(np.mean([np.isfinite(frame.depth_m).mean() for frame in frames]))
        words = f"{camera.name}, {100 * known:.0f} % of its pixels have depth"
        yield RigCheck("camera", "ok" if known >= config.depth_least else "warning", words)
