"""Writes a user's object in the form of all others: corpus, part, one joint, closed at 0."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import trimesh

from akm_fg.records import FloatArray
from sim.cache import digest
from sim.objects.imported.assembly import assemble
from sim.objects.imported.collision_pieces import link_pieces
from sim.objects.imported.imported_spec import ImportedSpec
from sim.objects.imported.surfaces import Surface
from sim.objects.meshes import inertia_of_solids
from sim.objects.obj_files import IntArray, Patch, joined, write_obj, write_solid
from sim.objects.part_spec import BuiltObject, middle_of_front, standard_range
from sim.objects.placement import opened
from sim.objects.urdf.urdf_files import (
    CORPUS_KG,
    INERTIA_MIN,
    OBJECT_URDF,
    inertial_element,
    joint_element,
    write_object,
)
from sim.objects.urdf.urdf_reader import read_urdf

GRIP_STATES = 5  # of the part, at which the hand needs its room


def build_imported(spec: ImportedSpec, folder: Path) -> BuiltObject:
    """Writes the object's files into `folder`; the same file and spec give the same bytes."""
    model = read_urdf(spec.urdf, spec.allowed)
    joint = model.joint(spec.joint)
    found = assemble(model, joint, spec.scale, 1.0, spec.front)
    built = BuiltObject(
        spec=spec,
        urdf=folder / OBJECT_URDF,
        axis_object=found.axis,
        pivot_object=found.pivot,
        T_object_handle=spec.handle.pose(),
        p_object_front=middle_of_front(np.concatenate([s.points for s in found.part])),
        handle_thickness_m=spec.handle.thickness_m,
    )
    states = np.linspace(0.0, standard_range(spec), GRIP_STATES)
    grips = [opened(built, float(q)) * built.T_object_handle for q in states]
    hard = link_pieces("corpus", found.collision_corpus, grips)
    hard_part = link_pieces("part", found.collision_part, grips[:1])  # the hand goes with it
    still = _link("corpus", found.corpus, hard, np.zeros(3), CORPUS_KG, folder)
    moving = _link("part", found.part, hard_part, -found.pivot, spec.mass_kg, folder)
    part_joint = joint_element(spec, found.pivot, found.axis)
    write_object(f"{spec.family} {spec.joint}", still, [moving, part_joint], folder)
    return built


def _link(
    name: str,
    seen: Sequence[Surface],
    hard: Sequence[FloatArray],
    shift: FloatArray,
    mass_kg: float,
    folder: Path,
) -> ET.Element:
    """One body's element; its meshes go into `folder`, shifted into its frame."""
    hulls = [trimesh.convex.convex_hull(piece + shift) for piece in hard]
    link = ET.Element("link", name=name)
    link.append(inertial_element(mass_kg, *inertia_of_hulls(hulls, mass_kg)))
    for i, group in enumerate(_by_looks(seen)):
        mesh = folder / f"{name}_{i:03d}.obj"
        _write_visual(mesh, group, shift)
        geometry = ET.SubElement(ET.SubElement(link, "visual"), "geometry")
        ET.SubElement(geometry, "mesh", filename=mesh.name)
    for i, hull in enumerate(hulls):
        mesh = folder / f"{name}_hull_{i:03d}.obj"
        write_solid(mesh, hull)
        geometry = ET.SubElement(ET.SubElement(link, "collision"), "geometry")
        ET.SubElement(geometry, "mesh", filename=mesh.name)
    return link


def inertia_of_hulls(
    hulls: Sequence[trimesh.Trimesh], mass_kg: float
) -> tuple[FloatArray, FloatArray]:
    """Centre of mass (3,) and inertia (3, 3) about it of solids that share `mass_kg` by volume."""
    if not hulls:
        return np.zeros(3), mass_kg * 1e-2 * np.eye(3)
    com, inertia = inertia_of_solids(hulls, mass_kg)
    return com, inertia + INERTIA_MIN * np.eye(3)


def _by_looks(surfaces: Sequence[Surface]) -> list[list[Surface]]:
    """Surfaces of one colour or picture together, in the order of the file."""
    groups: dict[str, list[Surface]] = {}
    for surface in surfaces:
        picture = b"" if surface.image is None else surface.image.tobytes()
        groups.setdefault(digest(repr(surface.rgb), picture), []).append(surface)
    return list(groups.values())


def _write_visual(path: Path, surfaces: Sequence[Surface], shift: FloatArray) -> None:
    """One OBJ of surfaces that look the same; their picture goes beside it."""
    colour, image = surfaces[0].rgb, surfaces[0].image
    texture = None
    if image is not None:
        texture, colour = f"{path.stem}.png", (1.0, 1.0, 1.0)
        cv2.imwrite(str(path.with_name(texture)), image[..., ::-1])
    write_obj(path, joined([_patch(surface, shift) for surface in surfaces]), texture, colour)


def _patch(surface: Surface, shift: FloatArray) -> Patch:
    """The surface moved by `shift` (3,), with normals, and texture coordinates of some kind."""
    vertex, normals, faces = _corners(surface)
    uv = np.zeros((len(vertex), 2)) if surface.uv is None else surface.uv[vertex]
    uv = uv - np.floor(uv.min(axis=0))  # TinyRenderer wraps positive coordinates alone
    return Patch(surface.points[vertex] + shift, normals, uv, faces)


def _corners(surface: Surface) -> tuple[IntArray, FloatArray, IntArray]:
    """Vertices (W,) of the surface, split at its edges; their normals (W, 3); faces (F, 3) of them.

    Faces share a corner where their normals point to the same of 26 directions: round things are
    shaded round, boxes keep their edges.
    """
    a, b, c = (surface.points[surface.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    bins = np.rint(1.2 * normals / np.maximum(lengths, 1e-15)).astype(np.int64)
    keys = np.column_stack([surface.faces.reshape(-1), np.repeat(bins, 3, axis=0)])
    corners, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.reshape(-1)
    sums = np.stack([np.bincount(group, np.repeat(x, 3)) for x in normals.T], axis=-1)
    unit = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-15)
    return corners[:, 0].astype(np.int64), np.asarray(unit), group.reshape(-1, 3).astype(np.int64)
