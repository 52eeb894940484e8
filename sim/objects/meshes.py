"""Boxes as textured meshes with box-projected texture coordinates, and the inertia of solids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
import trimesh

from akm_fg.records import FloatArray
from sim.objects.obj_files import IntArray, Patch, joined, write_obj
from sim.objects.textures import TILE_M


@dataclass(frozen=True, slots=True)
class Box:
    """A box of a link, or the upright cylinder that fits into it."""

    name: str
    size_m: FloatArray  # (3,)
    T_link_box: gtsam.Pose3
    material: str
    rounded: bool = False  # a cylinder along the box's own z


UV_SHIFT = 2.0  # whole tiles: keeps texture coordinates positive down to -1.6 m
ROUND_SIDES = 16  # of the prism that a cylinder is drawn as
LEAST_M3 = 1e-12  # of solids that share a mass

# For each side: its normal axis, its sign, and the box axes that texture u and v run along.
_SIDES = (
    (0, 1, 1, 2),
    (0, -1, 1, 2),
    (1, 1, 0, 2),
    (1, -1, 0, 2),
    (2, 1, 0, 1),
    (2, -1, 0, 1),
)


def box_faces(
    box: Box, p_grain: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Corners (6, 4, 3), texture coordinates (6, 4, 2) and normals (6, 3) in the link frame.

    Texture coordinates are the corner's position along the side's two axes over TILE_M, so that
    the boards of one link share one continuous texture. They are positive (UV_SHIFT), as
    TinyRenderer wraps only positive ones. A bar along z gets its grain along z.

    Args:
        box: the box.
        p_grain: (3,) of the link's frame in the one that textures are fixed to; the link's own if
            absent.
    """
    p_grain = np.zeros(3) if p_grain is None else p_grain
    corners, uvs, normals = [], [], []
    R, t = box.T_link_box.rotation().matrix(), box.T_link_box.translation()
    for axis, sign, a, b in _SIDES:
        ring = np.zeros((4, 3))
        ring[:, axis] = sign * box.size_m[axis] / 2.0
        ring[:, a] = np.array([-1, 1, 1, -1]) * box.size_m[a] / 2.0
        ring[:, b] = np.array([-1, -1, 1, 1]) * box.size_m[b] / 2.0
        normal = np.zeros(3)
        normal[axis] = sign
        if np.dot(np.cross(ring[1] - ring[0], ring[2] - ring[1]), normal) < 0:
            ring = ring[::-1]
        p_link = ring @ R.T + t
        u_axis, v_axis = np.abs(R[:, a]).argmax(), np.abs(R[:, b]).argmax()
        p_texture = p_link + p_grain
        uv = np.stack([p_texture[:, u_axis], p_texture[:, v_axis]], axis=-1)
        corners.append(p_link)
        uvs.append(uv / TILE_M + UV_SHIFT)
        normals.append(R @ normal)
    return np.array(corners), np.array(uvs), np.array(normals)


def write_textured_boxes(
    path: Path,
    boxes: Sequence[Box],
    texture: str,
    split_m: float,
    sides: Sequence[int] = tuple(range(6)),
    p_grain: FloatArray | None = None,
) -> None:
    """Writes an OBJ of boxes and its MTL, with sides cut into cells of at most `split_m`.

    Cutting keeps the renderer's triangles small, so that its lighting and clipping stay exact.

    Args:
        path: the OBJ file; the MTL goes beside it.
        boxes: the boxes, in the link frame, metres.
        texture: file name of the texture in the same folder.
        split_m: largest side of a cell, metres.
        sides: which sides of each box to write: +x, -x, +y, -y, +z, -z.
        p_grain: as `box_faces` takes it.
    """
    patches: list[Patch] = []
    for box in boxes:
        if box.rounded:
            patches.append(_rod(box))
            continue
        corners, uvs, normals = (part[list(sides)] for part in box_faces(box, p_grain))
        patches += [_side(*side, split_m) for side in zip(corners, uvs, normals, strict=True)]
    write_obj(path, joined(patches), texture)


def _side(ring: FloatArray, uv: FloatArray, normal: FloatArray, split_m: float) -> Patch:
    """One rectangular side, cut into a grid of cells, each of them into two triangles."""
    n = max(1, int(np.ceil(np.linalg.norm(ring[1] - ring[0]) / split_m)))
    m = max(1, int(np.ceil(np.linalg.norm(ring[3] - ring[0]) / split_m)))
    a, b = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    a, b = a.reshape(-1, 1), b.reshape(-1, 1)
    grid = ring[0] + a * (ring[1] - ring[0]) + b * (ring[3] - ring[0])
    grid_uv = uv[0] + a * (uv[1] - uv[0]) + b * (uv[3] - uv[0])
    first = np.arange((n + 1) * (m + 1)).reshape(n + 1, m + 1)[:-1, :-1].reshape(-1, 1)
    quads = first + np.array([0, m + 1, m + 2, 1])
    faces = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return Patch(grid, np.tile(normal, (len(grid), 1)), grid_uv, faces)


def _rod(box: Box) -> Patch:
    """A cylinder: four rings of vertices, two for its mantle and one for each end."""
    n = ROUND_SIDES
    turn = 2.0 * np.pi * np.arange(n) / n
    rim = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    R, t = box.T_link_box.rotation().matrix(), box.T_link_box.translation()
    points, normals, uvs = [], [], []
    for part, sign in (("mantle", -1.0), ("mantle", 1.0), ("end", -1.0), ("end", 1.0)):
        p_box = np.column_stack([rim * box.size_m[:2] / 2.0, np.full(n, sign * box.size_m[2] / 2)])
        flat = np.tile([0.0, 0.0, sign], (n, 1))
        outward = np.column_stack([rim, np.zeros(n)]) if part == "mantle" else flat
        points.append(p_box @ R.T + t)
        normals.append(outward @ R.T)
        uvs.append((p_box[:, [0, 2]] if part == "mantle" else p_box[:, :2]) / TILE_M + UV_SHIFT)
    return Patch(
        np.concatenate(points), np.concatenate(normals), np.concatenate(uvs), _rod_triangles()
    )


def _rod_triangles() -> IntArray:
    """(F, 3) over the four rings of `_rod`, outsides counter-clockwise."""
    n = ROUND_SIDES
    low, high, bottom, top = (k * n for k in range(4))
    faces = []
    for i in range(n):
        j = (i + 1) % n
        faces += [(low + i, low + j, high + j), (low + i, high + j, high + i)]
    for i in range(1, n - 1):
        faces += [(bottom, bottom + i + 1, bottom + i), (top, top + i, top + i + 1)]
    return np.array(faces)


def inertia_of_boxes(boxes: Sequence[Box], mass_kg: float) -> tuple[FloatArray, FloatArray]:
    """Centre of mass (3,) and inertia (3, 3) about it, kg m^2, both in the link frame.

    The boxes share `mass_kg` by volume; a rounded one counts as its box.
    """
    solids = [trimesh.creation.box(box.size_m, box.T_link_box.matrix()) for box in boxes]
    return inertia_of_solids(solids, mass_kg)


def inertia_of_solids(
    solids: Sequence[trimesh.Trimesh], mass_kg: float
) -> tuple[FloatArray, FloatArray]:
    """Centre of mass (3,) and inertia (3, 3) about it, kg m^2, of closed meshes in one frame.

    They share `mass_kg` by volume; where they overlap, each counts.
    """
    whole: trimesh.Trimesh = trimesh.util.concatenate(list(solids))  # type: ignore[assignment]
    whole.density = mass_kg / max(whole.volume, LEAST_M3)
    return np.asarray(whole.center_mass), np.asarray(whole.moment_inertia)
