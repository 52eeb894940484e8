"""Writes a household object as URDF, meshes and textures, and finds it a place."""

from __future__ import annotations

import logging
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import gtsam
import numpy as np
import trimesh

from akm_fg.arm.body.kinematics import FrankaKinematics
from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray
from sim.objects.household.household_spec import HouseholdSpec
from sim.objects.household.shapes import Solid, shapes_of
from sim.objects.meshes import UV_SHIFT, inertia_of_solids
from sim.objects.obj_files import Patch, write_obj, write_solid
from sim.objects.part_spec import BuiltObject, middle_of_front
from sim.objects.placement import Placement
from sim.objects.suites.finishes import plain, stone, veneer
from sim.objects.suites.furniture_place import FurniturePlaceConfig, place_furniture
from sim.objects.textures import TILE_M, Rgb, brushed_metal, painted, wood
from sim.objects.urdf.urdf_files import (
    CORPUS_KG,
    INERTIA_MIN,
    inertial_element,
    joint_element,
    write_object,
)

log = logging.getLogger(__name__)
DARK = 0.18  # of the usual brightness
GLOSSY = "metal"  # in a mesh's name: see `sim.camera.materials`
PLACES = 12  # poses that are tried for the arm, before it is left out of reach
LESS_M, LESS_RAD = 0.08, float(np.deg2rad(20.0))  # what the arm should be able to open


def build_household(spec: HouseholdSpec, folder: Path) -> BuiltObject:
    """Writes the object's files into `folder`; the same spec gives the same bytes."""
    shapes = shapes_of(spec)
    for name, image in textures(spec).items():
        cv2.imwrite(str(folder / f"{name}.png"), image[..., ::-1])
    glossy = spec.finish == "glossy"
    still = _link("corpus", shapes.corpus, np.zeros(3), CORPUS_KG, glossy, folder)
    moving = _link("part", shapes.part, -shapes.origin, spec.mass_kg, glossy, folder)
    joint = joint_element(spec, shapes.origin, shapes.axis)
    urdf = write_object(spec.name, still, [moving, joint], folder)
    points = np.concatenate([solid.mesh.vertices for solid in shapes.part])
    return BuiltObject(
        spec=spec,
        urdf=urdf,
        axis_object=shapes.axis,
        pivot_object=shapes.origin,
        T_object_handle=_grip_pose(shapes.grip, shapes.approach),
        p_object_front=middle_of_front(points),
        handle_thickness_m=spec.handle.thickness_m,
    )


def place_household(
    built: BuiltObject, spec: HouseholdSpec, kinematics: FrankaKinematics
) -> Placement:
    """A pose from which the arm can open it a little; where there is none, before the arm."""
    config = FurniturePlaceConfig(opening_m=LESS_M, opening_rad=LESS_RAD, candidates=PLACES)
    try:
        return place_furniture(built, spec, kinematics, config)
    except MotionInfeasible as error:
        log.info("%s; it stands out of its reach", error)
    rng = np.random.default_rng([*spec.key, spec.seed, 6])
    R = gtsam.Rot3.Rz(-np.pi / 2 + rng.uniform(*config.yaw_rad))
    plinth_m = float(rng.uniform(0.0, 0.4)) if spec.size_m[2] < config.plinth_max_m else 0.0
    T = gtsam.Pose3(R, np.array([rng.uniform(0.85, 1.0), rng.uniform(-0.2, 0.2), plinth_m]))
    return Placement(T, T * built.T_object_handle, 0.0, plinth_m)


def _grip_pose(p_object: FloatArray, approach: FloatArray) -> gtsam.Pose3:
    """T_object_handle: z the way the fingers come; they close up and down, or along x."""
    across = np.array([0.0, 0, 1]) if abs(approach[2]) < 0.5 else np.array([0.0, 1, 0])
    along = np.cross(across, approach)
    return gtsam.Pose3(gtsam.Rot3(np.column_stack([along, across, approach])), p_object)


def textures(spec: HouseholdSpec) -> dict[str, Rgb]:
    """One image for each material, from the spec's key alone."""
    rng = np.random.default_rng([*spec.key, 77])
    printed = (wood, painted, veneer, stone, brushed_metal)
    draw = printed[int(rng.integers(len(printed)))] if spec.finish == "printed" else plain
    images = {name: draw(rng) for name in ("body", "part")}
    images |= {"inside": stone(rng) // 3, "knob": plain(rng)}
    if spec.finish == "dark":
        images = {k: np.asarray(DARK * image, dtype=np.uint8) for k, image in images.items()}
    return images


def _link(
    name: str,
    solids: Sequence[Solid],
    shift: FloatArray,
    mass_kg: float,
    glossy: bool,
    folder: Path,
) -> ET.Element:
    """One body's element; its meshes go into `folder`, shifted into its frame."""
    moved = [replace(solid, mesh=solid.mesh.copy()) for solid in solids]
    for solid in moved:
        solid.mesh.apply_translation(shift)
    link = ET.Element("link", name=name)
    com, inertia = inertia_of_solids([solid.mesh for solid in moved], mass_kg)
    link.append(inertial_element(mass_kg, com, inertia + INERTIA_MIN * np.eye(3)))
    for i, solid in enumerate(moved):
        shine = f"_{GLOSSY}" if glossy and solid.material in ("body", "part") else ""
        path = folder / f"{name}_{i}{shine}.obj"
        write_obj(path, _patch(solid.mesh), f"{solid.material}.png")
        geometry = ET.SubElement(ET.SubElement(link, "visual"), "geometry")
        ET.SubElement(geometry, "mesh", filename=path.name)
    for i, piece in enumerate(piece for solid in solids for piece in solid.hard):
        hull = piece.copy()
        hull.apply_translation(shift)
        path = folder / f"{name}_hull_{i}.obj"
        write_solid(path, hull)
        geometry = ET.SubElement(ET.SubElement(link, "collision"), "geometry")
        ET.SubElement(geometry, "mesh", filename=path.name)
    return link


def _patch(mesh: trimesh.Trimesh) -> Patch:
    """Flat triangles, with texture coordinates by the side that each of them faces."""
    corners = np.asarray(mesh.triangles).reshape(-1, 3)
    normals = np.repeat(np.asarray(mesh.face_normals), 3, axis=0)
    faced = np.abs(normals).argmax(axis=1)
    along = np.array([[1, 2], [0, 2], [0, 1]])[faced]
    uv = np.take_along_axis(corners, along, axis=1) / TILE_M + UV_SHIFT
    return Patch(corners, normals, uv, np.arange(len(corners)).reshape(-1, 3))
