"""A user's folder of PartNet-Mobility objects as a suite.

Layout: FOLDER/ID/mobility.urdf with its meshes (textured_objs/*.obj, *.mtl), pictures (images/)
and, if there, meta.json. The data are licensed for research; none are shipped or needed.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from akm_fg.errors import InputError
from sim.objects.imported.imported_spec import ImportedSpec, ImportOptions, import_spec
from sim.objects.urdf.urdf_reader import read_urdf

LOG = logging.getLogger(__name__)

PREFIX = "partnet:"
URDF = "mobility.urdf"
JOINT_MARK = "#"  # FOLDER/ID#JOINT, where several joints of an object move
# The models have no true size. Their largest side becomes that of such a thing, and a tenth more
# or less by the seed.
LARGEST_SIDE_M = {
    "StorageFurniture": 0.85,
    "Table": 0.9,
    "Refrigerator": 1.4,
    "Dishwasher": 0.85,
    "Oven": 0.85,
    "Microwave": 0.5,
    "WashingMachine": 0.85,
    "Safe": 0.5,
    "Door": 1.8,
    "Window": 1.0,
    "TrashCan": 0.6,
    "Toilet": 0.75,
    "Box": 0.5,
    "Suitcase": 0.65,
    "Laptop": 0.36,
    "KitchenPot": 0.35,
    "Bucket": 0.4,
}
OTHER_SIDE_M = 0.7


@dataclass(frozen=True, slots=True)
class Skipped:
    """An object that cannot be used, and why, on one line."""

    name: str
    problem: str


@dataclass(frozen=True, slots=True)
class PartnetSuite:
    """Every movable joint of every object of a folder; one is free, the others closed and fixed."""

    folder: Path
    split: str = "user"

    @property
    def name(self) -> str:
        """partnet:FOLDER."""
        return f"{PREFIX}{self.folder}"

    def __post_init__(self) -> None:
        if not self.folder.is_dir():
            raise InputError(self.folder, "no such folder", f"FOLDER/ID/{URDF}")
        if not self._objects():
            raise InputError(self.folder, "has no PartNet-Mobility objects", f"FOLDER/ID/{URDF}")

    def __iter__(self) -> Iterator[ImportedSpec]:
        """Every sound object as met with seed 0; what is wrong with the others is logged."""
        specs, skipped = self.sound(0)
        for bad in skipped:
            LOG.warning("%s is left out: %s", bad.name, bad.problem)
        return iter(specs)

    def load(self, name: str, seed: int = 0, options: ImportOptions | None = None) -> ImportedSpec:
        """One object, its joint named in `name` or in the options.

        Raises:
            InputError: no such object, or a broken one, or several joints and none chosen.
        """
        identity, _, joint = name.partition(JOINT_MARK)
        if identity not in self._objects():
            known = ", ".join(list(self._objects())[:5])
            raise InputError(f"{self.folder}/{name}", "no such object", f"one of {known}, ...")
        return load_folder(
            self.folder / identity, seed, with_joint(options, joint), f"{self.name}/{name}"
        )

    def sound(
        self, seed: int, options: ImportOptions | None = None
    ) -> tuple[list[ImportedSpec], list[Skipped]]:
        """What can be used, and what cannot; the suite goes on without the latter."""
        names, skipped = self._named()
        specs = []
        for name in names:
            try:
                specs.append(self.load(name, seed, options))
            except InputError as error:
                skipped.append(Skipped(f"{self.name}/{name}", str(error)))
        return specs, skipped

    def _named(self) -> tuple[tuple[str, ...], list[Skipped]]:
        """ID, or ID#JOINT where several joints move; and the files that cannot be read."""
        names: list[str] = []
        skipped = []
        for identity in self._objects():
            try:
                model = read_urdf(self.folder / identity / URDF)
                joints = [joint.name for joint in model.movable()]
                if not joints:
                    model.joint(None)  # says so
            except InputError as error:
                skipped.append(Skipped(f"{self.name}/{identity}", str(error)))
                continue
            several = len(joints) > 1
            names += [f"{identity}{JOINT_MARK}{j}" if several else identity for j in joints]
        return tuple(names), skipped

    def _objects(self) -> tuple[str, ...]:
        found = [path.parent.name for path in self.folder.glob(f"*/{URDF}")]
        return tuple(sorted(found, key=lambda name: (len(name), name)))


def load_folder(
    folder: Path, seed: int, options: ImportOptions, name: str | None = None
) -> ImportedSpec:
    """The object of one PartNet-Mobility folder.

    Raises:
        InputError: a broken object, or several joints and none chosen.
    """
    category = _category(folder)
    side_m = LARGEST_SIDE_M.get(category, OTHER_SIDE_M)
    return import_spec(
        name or f"{PREFIX}{folder}", folder / URDF, seed, options, category, side_m=side_m
    )


def with_joint(options: ImportOptions | None, joint: str) -> ImportOptions:
    """The options with the joint that a name gives, where it gives one."""
    options = options or ImportOptions()
    if not joint:
        return options
    return replace(options, joint=joint)


def _category(folder: Path) -> str:
    """`model_cat` of meta.json, where there is one."""
    try:
        meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
        return str(meta["model_cat"])
    except (OSError, ValueError, KeyError, TypeError):
        return "unknown"
