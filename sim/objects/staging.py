"""From a name and a seed to an object that stands in front of the robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from akm_fg.arm.body.kinematics import FrankaKinematics
from akm_fg.errors import InputError
from sim.cache import code_digest, digest, kept
from sim.objects.embedded import (
    OBJECT_NAMES,
    ObjectSpec,
    build_object,
    sample_object,
)
from sim.objects.household.household_build import build_household, place_household
from sim.objects.household.household_spec import HouseholdSpec
from sim.objects.imported.import_place import place_imported
from sim.objects.imported.imported_build import build_imported
from sim.objects.imported.imported_spec import ImportedSpec, ImportOptions, import_spec
from sim.objects.imported.partnet import JOINT_MARK, PREFIX, URDF, load_folder, with_joint
from sim.objects.object_record import read_record, spec_text, write_record
from sim.objects.part_spec import BuiltObject, PartSpec
from sim.objects.placement import Placement, place
from sim.objects.suites.catalogue import ALL_SUITES, load_spec
from sim.objects.suites.furniture_build import build_furniture
from sim.objects.suites.furniture_place import place_furniture
from sim.objects.suites.furniture_spec import FurnitureSpec


def find_spec(
    name: str, seed: int, joint: str | None = None, options: ImportOptions | None = None
) -> PartSpec:
    """The object called `name`, as met with `seed`.

    Args:
        name: `door`, `drawer`, SUITE/NAME, a URDF file, or a PartNet-Mobility folder, with or
            without `partnet:` before it. A joint may stand after a `#`: `chest.urdf#slide_2`.
        seed: of what varies from one meeting to the next.
        joint: which joint of a URDF file or a folder is free; needed where several move.
        options: what else to say of a URDF file or a folder.

    Raises:
        ValueError: no object of that name.
        InputError: no such suite, file or joint, or a broken file.
    """
    options = with_joint(options, joint or "")
    imported = _find_imported(name, seed, options)
    if imported is not None:
        return imported
    if options.joint is not None:
        raise InputError(name, "has one joint, and none can be chosen", "no joint, or a URDF file")
    if "/" in name:
        return load_spec(name, seed)
    if name not in OBJECT_NAMES:
        known = ", ".join(OBJECT_NAMES)
        raise ValueError(
            f"object {name!r}, expected one of {known}, SUITE/NAME, a URDF file or a folder"
        )
    return sample_object(name, seed)


def _find_imported(name: str, seed: int, options: ImportOptions) -> ImportedSpec | None:
    """The object of a file or folder; None where the name means neither."""
    place, _, marked = name.removeprefix(PREFIX).partition(JOINT_MARK)
    if options.joint is None:
        options = with_joint(options, marked)
    path = Path(place)
    if place.lower().endswith(".urdf"):
        return import_spec(name, path, seed, options)
    if place in OBJECT_NAMES or place.partition("/")[0] in ALL_SUITES:
        return None
    if name.startswith(PREFIX) or path.is_dir():
        if not (path / URDF).is_file():
            raise InputError(path, f"has no {URDF}", "a PartNet-Mobility folder, FOLDER/ID")
        return load_folder(path, seed, options, name)
    return None


def stage(spec: PartSpec, kinematics: FrankaKinematics) -> tuple[BuiltObject, Placement]:
    """The object's files, from the cache or built now, and a place that the arm can work at.

    Raises:
        MotionInfeasible: there is no such place.
    """

    def make(folder: Path) -> None:
        write_record(folder, *build_and_place(spec, folder, kinematics))

    # Where a file lies and how it is called does not matter: its content is in the spec.
    text = spec_text(
        replace(spec, urdf=Path(), name="") if isinstance(spec, ImportedSpec) else spec
    )
    readable = "user" if isinstance(spec, ImportedSpec) else spec.name.replace("/", "-")
    return read_record(kept(f"{readable}-{digest(code_digest(), text)}", make), spec)


def build_and_place(
    spec: PartSpec, folder: Path, kinematics: FrankaKinematics
) -> tuple[BuiltObject, Placement]:
    """Builds the object's files in `folder` and finds it a place, without the cache.

    Raises:
        MotionInfeasible: there is no such place.
    """
    if isinstance(spec, FurnitureSpec):
        built = build_furniture(spec, folder)
        return built, place_furniture(built, spec, kinematics)
    if isinstance(spec, HouseholdSpec):
        built = build_household(spec, folder)
        return built, place_household(built, spec, kinematics)
    if isinstance(spec, ImportedSpec):
        built = build_imported(spec, folder)
        return built, place_imported(built, spec, kinematics)
    assert isinstance(spec, ObjectSpec)
    built = build_object(spec, folder)
    return built, place(built, kinematics)
