"""Where the arm's own geometry is read from: a URDF and the meshes that it names.

Kinematics, collision shapes and silhouette are all read from one description, and the simulator
loads the same one. The default is the Franka that comes with PyBullet's data; only its files are
looked up, no module of PyBullet is loaded. Nothing here needs more than the standard library.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

from akm_fg.errors import InputError, MissingDependency

GRIPPER_FRAME = "panda_grasptarget"
DATA_PACKAGE = "pybullet_data"  # comes with PyBullet, and is nothing but files
FRANKA_URDF = Path("franka_panda") / "panda.urdf"


@dataclass(frozen=True, slots=True)
class ArmDescription:
    """A URDF of the Franka with its hand; links and joints are called as in Franka's own.

    What it says is checked where it is read (`akm_fg.arm.body.model`).
    """

    urdf: Path
    package_dirs: tuple[Path, ...] = ()  # where to look for `package://`, after the URDF's folder
    gripper_frame: str = GRIPPER_FRAME  # between the fingertips, z forward, y along their opening

    @property
    def folders(self) -> tuple[Path, ...]:
        """Where `package://` in the URDF is looked for, in this order."""
        return (self.urdf.parent, *self.package_dirs)


def franka_description() -> ArmDescription:
    """The Franka of the installed `pybullet_data`.

    Raises:
        MissingDependency: there is no such package.
        InputError: it has no Franka.
    """
    found = importlib.util.find_spec(DATA_PACKAGE)
    if found is None or found.origin is None:
        raise MissingDependency(
            f"the Franka's URDF comes with {DATA_PACKAGE}, which is not installed; "
            "install akm-fg[sim], or hand in an ArmDescription of your own"
        )
    urdf = Path(found.origin).parent / FRANKA_URDF
    if not urdf.is_file():
        raise InputError(urdf, "no such file", f"the Franka of {DATA_PACKAGE}")
    return ArmDescription(urdf)
