"""Boxes, their inertia, and textured meshes with box-projected texture coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.records import FloatArray
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

# For each side: its normal axis, its sign, and the box axes that texture u and v run along.
_SIDES = (
    (0, 1, 1, 2),
    (0, -1, 1, 2),
    (1, 1, 0, 2),
    (1, -1, 0, 2),
    (2, 1, 0, 1),
    (2, -1, 0, 1),
)


def box_faces(box: Box) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Corners (6, 4, 3), texture coordinates (6, 4, 2) and normals (6, 3) in the link frame.

    Texture coordinates are the corner's position along the side's two axes over TILE_M, so that
    the boards of one link share one continuous texture. They are positive (UV_SHIFT), as
    TinyRenderer wraps only positive ones. A bar along z gets its grain along z.
    """
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
        uv = np.stack([p_link[:, u_axis], p_link[:, v_axis]], axis=-1)
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
) -> None:
    """Writes an OBJ of boxes and its MTL, with sides cut into cells of at most `split_m`.

    Cutting keeps the renderer's triangles small, so that its lighting and clipping stay exact.

    Args:
        path: the OBJ file; the MTL goes beside it.
        boxes: the boxes, in the link frame, metres.
        texture: file name of the texture in the same folder.
        split_m: largest side of a cell, metres.
        sides: which sides of each box to write: +x, -x, +y, -y, +z, -z.
    """
    lines = [f"mtllib {path.stem}.mtl", "usemtl surface"]
    count = 0
    for box in boxes:
        if box.rounded:
            lines += _rod_lines(box, count)
            count += 4 * ROUND_SIDES
            continue
        corners, uvs, normals = (part[list(sides)] for part in box_faces(box))
        for ring, uv, normal in zip(corners, uvs, normals, strict=True):
            side = _side_lines(ring, uv, normal, count, split_m)
            lines += side
            count += sum(line.startswith("v ") for line in side)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    path.with_suffix(".mtl").write_text(
        f"newmtl surface\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nmap_Kd {texture}\n", encoding="utf-8"
    )


def _side_lines(
    ring: FloatArray, uv: FloatArray, normal: FloatArray, first: int, split_m: float
) -> list[str]:
    """OBJ lines of one rectangular side; vertices are numbered after `first`."""
    n = max(1, int(np.ceil(np.linalg.norm(ring[1] - ring[0]) / split_m)))
    m = max(1, int(np.ceil(np.linalg.norm(ring[3] - ring[0]) / split_m)))
    a, b = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    a, b = a.reshape(-1, 1), b.reshape(-1, 1)
    grid = ring[0] + a * (ring[1] - ring[0]) + b * (ring[3] - ring[0])
    grid_uv = uv[0] + a * (uv[1] - uv[0]) + b * (uv[3] - uv[0])
    lines = []
    for p, t in zip(grid, grid_uv, strict=True):
        lines.append(f"v {p[0]:.6f} {p[1]:.6f} {p[2]:.6f}")
        lines.append(f"vt {t[0]:.6f} {t[1]:.6f}")
        lines.append(f"vn {normal[0]:.4f} {normal[1]:.4f} {normal[2]:.4f}")
    for i in range(n):
        for j in range(m):
            k = first + i * (m + 1) + j + 1
            quad = (k, k + m + 1, k + m + 2, k + 1)
            for c in ((0, 1, 2), (0, 2, 3)):
                lines.append("f " + " ".join(f"{quad[x]}/{quad[x]}/{quad[x]}" for x in c))
    return lines


def _rod_lines(box: Box, first: int) -> list[str]:
    """OBJ lines of a cylinder: its mantle, then both ends; vertices after `first`."""
    n = ROUND_SIDES
    turn = 2.0 * np.pi * np.arange(n) / n
    rim = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    R, t = box.T_link_box.rotation().matrix(), box.T_link_box.translation()
    lines = []
    for part, sign in (("mantle", -1.0), ("mantle", 1.0), ("end", -1.0), ("end", 1.0)):
        p_box = np.column_stack([rim * box.size_m[:2] / 2.0, np.full(n, sign * box.size_m[2] / 2)])
        flat = np.tile([0.0, 0.0, sign], (n, 1))
        normals = np.column_stack([rim, np.zeros(n)]) if part == "mantle" else flat
        uv = p_box[:, [0, 2]] if part == "mantle" else p_box[:, :2]
        for p, m, c in zip(p_box @ R.T + t, normals @ R.T, uv / TILE_M + UV_SHIFT, strict=True):
            lines.append(f"v {p[0]:.6f} {p[1]:.6f} {p[2]:.6f}")
            lines.append(f"vt {c[0]:.6f} {c[1]:.6f}")
            lines.append(f"vn {m[0]:.4f} {m[1]:.4f} {m[2]:.4f}")
    return lines + _rod_triangles(first + 1)


def _rod_triangles(first: int) -> list[str]:
    """Faces over the four rings of `_rod_lines`, outsides counter-clockwise."""
    n = ROUND_SIDES
    low, high, bottom, top = (first + k * n for k in range(4))
    faces = []
    for i in range(n):
        j = (i + 1) % n
        faces += [(low + i, low + j, high + j), (low + i, high + j, high + i)]
    for i in range(1, n - 1):
        faces += [(bottom, bottom + i + 1, bottom + i), (top, top + i, top + i + 1)]
    return ["f " + " ".join(f"{k}/{k}/{k}" for k in face) for face in faces]


def inertia_of_boxes(boxes: Sequence[Box], mass_kg: float) -> tuple[FloatArray, FloatArray]:
    """Centre of mass (3,) and inertia (3, 3) about it, kg m^2, both in the link frame.

    The boxes share `mass_kg` by volume; a rounded one counts as its box.
    """
    volumes = np.array([np.prod(box.size_m) for box in boxes])
    masses = mass_kg * volumes / volumes.sum()
    centres = np.array([box.T_link_box.translation() for box in boxes])
    com = masses @ centres / mass_kg
    inertia = np.zeros((3, 3))
    for m, c, box in zip(masses, centres, boxes, strict=True):
        s2 = box.size_m**2
        R = box.T_link_box.rotation().matrix()
        inertia += R @ np.diag(m / 12.0 * (s2.sum() - s2)) @ R.T
        r = c - com
        inertia += m * (r @ r * np.eye(3) - np.outer(r, r))
    return com, inertia
