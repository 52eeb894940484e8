"""A suite's objects, and what of a user's files cannot be used."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from akm_fg.errors import InputError
from sim.objects.household.household_spec import HouseholdSpec
from sim.objects.imported.imported_spec import ImportedSpec, ImportOptions, import_spec
from sim.objects.imported.partnet import (
    JOINT_MARK,
    PREFIX,
    URDF,
    PartnetSuite,
    Skipped,
    load_folder,
)
from sim.objects.suites.catalogue import ALL_SUITES, find_suite
from sim.objects.suites.furniture_spec import FurnitureSpec
from sim.objects.urdf.urdf_reader import read_urdf

PARTNET = PREFIX.rstrip(":")


@dataclass(frozen=True, slots=True)
class Listing:
    """Objects as met with one seed."""

    suite: str
    split: str
    specs: tuple[FurnitureSpec | HouseholdSpec | ImportedSpec, ...]
    skipped: tuple[Skipped, ...] = ()


def list_suite(name: str, folder: Path | None, seed: int, scale: float | None = None) -> Listing:
    """The objects of a suite of furniture, or of a user's folder or URDF file.

    Args:
        name: of the suite; `partnet` for a user's files, `partnet:FOLDER` says where at once.
        folder: FOLDER with FOLDER/ID/mobility.urdf, one such object, or a URDF file.
        seed: of the meeting.
        scale: of a user's files, what every length is multiplied by; None: see `ImportOptions`.

    Raises:
        InputError: no such suite, or a folder or file without any object.
    """
    if name.startswith(PREFIX):
        name, folder = PARTNET, Path(name.removeprefix(PREFIX))
    if name != PARTNET:
        if name not in ALL_SUITES:
            known = ", ".join([*ALL_SUITES, f"{PARTNET} (with --folder)"])
            raise InputError(f"suite {name}", "not known", f"one of {known}")
        if folder is not None:
            raise InputError(f"--folder {folder}", f"not for {name}", f"--suite {PARTNET}")
        if scale is not None:
            raise InputError(f"--scale {scale:g}", f"not for {name}", f"--suite {PARTNET}")
        suite = find_suite(name)
        specs = tuple(suite.load(short, seed) for short in suite.names())
        return Listing(name, suite.split, specs)
    if folder is None:
        raise InputError(f"--suite {PARTNET}", "no folder is given", "--folder FOLDER")
    if folder.suffix.lower() == ".urdf" or (folder / URDF).is_file():
        return _list_joints(folder, seed, scale)
    partnet = PartnetSuite(folder)
    sound, skipped = partnet.sound(seed, ImportOptions(scale=scale))
    return Listing(partnet.name, partnet.split, tuple(sound), tuple(skipped))


def _list_joints(place: Path, seed: int, scale: float | None) -> Listing:
    """Each joint of one object that could be free."""
    alone = place.suffix.lower() == ".urdf"
    model = read_urdf(place if alone else place / URDF)
    joints = [joint.name for joint in model.movable()] or [model.joint(None).name]
    specs = []
    for joint in joints:
        name = f"{'' if alone else PREFIX}{place}{JOINT_MARK}{joint}"
        options = ImportOptions(joint=joint, scale=scale)
        if alone:
            specs.append(import_spec(name, place, seed, options))
        else:
            specs.append(load_folder(place, seed, options, name))
    return Listing(str(place), "user", tuple(specs))
