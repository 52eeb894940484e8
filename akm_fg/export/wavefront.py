"""Meshes as Wavefront OBJ, the one format with colours that PyBullet, pinocchio and MuJoCo read.

None of them reads colours of corners, so each triangle takes its colour from a small palette
picture: the three corners of a triangle point to the middle of the palette's field.
"""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from akm_fg.export.description import Mesh

_COLOURS = 256
_FIELDS = 16  # along either side of the picture
_FIELD_PX = 4  # wide, so that a filter does not mix neighbours


def plain_obj(mesh: Mesh) -> bytes:
    """Points and triangles alone."""
    return "".join(
        [*_vertices(mesh), *(f"f {a} {b} {c}\n" for a, b, c in mesh.triangles + 1)]
    ).encode()


def coloured_obj(mesh: Mesh, name: str) -> dict[str, bytes]:
    """NAME.obj with NAME.mtl and the palette NAME.png, by file name."""
    picture, field = _palette(mesh)
    place = (np.arange(_FIELDS) + 0.5) / _FIELDS
    lines = [f"mtllib {name}.mtl\n", *_vertices(mesh)]
    # The picture's rows go down, texture coordinates up.
    lines += [
        f"vt {place[k % _FIELDS]:.5f} {1 - place[k // _FIELDS]:.5f}\n" for k in range(_COLOURS)
    ]
    lines.append("usemtl colours\n")
    lines += [
        f"f {a}/{k} {b}/{k} {c}/{k}\n"
        for (a, b, c), k in zip(mesh.triangles + 1, field + 1, strict=True)
    ]
    material = f"newmtl colours\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nmap_Kd {name}.png\n"
    return {
        f"{name}.obj": "".join(lines).encode(),
        f"{name}.mtl": material.encode(),
        f"{name}.png": picture,
    }


def _vertices(mesh: Mesh) -> list[str]:
    return [f"v {x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in mesh.points]


def _palette(mesh: Mesh) -> tuple[bytes, NDArray[np.int64]]:
    """The picture as PNG, and the field of each triangle (F,)."""
    colours = np.rint(mesh.rgb[mesh.triangles].mean(axis=1)).astype(np.uint8)
    reduced = Image.fromarray(colours[None]).quantize(_COLOURS)
    field = np.asarray(reduced, dtype=np.int64)[0]
    table = np.zeros(3 * _COLOURS, np.uint8)
    given = np.array((reduced.getpalette() or [])[: 3 * _COLOURS], np.uint8)
    table[: given.size] = given
    fields = table.reshape(_FIELDS, _FIELDS, 3)
    file = io.BytesIO()
    Image.fromarray(fields.repeat(_FIELD_PX, axis=0).repeat(_FIELD_PX, axis=1)).save(file, "PNG")
    return file.getvalue(), field
