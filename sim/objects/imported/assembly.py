"""A URDF with one joint free and the rest closed and fixed, in the object frame.

Object frame: x along the front, y into the object, z up, origin on the floor under the middle of
the closed object. Which side is the front, files do not say either: it is the side towards which
the part sets out (a drawer, a door), for a lid the side of its free edge, for a panel that slides
within the object the side on which it lies; else -x, as in PartNet-Mobility.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.records import FloatArray
from sim.objects.imported.closed_state import Opening, closed_states, moved, opening
from sim.objects.imported.surfaces import Surface, surfaces_of
from sim.objects.urdf.mesh_paths import shown_mesh
from sim.objects.urdf.urdf_model import Joint, Link, Shape, UrdfModel

SETS_OUT = 0.5  # cosine from which the way a part sets out names its front
LARGE_M = 20.0  # no object is larger, and hardly a room
SIZES_M = (1e-3, 1e4)  # what is smaller or larger is none at all
THIN = 0.6  # of a panel's extent along its way
FRONTS = {"+x": (1.0, 0.0), "-x": (-1.0, 0.0), "+y": (0.0, 1.0), "-y": (0.0, -1.0)}


@dataclass(frozen=True, slots=True)
class Assembly:
    """Surfaces of corpus and part at the closed state, and the joint, in the object frame."""

    corpus: list[Surface]
    part: list[Surface]
    collision_corpus: list[Surface]
    collision_part: list[Surface]
    axis: FloatArray  # (3,) unit; the part opens along it
    pivot: FloatArray  # (3,) a point of the axis
    travel: float  # m or rad
    opening: Opening  # as in the file
    size_m: FloatArray  # (3,)
    scale: float  # by which the file's lengths were multiplied
    notes: tuple[str, ...]  # what of the file is probably not meant as it is written


def assemble(
    model: UrdfModel, joint: Joint, scale: float | None, side_m: float, front: str | None
) -> Assembly:
    """Puts the object together.

    Args:
        model: the file.
        joint: the one that stays free.
        scale: by which every length of the file is multiplied; None: what makes the largest side
            `side_m` metres.
        side_m: see `scale`.
        front: which side of the file's frame is the front, one of FRONTS; None: see above.

    Raises:
        InputError: nothing to be seen of the part, or no size that an object can have.
    """
    seen = {link.name: _seen(link, model) for link in _links(model)}
    hard = {link.name: _collisions(link, seen[link.name], model) for link in _links(model)}
    points = {name: _points(found) for name, found in seen.items()}
    below = model.below(joint)
    if not any(len(points[name]) for name in below):
        why = "; ".join([*model.notes, *_empty_meshes(model, seen)])
        wrong = f"joint {joint.name!r} moves nothing that can be seen{why and f' ({why})'}"
        raise InputError(model.path, wrong, "a link with a visual below it")
    opens = opening(model, joint, points)
    poses = model.T_root_links(closed_states(model, points))
    T_root_joint = poses[joint.parent] * joint.T_parent_joint
    axis = opens.sign * (T_root_joint.rotation().matrix() @ joint.axis)
    at = {name: moved(poses[name], p) for name, p in points.items() if len(p)}
    everything = np.concatenate(list(at.values()))
    part = np.concatenate([p for name, p in at.items() if name in below])
    way = _front(part, everything, axis, T_root_joint.translation(), joint.kind, opens.travel)
    T = _object_from_root(np.array(FRONTS[front]) if front else way, everything)
    size = np.ptp(moved(T, everything), axis=0)
    largest = float(size.max())
    factor = side_m / max(largest, 1e-12) if scale is None else scale
    travel = opens.travel * (factor if joint.kind == "prismatic" else 1.0)
    notes = (*model.notes, *_empty_meshes(model, seen), *_size_notes(model, largest, factor))
    _check_part(model, joint, float(np.ptp(part, axis=0).max()) * factor, travel)
    T_of = {name: T * T_root_link for name, T_root_link in poses.items()}
    return Assembly(
        corpus=_placed(seen, T_of, factor, set(seen) - below),
        part=_placed(seen, T_of, factor, below),
        collision_corpus=_placed(hard, T_of, factor, set(hard) - below),
        collision_part=_placed(hard, T_of, factor, below),
        axis=T.rotation().matrix() @ axis,
        pivot=T.transformFrom(T_root_joint.translation()) * factor,
        travel=travel,
        opening=opens,
        size_m=size * factor,
        scale=factor,
        notes=tuple(dict.fromkeys(notes)),
    )


def _check_part(model: UrdfModel, joint: Joint, side_m: float, travel: float) -> None:
    """Raises InputError for a part without size, or a way (m or rad) that nothing goes."""
    if not side_m >= SIZES_M[0]:
        wrong = f"the largest side of what joint {joint.name!r} moves is {side_m:.3g} m"
        raise InputError(model.path, wrong, f"{SIZES_M[0]:g} m or more")
    if not travel <= SIZES_M[1]:
        unit = "m" if joint.kind == "prismatic" else "rad"
        wrong = f"joint {joint.name!r} goes over {travel:.3g} {unit}"
        raise InputError(model.path, wrong, f"limits in metres or radians, up to {SIZES_M[1]:g}")


def _empty_meshes(model: UrdfModel, seen: dict[str, list[Surface]]) -> list[str]:
    """A note for each visual mesh of which there is nothing to be seen."""
    full = {surface.mesh_file for surfaces in seen.values() for surface in surfaces}
    return [
        f"mesh {shown_mesh(shape.mesh, model.path)!r} of link {link.name!r} is empty; left out"
        for link in _links(model)
        for shape in link.visuals
        if shape.mesh is not None and shape.mesh not in full
    ]


def _size_notes(model: UrdfModel, largest: float, scale: float) -> list[str]:
    """What is to be said of the size of an object.

    Args:
        model: the file.
        largest: side of the whole object, the file's lengths.
        scale: by which they are multiplied.

    Raises:
        InputError: nothing has such a size.
    """
    size_m = largest * scale
    if not SIZES_M[0] <= size_m <= SIZES_M[1]:
        wrong = f"the object's largest side is {size_m:.3g} m"
        raise InputError(model.path, wrong, f"metres, {SIZES_M[0]:g} to {SIZES_M[1]:g}")
    if size_m <= LARGE_M:
        return []
    told = f"the object's largest side is {size_m:.4g} m: probably millimetres"
    return [f"{told}; write lengths in metres (meshes: scale='0.001 0.001 0.001')"]


def _placed(
    of_link: dict[str, list[Surface]], T_of: dict[str, gtsam.Pose3], scale: float, wanted: set[str]
) -> list[Surface]:
    """The wanted links' surfaces, moved by their link's pose, then scaled; in the file's order."""
    return [
        surface.moved(T_of[name]).scaled(scale)
        for name, surfaces in of_link.items()
        if name in wanted
        for surface in surfaces
    ]


def _links(model: UrdfModel) -> list[Link]:
    return list(model.links.values())


def _surfaces(link: Link, shapes: tuple[Shape, ...], model: UrdfModel) -> list[Surface]:
    found = [surface for shape in shapes for surface in surfaces_of(shape, model.path)]
    return [replace(surface, link=link.name) for surface in found]


def _seen(link: Link, model: UrdfModel) -> list[Surface]:
    there = tuple(s for s in link.collisions if s.mesh is None or s.mesh.is_file())
    return _surfaces(link, link.visuals or there, model)


def _collisions(link: Link, seen: list[Surface], model: UrdfModel) -> list[Surface]:
    """The link's collision shapes; its visual ones where there are none, or a file is missing."""
    if len(link.collisions) == len(link.visuals) and all(map(_same, link.collisions, link.visuals)):
        return seen  # as in PartNet: hundreds of files are read once
    whole = all(shape.mesh is None or shape.mesh.is_file() for shape in link.collisions)
    return (_surfaces(link, link.collisions, model) if whole else []) or seen


def _same(a: Shape, b: Shape) -> bool:
    """Whether both fill the same space."""
    placed = np.array_equal(a.T_link_shape.matrix(), b.T_link_shape.matrix())
    return placed and (a.kind, a.mesh) == (b.kind, b.mesh) and np.array_equal(a.size, b.size)


def _points(surfaces: list[Surface]) -> FloatArray:
    return np.concatenate([s.points for s in surfaces]) if surfaces else np.zeros((0, 3))


def _front(
    part: FloatArray,
    everything: FloatArray,
    axis: FloatArray,
    pivot: FloatArray,
    kind: str,
    travel: float,
) -> FloatArray:
    """(2,) outward direction of the front in the root frame, along x or y."""
    middle = (part.min(axis=0) + part.max(axis=0)) / 2.0
    slides = kind == "prismatic"
    if slides and (panel := _sliding_panel(part, everything, axis, travel)) is not None:
        return panel
    way = axis if slides else np.cross(axis, middle - pivot)
    way = way / max(float(np.linalg.norm(way)), 1e-12)
    if np.abs(way[:2]).max() >= SETS_OUT:
        return _along(way)
    to_edge = middle - pivot
    if not slides and np.linalg.norm(to_edge[:2]) > 0.3 * np.linalg.norm(to_edge) > 0.0:
        return _along(to_edge)
    return np.array(FRONTS["-x"])


def _sliding_panel(
    part: FloatArray, everything: FloatArray, axis: FloatArray, travel: float
) -> FloatArray | None:
    """The side of a thin panel that moves within the object, or None where it is no such panel."""
    extent, low, high = np.ptp(part, axis=0), everything.min(axis=0), everything.max(axis=0)
    along = int(np.abs(axis).argmax())
    across = 1 - along if along < 2 else int(extent[:2].argmin())
    opened = part + axis * travel
    over = max(float((low - opened.min(axis=0)).max()), float((opened.max(axis=0) - high).max()))
    if extent[across] > THIN * extent[along] or over > 0.5 * travel:
        return None
    off = (part.min(axis=0) + part.max(axis=0) - low - high)[across]
    direction = np.zeros(2)
    direction[across] = 1.0 if off > 0.0 else -1.0
    return direction


def _along(way: FloatArray) -> FloatArray:
    direction = np.zeros(2)
    k = int(np.abs(way[:2]).argmax())
    direction[k] = np.sign(way[k])
    return direction


def _object_from_root(front: FloatArray, everything: FloatArray) -> gtsam.Pose3:
    """T_object_root before scaling."""
    into = np.array([-front[0], -front[1], 0.0])
    up = np.array([0.0, 0.0, 1.0])
    R = np.stack([np.cross(into, up), into, up])
    turned = everything @ R.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    middle = (low + high) / 2.0
    return gtsam.Pose3(gtsam.Rot3(R), -np.array([middle[0], middle[1], low[2]]))
