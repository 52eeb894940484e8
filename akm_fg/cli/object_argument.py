"""OBJECT as a person writes it: door, furniture-dev/door-003, cabinet.urdf, a PartNet folder."""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from akm_fg.errors import InputError

if TYPE_CHECKING:
    from sim.objects.imported.imported_spec import ImportOptions
    from sim.objects.part_spec import PartSpec

WHAT = (
    "door, drawer, SUITE/NAME such as furniture-dev/door-003, a URDF file, "
    "or a PartNet-Mobility folder"
)


@dataclass(frozen=True, slots=True)
class ObjectArgument:
    """An object to be opened in the simulator."""

    name: str  # as `sim.episode.open_world` takes it
    joint: str | None  # of a file or folder, the one that is free; None: there is no choice
    ours: bool  # one of ours, and not a user's file or folder
    scale: float | None = None  # of a file or folder, what multiplies every length in it
    allowed: Path | None = None  # of a file, the folder outside its own that holds meshes of it

    @property
    def title(self) -> str:
        """What a report calls it: short, and still telling."""
        if self.ours:
            return self.name
        from sim.objects.imported.partnet import JOINT_MARK, PREFIX, URDF

        place, _, marked = self.name.removeprefix(PREFIX).partition(JOINT_MARK)
        path = Path(place).resolve()
        short = path.parent.name if path.name == URDF else path.stem if path.suffix else path.name
        joint = self.joint or marked
        return f"{short}, {joint}" if joint else short

    @property
    def whole_name(self) -> str:
        """Name and joint in one, as OBJECT takes them too."""
        return self.name if self.joint is None else f"{self.name}#{self.joint}"

    @property
    def label(self) -> str:
        """Its title for file names."""
        return re.sub(r"[^\w.]+", "-", self.title).strip("-.")

    @property
    def words(self) -> str:
        """The part of a command line that names it, where its name is a flag's value."""
        return f"--object {self.positional}"

    @property
    def positional(self) -> str:
        """The part of a command line that names it, where its name stands alone."""
        joint = "" if self.joint is None else f" --joint {shlex.quote(self.joint)}"
        scale = "" if self.scale is None else f" --scale {self.scale:g}"
        allowed = "" if self.allowed is None else f" --allow {shlex.quote(str(self.allowed))}"
        return f"{shlex.quote(self.name)}{joint}{scale}{allowed}"

    @property
    def options(self) -> ImportOptions:
        """What else is said of a file or folder."""
        from sim.objects.imported.imported_spec import ImportOptions

        return ImportOptions(scale=self.scale, allowed=self.allowed)

    def spec(self, seed: int) -> PartSpec:
        """What the simulator knows of it.

        Raises:
            InputError: a broken file, no such object or joint, or several joints and none named.
        """
        from sim.objects.staging import find_spec

        return find_spec(self.name, seed, self.joint, self.options)


def parse_object(
    text: str,
    joint: str | None = None,
    scale: float | None = None,
    allowed: Path | None = None,
) -> ObjectArgument:
    """The object that a person names.

    Raises:
        InputError: it is neither one of ours nor a file or folder.
    """
    from sim.objects.embedded import OBJECT_NAMES
    from sim.objects.imported.partnet import JOINT_MARK, PREFIX
    from sim.objects.suites.catalogue import ALL_SUITES

    if text in OBJECT_NAMES or text.partition("/")[0] in ALL_SUITES:
        if scale is not None:
            told = f"{text} has its size; --scale is for files and folders"
            raise InputError("--scale", told, "a URDF file or a PartNet-Mobility folder")
        if allowed is not None:
            told = f"{text} names no meshes; --allow is for files and folders"
            raise InputError("--allow", told, "a URDF file or a PartNet-Mobility folder")
        return ObjectArgument(text, joint, ours=True)
    check_scale(scale)
    place = text.removeprefix(PREFIX).partition(JOINT_MARK)[0]
    try:
        found, is_folder = Path(place).exists(), Path(place).is_dir()
    except (OSError, ValueError) as error:
        raise InputError("--object", f"{text!r} is not a usable path", WHAT) from error
    if not place or not found:
        raise InputError("--object", f"{text!r} is no suite's object, file or folder", WHAT)
    if not is_folder and place.lower().endswith(".xacro"):
        told = f"{text!r} is a xacro file"
        raise InputError("--object", told, "a URDF: run `xacro FILE > object.urdf` first")
    if not is_folder and not place.lower().endswith(".urdf"):
        raise InputError("--object", f"{text!r} does not end in .urdf", WHAT)
    if not is_folder and not Path(place).is_file():
        raise InputError("--object", f"{text!r} is not a regular file", WHAT)
    return ObjectArgument(text, joint, ours=False, scale=scale, allowed=allowed)


def check_scale(scale: float | None) -> None:
    """Raises InputError for a scale that is none."""
    if scale is not None and not 0.0 < scale < math.inf:
        raise InputError("--scale", f"is {scale:g}", "a number above 0, such as 0.001")
