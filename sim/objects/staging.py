"""From a name and a seed to an object that stands in front of the robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

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
from sim.objects.published_place import place_as_published
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


PlacementMode = Literal["reachable", "published"]


def stage(
    spec: PartSpec, kinematics: FrankaKinematics, mode: PlacementMode = "reachable"
) -> tuple[BuiltObject, Placement]:
    """The object's files, from the cache or built now, and where it stands.

    Args:
        spec: the object.
        kinematics: of the arm that is to work on it.
        mode: `reachable`, where the arm can open the part all the way, with the grasp for it; or
            `published`, where the paper's ranges put it (`sim.objects.published_place`).

    Raises:
        MotionInfeasible: there is no reachable place.
        ValueError: no such mode.
    """
    if mode not in get_args(PlacementMode):
        raise ValueError(f"placement {mode!r}, expected one of {get_args(PlacementMode)}")

    def make(folder: Path) -> None:
        write_record(folder, *build_and_place(spec, folder, kinematics, mode))

    # Where a file lies and how it is called does not matter: its content is in the spec.
    text = spec_text(
        replace(spec, urdf=Path(), name="") if isinstance(spec, ImportedSpec) else spec
    )
    readable = "user" if isinstance(spec, ImportedSpec) else spec.name.replace("/", "-")
    return read_record(kept(f"{readable}-{digest(code_digest(), text, mode)}", make), spec)


def build_and_place(
    spec: PartSpec, folder: Path, kinematics: FrankaKinematics, mode: PlacementMode = "reachable"
) -> tuple[BuiltObject, Placement]:
    """Builds the object's files in `folder` and finds it a place, without the cache.

    Raises:
        MotionInfeasible: there is no reachable place.
    """
    built = _build(spec, folder)
    if mode == "published":
        return built, place_as_published(built)
    if isinstance(spec, FurnitureSpec):
        return built, place_furniture(built, spec, kinematics)
    if isinstance(spec, HouseholdSpec):
        return built, place_household(built, spec, kinematics)
    if isinstance(spec, ImportedSpec):
        return built, place_imported(built, spec, kinematics)
    return built, place(built, kinematics)


def _build(spec: PartSpec, folder: Path) -> BuiltObject:
    if isinstance(spec, FurnitureSpec):
        return build_furniture(spec, folder)
    if isinstance(spec, HouseholdSpec):
        return build_household(spec, folder)
    if isinstance(spec, ImportedSpec):
        return build_imported(spec, folder)
    assert isinstance(spec, ObjectSpec)
    return build_object(spec, folder)
