"""What is known of a user's own object: found in its file once, then kept.

Files say little of mass and friction; what they do not say is plausible, varied from object to
object by its content, and stated here.
"""

from __future__ import annotations

import functools
import json
import logging
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from akm_fg.errors import InputError
from akm_fg.records import FloatArray
from sim.cache import code_digest, digest, kept
from sim.objects.imported.assembly import FRONTS, Assembly, assemble
from sim.objects.imported.contact import Contact, find_contact
from sim.objects.imported.surfaces import Surface
from sim.objects.mechanisms import Catch, Closer
from sim.objects.part_spec import Hinge, hinge_side
from sim.objects.urdf.urdf_model import Joint, UrdfModel
from sim.objects.urdf.urdf_reader import read_urdf

LOG = logging.getLogger(__name__)

BOARD_KG_M3 = 600.0  # chipboard
BOARD_M = 0.018  # the part counts as a shell of board, or as solid where that is less
FOUND = "found.json"
MASS_KG = (0.2, 12.0)  # of a part
MASS_SAID_KG = (0.02, 60.0)  # what a file says is believed within these


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """What a caller may say of a file."""

    joint: str | None = None  # the one that is free; needed where several move
    scale: float | None = None  # multiplies every length; None: 1 for a URDF, else by category
    front: str | None = None  # side of the file's frame that faces the robot, one of FRONTS
    contact: tuple[float, float, float] | None = None  # object frame, m: grip near this point
    allowed: Path | None = None  # folder outside the file's own, from which it may name meshes

    def __post_init__(self) -> None:
        if self.scale is not None and not 0.0 < self.scale < np.inf:
            raise InputError("scale", f"{self.scale}", "a number above 0")
        if self.front is not None and self.front not in FRONTS:
            raise InputError("front", f"{self.front!r}", f"one of {', '.join(FRONTS)}")
        if self.allowed is not None and not self.allowed.is_dir():
            raise InputError("--allow", f"{str(self.allowed)!r} is no folder", "a folder of meshes")


@dataclass(frozen=True, slots=True)
class ImportedSpec:
    """One object of a user with one free joint. Everything here is truth."""

    name: str
    seed: int  # of the meeting
    key: tuple[int, ...]  # of the content: what is drawn at random comes from this
    split: str
    family: str  # the file's category
    kind: Literal["prismatic", "revolute"]
    hinge: Hinge | None
    urdf: Path
    content: str  # digest of the file and its meshes
    joint: str
    front: str | None
    closed: float  # state of the file's joint, m or rad before scaling
    opens: float  # +1 or -1: which way the file's state goes as the part opens
    size_m: FloatArray  # (3,) closed, scaled
    scale: float
    mass_kg: float
    damping: float  # N s/m or N m s/rad
    friction: float  # Coulomb, N or N m
    upper: float  # end of the range, m or rad; it begins at 0, closed
    handle_mu: float
    handle: Contact
    balanced: bool  # the joint carries the part's weight
    allowed: Path | None = None  # as in ImportOptions
    catch: Catch | None = None
    closer: Closer | None = None

    @property
    def view_side(self) -> float:
        """Where the hinge stands."""
        return hinge_side(self.hinge)


def content_digest(model: UrdfModel) -> str:
    """Of the file, its meshes and all that lies beside these (materials, pictures)."""
    shapes = [s for link in model.links.values() for s in (*link.visuals, *link.collisions)]
    meshes = {s.mesh for s in shapes if s.mesh is not None and s.mesh.is_file()}
    folders = {mesh.parent for mesh in meshes} | {mesh.parent.parent / "images" for mesh in meshes}
    looks = {
        file
        for folder in folders
        if folder.is_dir()
        for file in folder.iterdir()
        if file.suffix.lower() in (".mtl", ".png", ".jpg", ".jpeg")
    }
    files = sorted({str(path): path for path in meshes | looks}.items())
    contents = [part for name, path in files for part in (Path(name).name, path.read_bytes())]
    return digest(model.path.read_bytes(), *contents)


def import_spec(
    name: str,
    urdf: Path,
    seed: int,
    options: ImportOptions,
    family: str = "urdf",
    side_m: float | None = None,
) -> ImportedSpec:
    """Reads an object's file, or what was found in it before.

    Args:
        name: by which the user calls it.
        urdf: the file.
        seed: varies the scale where `side_m` gives it, and the pose.
        options: what the caller says of it.
        family: category, for lists.
        side_m: the largest side it shall have, where the options give no scale.

    Raises:
        InputError: a broken file, no such joint, or several and none chosen.
    """
    model = read_urdf(urdf, options.allowed)
    joint = model.joint(options.joint)
    content = content_digest(model)
    key = (int(content[:8], 16), model.joints.index(joint))
    if side_m is not None and options.scale is None:
        side_m *= float(np.random.default_rng([*key, seed]).uniform(0.9, 1.1))
    scale = options.scale if options.scale is not None or side_m is not None else 1.0
    said = json.dumps([joint.name, scale, side_m, options.front, options.contact])

    def make(folder: Path) -> None:
        found = assemble(model, joint, scale, side_m or 1.0, options.front)
        fields = _found(found, model, joint, options, key)
        (folder / FOUND).write_text(json.dumps(fields, default=lambda a: a.tolist()))

    fields = _read_found(kept(f"found-{digest(code_digest(), content, said)}", make) / FOUND)
    for note in fields.pop("notes"):
        _say(urdf, note)
    return ImportedSpec(
        name=name,
        seed=seed,
        key=key,
        split="user",
        family=family,
        urdf=urdf,
        content=content,
        joint=joint.name,
        front=options.front,
        allowed=options.allowed,
        **fields,
    )


@functools.cache
def _say(urdf: Path, note: str) -> None:
    """Once a file and run, however many joints it has."""
    LOG.warning("%s: %s", urdf, note)


def _read_found(path: Path) -> dict[str, Any]:
    """What `_found` wrote, with its arrays."""
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    handle = found["handle"]
    T_object_handle = np.array(handle["T_object_handle"])
    contact = Contact(**{**handle, "T_object_handle": T_object_handle})
    return {**found, "size_m": np.array(found["size_m"]), "handle": contact}


def _found(
    found: Assembly,
    model: UrdfModel,
    joint: Joint,
    options: ImportOptions,
    key: tuple[int, ...],
) -> dict[str, Any]:
    """Fields of the spec that come from the file's content."""
    slides = joint.kind == "prismatic"
    hinge = None if slides else _hinge(found)
    given = None if options.contact is None else np.array(options.contact)
    contact = find_contact(found.part, found.corpus, hinge, found.pivot, given)
    offset = contact.T_object_handle[:3, 3] - found.pivot
    lever_m = max(float(np.linalg.norm(np.cross(found.axis, offset))), 0.01)
    rng = np.random.default_rng([*key, 3])
    # Forces at the grip as of furniture: friction 2 to 5 N, damping 3 to 10 N s/m.
    friction_n, damping_n_s_m, mu = (rng.uniform(*r) for r in ((2.0, 5.0), (3.0, 10.0), (0.7, 1.0)))
    return {
        "notes": list(found.notes),
        "kind": "prismatic" if slides else "revolute",
        "hinge": hinge,
        "closed": found.opening.closed,
        "opens": found.opening.sign,
        "size_m": found.size_m,
        "scale": found.scale,
        "mass_kg": _mass(model, joint, found.part, found.scale),
        "damping": joint.damping or float(damping_n_s_m * (1.0 if slides else lever_m**2)),
        "friction": joint.friction or float(friction_n * (1.0 if slides else lever_m)),
        "upper": found.travel,
        "handle_mu": float(mu),
        "handle": asdict(contact),
        "balanced": bool(abs(found.axis[2]) > 0.05 if slides else abs(found.axis[2]) < 0.98),
    }


def _hinge(found: Assembly) -> Hinge:
    points = np.concatenate([surface.points for surface in found.part])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    if abs(found.axis[2]) > 0.7:
        return "left" if found.pivot[0] < middle[0] else "right"
    return "bottom" if found.pivot[2] < middle[2] else "top"


def _mass(model: UrdfModel, joint: Joint, part: list[Surface], scale: float) -> float:
    """What the file says of the links below the joint; else that of a shell of board."""
    said = [model.links[name].mass_kg for name in sorted(model.below(joint))]
    total = sum(m for m in said if m is not None) * scale**3
    if MASS_SAID_KG[0] <= total <= MASS_SAID_KG[1]:
        return float(total)
    points = np.concatenate([surface.points for surface in part])
    area = sum(float(surface.mesh().area) for surface in part)
    volume = min(0.5 * area * BOARD_M, float(np.prod(np.maximum(np.ptp(points, axis=0), 1e-3))))
    return float(np.clip(BOARD_KG_M3 * volume, *MASS_KG))
