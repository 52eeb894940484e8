"""Triangle meshes as OBJ files that PyBullet's renderers draw as they are meant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.exchange.obj import export_obj
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

from akm_fg.records import FloatArray

IntArray = NDArray[np.int64]

DIGITS = 6  # micrometres
NORMAL_DIGITS = 4
MATERIAL = "surface"


@dataclass(frozen=True, slots=True)
class Patch:
    """Triangles with what is needed to draw them."""

    points: FloatArray  # (V, 3), m
    normals: FloatArray  # (V, 3) unit, outward
    uv: FloatArray  # (V, 2) texture coordinates, v up
    faces: IntArray  # (F, 3) of vertices, outsides counter-clockwise


def joined(patches: Sequence[Patch]) -> Patch:
    """All of them as one, in their order."""
    first = np.cumsum([0, *(len(patch.points) for patch in patches)])
    return Patch(
        np.concatenate([patch.points for patch in patches]),
        np.concatenate([patch.normals for patch in patches]),
        np.concatenate([patch.uv for patch in patches]),
        np.concatenate([patch.faces + k for patch, k in zip(patches, first, strict=False)]),
    )


def write_obj(
    path: Path,
    patch: Patch,
    texture: str | None,
    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> None:
    """Writes an OBJ of one material, as PyBullet shows only the first of several, and its MTL.

    Args:
        path: the OBJ file; the MTL goes beside it.
        patch: what is drawn.
        texture: file name of the picture in the same folder, if any.
        rgb: 0..1, by which the picture is multiplied.
    """
    mesh = trimesh.Trimesh(
        patch.points,
        patch.faces,
        vertex_normals=np.round(patch.normals, NORMAL_DIGITS),
        visual=TextureVisuals(uv=patch.uv, material=SimpleMaterial(name=MATERIAL)),
        process=False,
    )
    mtl = path.with_suffix(".mtl")
    text = export_obj(mesh, include_normals=True, digits=DIGITS, mtl_name=mtl.name, header=None)
    path.write_text(text, encoding="utf-8")
    # Not trimesh's: it writes a picture of its own beside each mesh.
    colour = " ".join(f"{c:.4f}" for c in rgb)
    picture = "" if texture is None else f"map_Kd {texture}\n"
    lines = f"newmtl {MATERIAL}\nKa {colour}\nKd {colour}\nKs 0 0 0\n{picture}"
    mtl.write_text(lines, encoding="utf-8")


def write_solid(path: Path, solid: trimesh.Trimesh) -> None:
    """Writes the OBJ of a collision shape: vertices and faces alone."""
    text = export_obj(solid, include_normals=False, include_color=False, digits=DIGITS, header=None)
    path.write_text(text, encoding="utf-8")
