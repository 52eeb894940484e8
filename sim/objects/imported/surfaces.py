"""Triangles of a link's shapes, with their colours, from any mesh format that trimesh reads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import trimesh
from trimesh.resolvers import FilePathResolver
from trimesh.units import unit_conversion

from akm_fg.errors import InputError
from akm_fg.records import FloatArray
from sim.objects.obj_files import IntArray
from sim.objects.textures import Rgb
from sim.objects.urdf.urdf_model import Shape

GREY = (0.7, 0.7, 0.7)  # of what says nothing of its colour


@dataclass(frozen=True, slots=True)
class Surface:
    """Triangles of one colour or texture."""

    name: str  # of the shape in the URDF
    points: FloatArray  # (V, 3), m, in a frame that the holder knows
    faces: IntArray  # (F, 3), outsides counter-clockwise
    rgb: tuple[float, float, float]  # 0..1
    uv: FloatArray | None = None  # (V, 2) texture coordinates, v up
    image: Rgb | None = None  # (H, W, 3)
    link: str = ""  # to which the shape belongs in the URDF
    mesh_file: Path | None = None  # from which it was read

    def moved(self, T_to_from: gtsam.Pose3) -> Surface:
        """The surface in another frame."""
        R, t = T_to_from.rotation().matrix(), T_to_from.translation()
        return replace(self, points=self.points @ R.T + t)

    def mesh(self) -> trimesh.Trimesh:
        """The triangles alone."""
        return trimesh.Trimesh(self.points, self.faces, process=False)

    def scaled(self, factor: float) -> Surface:
        """The surface `factor` times as large, about the origin."""
        return replace(self, points=self.points * factor)


def surfaces_of(shape: Shape, urdf: Path) -> list[Surface]:
    """The shape's triangles in its link's frame, m; none where its mesh is empty.

    Raises:
        InputError: the mesh file cannot be read.
    """
    meshes = _load(shape, urdf) if shape.kind == "mesh" else [_primitive(shape)]
    return [_surface(shape, mesh).moved(shape.T_link_shape) for mesh in meshes if len(mesh.faces)]


class _Beside(FilePathResolver):
    """Finds what a mesh names (`../images/...`), in the folder around the mesh's own."""

    def absolute(self, name: str) -> Path:
        parent = Path(self.parent).resolve()
        path = (parent / name.strip().replace("\\", "/")).resolve()
        if not path.is_relative_to(parent.parent):
            raise ValueError(f"{name} is not beside {parent}")
        return path


def _load(shape: Shape, urdf: Path) -> list[trimesh.Trimesh]:
    assert shape.mesh is not None
    try:
        if shape.mesh.stat().st_size == 0:
            return []
        scene = trimesh.load_scene(shape.mesh, resolver=_Beside(str(shape.mesh)), process=False)
        meshes = [m for m in scene.dump() if isinstance(m, trimesh.Trimesh)]
    except Exception as error:  # trimesh raises whatever its parsers do
        told = str(error).splitlines()[0] if str(error) else type(error).__name__
        wrong = f"mesh {shape.mesh} cannot be read ({told})"
        raise InputError(
            urdf, wrong, "OBJ, STL, DAE or another format that trimesh reads"
        ) from error
    meshes = [mesh for mesh in meshes if np.isfinite(mesh.vertices).all()]
    unit_m = _unit_m(shape.mesh, scene)
    return [mesh.apply_scale(unit_m) for mesh in meshes] if unit_m != 1.0 else meshes


def _unit_m(mesh: Path, scene: trimesh.Scene) -> float:
    """What a COLLADA file says its unit is, in metres; other formats have metres in a URDF."""
    if mesh.suffix.lower() != ".dae" or not scene.units:
        return 1.0
    try:
        unit_m = float(unit_conversion(scene.units, "meters"))
    except (KeyError, ValueError):
        return 1.0
    return unit_m if 0.0 < unit_m < np.inf else 1.0


def _primitive(shape: Shape) -> trimesh.Trimesh:
    if shape.kind == "box":
        return trimesh.creation.box(shape.size)
    if shape.kind == "cylinder":
        return trimesh.creation.cylinder(shape.size[0], shape.size[2], sections=24)
    return trimesh.creation.icosphere(subdivisions=2, radius=shape.size[0])


def _surface(shape: Shape, mesh: trimesh.Trimesh) -> Surface:
    scale = shape.size if shape.kind == "mesh" else np.ones(3)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if np.prod(scale) < 0.0:  # mirrored: turn the outsides out again
        faces = faces[:, ::-1]
    rgb, uv, image = _looks(mesh)
    return Surface(
        shape.name,
        np.asarray(mesh.vertices) * scale,
        faces,
        rgb or shape.rgb or GREY,
        uv,
        image,
        mesh_file=shape.mesh,
    )


def _looks(
    mesh: trimesh.Trimesh,
) -> tuple[tuple[float, float, float] | None, FloatArray | None, Rgb | None]:
    """Colour, texture coordinates and texture, as far as the file has them."""
    visual: Any = mesh.visual
    if visual.kind == "texture":
        material: Any = visual.material
        rgba = np.asarray(material.main_color, dtype=float) / 255.0
        picture = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
        rgb = (float(rgba[0]), float(rgba[1]), float(rgba[2]))
        if picture is None or visual.uv is None:
            return rgb, None, None
        return rgb, np.asarray(visual.uv), np.asarray(picture.convert("RGB"))
    if visual.kind in ("face", "vertex"):
        r, g, b = (np.asarray(visual.main_color, dtype=float)[:3] / 255.0).tolist()
        return (r, g, b), None, None
    return None, None, None
