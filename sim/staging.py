"""From a name and a seed to an object that stands in front of the robot."""

from __future__ import annotations

from pathlib import Path

from sim.cache import code_digest, digest, kept
from sim.kinematics import FrankaKinematics
from sim.object_record import read_record, spec_text, write_record
from sim.objects import OBJECT_NAMES, BuiltObject, ObjectSpec, PartSpec, build_object, sample_object
from sim.placement import Placement, place
from sim.suites.catalogue import load_spec
from sim.suites.furniture_build import build_furniture
from sim.suites.furniture_place import place_furniture
from sim.suites.furniture_spec import FurnitureSpec


def find_spec(name: str, seed: int) -> PartSpec:
    """The object called `door`, `drawer` or SUITE/NAME, as met with `seed`.

    Raises:
        ValueError: neither `door` nor `drawer`.
        InputError: no such suite, or no such object in it.
    """
    if "/" in name:
        return load_spec(name, seed)
    if name not in OBJECT_NAMES:
        known = ", ".join(OBJECT_NAMES)
        raise ValueError(f"object {name!r}, expected one of {known}, or SUITE/NAME")
    return sample_object(name, seed)


def stage(spec: PartSpec, kinematics: FrankaKinematics) -> tuple[BuiltObject, Placement]:
    """The object's files, from the cache or built now, and a place that the arm can work at.

    Raises:
        MotionInfeasible: there is no such place.
    """

    def make(folder: Path) -> None:
        write_record(folder, *_build_and_place(spec, folder, kinematics))

    text = spec_text(spec)
    readable = spec.name.replace("/", "-")
    return read_record(kept(f"{readable}-{digest(code_digest(), text)}", make), spec)


def _build_and_place(
    spec: PartSpec, folder: Path, kinematics: FrankaKinematics
) -> tuple[BuiltObject, Placement]:
    if isinstance(spec, FurnitureSpec):
        built = build_furniture(spec, folder)
        return built, place_furniture(built, spec, kinematics)
    assert isinstance(spec, ObjectSpec)
    built = build_object(spec, folder)
    return built, place(built, kinematics)
