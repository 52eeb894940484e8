"""The Franka's looks with fewer triangles, made once and kept.

The visual meshes that come with PyBullet have 100 000 triangles, most of them far smaller than a
pixel; drawing them takes longer than drawing the furniture. Vertices that share a cell of a few
millimetres are merged, with their normals averaged so that the shading stays smooth. Physics uses
the collision meshes as they are.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from akm_fg.arm.body.description import ArmDescription
from akm_fg.records import FloatArray
from sim.cache import digest, kept
from sim.objects.obj_files import IntArray

CELL_M = 0.006  # three or four pixels at one metre; averaged normals keep it round
PALETTE = 16  # fields along a side of the palette texture: vertices in different ones stay apart
VERSION = 2  # of what is written: a change here makes it anew


@dataclass(frozen=True, slots=True)
class Triangles:
    """Triangles of one mesh in shapes of one material each."""

    p_link: FloatArray  # (V, 3)
    uv: FloatArray  # (V, 2) into the palette that is the robot's texture
    normals: FloatArray  # (V, 3)
    faces: IntArray  # (F, 3) of vertices
    materials: list[str]  # of each shape, by name
    shapes: IntArray  # (F,) of each face, growing


def light_panda_urdf(robot: ArmDescription) -> Path:
    """The robot's URDF with merged visual meshes, from the cache or made now (about a second).

    It holds the collision meshes too: an entry outlives the installation that it was made from.
    """
    text = robot.urdf.read_text(encoding="utf-8")
    meshes = sorted((robot.urdf.parent / "meshes").glob("*/*"))
    source = digest(text, *(f"{path.name} {path.stat().st_size}" for path in meshes))
    name = f"panda-{VERSION}-{1e3 * CELL_M:.0f}mm-{source}"
    return kept(name, lambda folder: _write(folder, robot.urdf.parent, text)) / "panda.urdf"


def _write(folder: Path, described: Path, text: str) -> None:
    meshes = described / "meshes"
    shutil.copytree(meshes / "collision", folder / "collision", copy_function=shutil.copyfile)
    text = text.replace("package://meshes/collision", "collision")
    for source in sorted((meshes / "visual").glob("*.obj")):
        text = text.replace(f"package://meshes/visual/{source.name}", source.name)
        write_obj(folder / source.name, merged(read_obj(source), CELL_M))
        mtl = source.with_suffix(".mtl")
        shutil.copy(mtl, folder / mtl.name)
    shutil.copy(meshes / "visual" / "colors.png", folder)
    (folder / "panda.urdf").write_text(text, encoding="utf-8")


def read_obj(path: Path) -> Triangles:
    """An OBJ file of triangles; each corner of the file becomes a vertex."""
    data: dict[str, list[list[float]]] = {"v": [], "vt": [[0.0, 0.0]], "vn": []}
    corners: list[list[int]] = []
    materials: list[str] = []
    shapes: list[int] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        kind, *words = line.split() or ["#"]
        if kind in data:
            data[kind].append([float(x) for x in words[: 2 if kind == "vt" else 3]])
        elif kind == "usemtl":
            materials.append(words[0])
        elif kind == "f":
            corners += [[int(x or 0) for x in word.split("/")] for word in words]
            shapes.append(len(materials) - 1)
    v, vt, vn = np.array(corners, dtype=np.int64).T  # counted from 1; vt 0 is none
    return Triangles(
        np.array(data["v"])[v - 1],
        np.array(data["vt"])[vt],
        np.array(data["vn"])[vn - 1],
        np.arange(len(v)).reshape(-1, 3),
        materials,
        np.array(shapes, dtype=np.int64),
    )


def merged(mesh: Triangles, cell_m: float) -> Triangles:
    """The mesh with each shape's vertices in a cell moved to their mean, and merged.

    They share the place, so that no cracks open; they stay apart as vertices where they differ in
    colour (palette field), or in the octant into which their normals point, so that edges stay
    edges.
    """
    shape = np.repeat(mesh.shapes, 3)
    cell = _groups(np.column_stack([np.floor(mesh.p_link / cell_m).astype(np.int64), shape]))
    place = _means(mesh.p_link, cell)
    field = np.floor(mesh.uv * PALETTE).astype(np.int64)
    octant = (mesh.normals > 0.0) @ np.array([1, 2, 4])
    group = _groups(np.column_stack([cell, field, octant]))
    a, b, c = cell[mesh.faces].T
    kept = (a != b) & (b != c) & (c != a)
    return Triangles(
        _means(place[cell], group),
        _means(mesh.uv, group),
        _means(mesh.normals, group),
        group[mesh.faces][kept],
        mesh.materials,
        mesh.shapes[kept],
    )


def _groups(keys: IntArray) -> IntArray:
    """(N,) which of the different rows of (N, K) each row is."""
    low = keys - keys.min(axis=0)
    flat = np.ravel_multi_index(tuple(low.T), tuple((low.max(axis=0) + 1).tolist()))
    _, group = np.unique(flat, return_inverse=True)
    return np.asarray(group, dtype=np.int64)


def _means(values: FloatArray, group: IntArray) -> FloatArray:
    """(G, K) mean of the rows (N, K) of each group."""
    sums = np.stack([np.bincount(group, x) for x in values.T], axis=-1)
    return np.asarray(sums / np.bincount(group)[:, None])


def write_obj(path: Path, mesh: Triangles) -> None:
    """Writes the mesh as OBJ; its materials are looked up in an MTL of the same name."""
    lengths = np.maximum(np.linalg.norm(mesh.normals, axis=1, keepdims=True), 1e-12)
    lines = [f"mtllib {path.stem}.mtl"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.p_link]
    lines += [f"vt {u:.5f} {v:.5f}" for u, v in mesh.uv]
    lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in mesh.normals / lengths]
    before = -1
    for face, shape in zip(mesh.faces + 1, mesh.shapes, strict=True):
        if shape != before:
            lines += [f"o shape_{shape}", f"usemtl {mesh.materials[shape]}"]
        before = shape
        # A corner that had no texture coordinates gets none: it shows its material's colour.
        corners = (f"{k}/{k if mesh.uv[k - 1].any() else ''}/{k}" for k in face)
        lines.append("f " + " ".join(corners))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
