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
from sim.objects.imported.convex import convex_pieces
from sim.objects.imported.imported_spec import ImportedSpec
from sim.objects.imported.surfaces import IntArray, Surface
from sim.objects.part_spec import BuiltObject
from sim.objects.urdf.urdf_files import CORPUS_KG, inertial_element, joint_element, write_object
from sim.objects.urdf.urdf_reader import read_urdf

INERTIA_MIN = 1e-5  # kg m^2, of the smallest parts: keeps the solver sound


def build_imported(spec: ImportedSpec, folder: Path) -> BuiltObject:
    """Writes the object's files into `folder`; the same file and spec give the same bytes."""
    model = read_urdf(spec.urdf)
    joint = model.joint(spec.joint)
    found = assemble(model, joint, spec.scale, 1.0, spec.front)
    shift = -found.pivot
    still = _link("corpus", found.corpus, found.collision_corpus, np.zeros(3), CORPUS_KG, folder)
    moving = _link("part", found.part, found.collision_part, shift, spec.mass_kg, folder)
    part_joint = joint_element(spec, found.pivot, found.axis)
    urdf = write_object(spec.name, still, moving, part_joint, folder)
    points = np.concatenate([surface.points for surface in found.part])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    return BuiltObject(
        spec=spec,
        urdf=urdf,
        axis_object=found.axis,
        pivot_object=found.pivot,
        T_object_handle=spec.handle.pose(),
        p_object_front=np.array([middle[0], points[:, 1].min(), middle[2]]),
        handle_thickness_m=spec.handle.thickness_m,
    )


def _link(
    name: str,
    seen: Sequence[Surface],
    hard: Sequence[Surface],
    shift: FloatArray,
    mass_kg: float,
    folder: Path,
) -> ET.Element:
    """One body's element; its meshes go into `folder`, shifted into its frame."""
    pieces = [p + shift for s in hard for p in convex_pieces(s.points, s.faces)]
    hulls = [trimesh.convex.convex_hull(piece) for piece in pieces]
    link = ET.Element("link", name=name)
    link.append(inertial_element(mass_kg, *inertia_of_hulls(hulls, mass_kg)))
    for i, group in enumerate(_by_looks(seen)):
        mesh = folder / f"{name}_{i:03d}.obj"
        _write_visual(mesh, group, shift)
        geometry = ET.SubElement(ET.SubElement(link, "visual"), "geometry")
        ET.SubElement(geometry, "mesh", filename=mesh.name)
    for i, hull in enumerate(hulls):
        mesh = folder / f"{name}_hull_{i:03d}.obj"
        _write_hull(mesh, hull)
        geometry = ET.SubElement(ET.SubElement(link, "collision"), "geometry")
        ET.SubElement(geometry, "mesh", filename=mesh.name)
    return link


def inertia_of_hulls(
    hulls: Sequence[trimesh.Trimesh], mass_kg: float
) -> tuple[FloatArray, FloatArray]:
    """Centre of mass (3,) and inertia (3, 3) about it of solids that share `mass_kg` by volume."""
    if not hulls:
        return np.zeros(3), mass_kg * 1e-2 * np.eye(3)
    volumes = np.array([max(hull.volume, 1e-12) for hull in hulls])
    density = mass_kg / volumes.sum()
    centres = np.array([hull.center_mass for hull in hulls])
    com = volumes @ centres / volumes.sum()
    inertia = INERTIA_MIN * np.eye(3)
    for hull, volume, centre in zip(hulls, volumes, centres, strict=True):
        r = centre - com
        inertia += density * hull.moment_inertia
        inertia += density * volume * (r @ r * np.eye(3) - np.outer(r, r))
    return com, inertia


def _by_looks(surfaces: Sequence[Surface]) -> list[list[Surface]]:
    """Surfaces of one colour or picture together, in the order of the file."""
    groups: dict[str, list[Surface]] = {}
    for surface in surfaces:
        picture = b"" if surface.image is None else surface.image.tobytes()
        groups.setdefault(digest(repr(surface.rgb), picture), []).append(surface)
    return list(groups.values())


def _write_visual(path: Path, surfaces: Sequence[Surface], shift: FloatArray) -> None:
    """One OBJ of one material; PyBullet shows only the first of several."""
    lines, first = [f"mtllib {path.stem}.mtl", "usemtl surface"], 1
    for surface in surfaces:
        added, count = _surface_lines(surface, shift, first)
        lines, first = lines + added, first + count
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    colour, picture = surfaces[0].rgb, ""
    if surfaces[0].image is not None:
        cv2.imwrite(str(path.with_suffix(".png")), surfaces[0].image[..., ::-1])
        colour, picture = (1.0, 1.0, 1.0), f"map_Kd {path.stem}.png\n"
    kd = " ".join(f"{c:.4f}" for c in colour)
    text = f"newmtl surface\nKa {kd}\nKd {kd}\nKs 0 0 0\n{picture}"
    path.with_suffix(".mtl").write_text(text, encoding="utf-8")


def _surface_lines(surface: Surface, shift: FloatArray, first: int) -> tuple[list[str], int]:
    """OBJ lines, vertices numbered from `first`, and how many vertices there are."""
    vertex, normals, faces = _corners(surface)
    points = surface.points[vertex] + shift
    uv = np.zeros((len(points), 2)) if surface.uv is None else surface.uv[vertex]
    uv = uv - np.floor(uv.min(axis=0))  # TinyRenderer wraps positive coordinates alone
    lines = []
    for p, t, n in zip(points, uv, normals, strict=True):
        lines.append(f"v {p[0]:.6f} {p[1]:.6f} {p[2]:.6f}")
        lines.append(f"vt {t[0]:.6f} {t[1]:.6f}")
        lines.append(f"vn {n[0]:.4f} {n[1]:.4f} {n[2]:.4f}")
    for face in faces + first:
        lines.append("f " + " ".join(f"{k}/{k}/{k}" for k in face))
    return lines, len(points)


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


def _write_hull(path: Path, hull: trimesh.Trimesh) -> None:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in hull.vertices]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in hull.faces]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
