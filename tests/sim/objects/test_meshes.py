"""Meshes of boxes: their files as another reader has them, and the inertia of what they are."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest
import trimesh

from sim.objects.meshes import (
    ROUND_SIDES,
    Box,
    box_faces,
    inertia_of_boxes,
    write_textured_boxes,
)
from sim.objects.obj_files import Patch, joined, write_obj, write_solid

TURNED = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.4, 1.1), np.array([0.2, -0.5, 0.9]))
SIDES_M = np.array([0.31, 0.12, 0.47])


def read(path: Path) -> trimesh.Trimesh:
    scene = trimesh.load_scene(path, process=False)
    (mesh,) = scene.geometry.values()
    return mesh


def test_the_inertia_of_a_box_is_the_textbook_one():
    box = Box("b", np.array([1.0, 2.0, 3.0]), gtsam.Pose3(), "front")
    com, inertia = inertia_of_boxes([box], 12.0)
    np.testing.assert_allclose(com, 0.0)
    np.testing.assert_allclose(inertia, np.diag([13.0, 10.0, 5.0]))


def test_texture_coordinates_are_to_scale_and_positive():
    box = Box("b", np.array([0.4, 0.02, 0.3]), gtsam.Pose3(), "front")
    corners, uvs, normals = box_faces(box)
    assert (uvs > 0).all()
    for ring, uv, normal in zip(corners, uvs, normals, strict=True):
        sides_m = np.linalg.norm(np.diff(ring, axis=0), axis=1)
        sides_uv = np.linalg.norm(np.diff(uv, axis=0), axis=1)
        np.testing.assert_allclose(sides_uv / sides_m, sides_uv[0] / sides_m[0])
        winding = np.cross(ring[1] - ring[0], ring[2] - ring[1])
        assert winding @ normal > 0


@pytest.mark.parametrize("rounded", [False, True])
def test_a_written_box_is_closed_and_its_outside_faces_out(rounded: bool, tmp_path: Path):
    box = Box("b", SIDES_M, TURNED, "front", rounded)
    write_textured_boxes(tmp_path / "b.obj", [box], "front.png", split_m=0.1)
    mesh = read(tmp_path / "b.obj")
    winding = np.einsum("ij,ij->i", mesh.face_normals, mesh.vertex_normals[mesh.faces[:, 0]])
    assert (winding > 0.7).all()
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    assert mesh.is_watertight
    area = ROUND_SIDES / 8.0 * np.sin(2.0 * np.pi / ROUND_SIDES) if rounded else 1.0
    assert mesh.volume == pytest.approx(area * np.prod(SIDES_M), rel=1e-4)
    np.testing.assert_allclose(mesh.center_mass, TURNED.translation(), atol=1e-6)


def test_no_cell_of_a_side_is_larger_than_was_asked_for(tmp_path: Path):
    write_textured_boxes(tmp_path / "b.obj", [Box("b", SIDES_M, TURNED, "front")], "f.png", 0.1)
    mesh = read(tmp_path / "b.obj")
    assert mesh.edges_unique_length.max() < np.sqrt(2.0) * 0.1 + 1e-6
    assert len(mesh.faces) == 2 * 2 * (4 * 2 + 4 * 5 + 2 * 5)


def test_patches_are_written_in_their_order_with_all_that_is_drawn(tmp_path: Path):
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(2, 3, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    one, two = (
        Patch(rng.normal(size=(3, 3)), n, rng.uniform(size=(3, 2)), np.array([[0, 1, 2]]))
        for n in normals
    )
    write_obj(tmp_path / "p.obj", joined([one, two]), None, (0.25, 0.5, 0.75))
    mesh = read(tmp_path / "p.obj")
    for face, patch in zip(mesh.faces, (one, two), strict=True):
        np.testing.assert_allclose(mesh.vertices[face], patch.points, atol=1e-6)
        np.testing.assert_allclose(mesh.vertex_normals[face], patch.normals, atol=1e-4)
        np.testing.assert_allclose(mesh.visual.uv[face], patch.uv, atol=1e-6)
    np.testing.assert_array_equal(mesh.visual.material.diffuse[:3], [64, 128, 191])


def test_a_picture_is_named_by_the_material_and_not_written(tmp_path: Path):
    write_textured_boxes(tmp_path / "b.obj", [Box("b", SIDES_M, TURNED, "front")], "f.png", 0.2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.mtl", "b.obj"]
    assert "map_Kd f.png" in (tmp_path / "b.mtl").read_text().splitlines()


def test_a_solid_is_written_with_its_vertices_and_faces_alone(tmp_path: Path):
    solid = trimesh.creation.icosphere(subdivisions=1)
    write_solid(tmp_path / "s.obj", solid)
    kinds = {line.split()[0] for line in (tmp_path / "s.obj").read_text().splitlines() if line}
    assert kinds == {"v", "f"}
    np.testing.assert_allclose(read(tmp_path / "s.obj").vertices, solid.vertices, atol=1e-6)


def test_two_boxes_apart_have_the_inertia_of_the_parallel_axis_theorem():
    boxes = [Box("b", SIDES_M, gtsam.Pose3(), "m"), Box("c", 2.0 * SIDES_M, TURNED, "m")]
    com, inertia = inertia_of_boxes(boxes, 9.0)
    masses, places = np.array([1.0, 8.0]), np.stack([np.zeros(3), TURNED.translation()])
    np.testing.assert_allclose(com, masses @ places / 9.0, atol=1e-12)
    expected = np.zeros((3, 3))
    for mass, place, box in zip(masses, places, boxes, strict=True):
        own = mass / 12.0 * np.diag((box.size_m**2).sum() - box.size_m**2)
        R, r = box.T_link_box.rotation().matrix(), place - com
        expected += R @ own @ R.T + mass * (r @ r * np.eye(3) - np.outer(r, r))
    np.testing.assert_allclose(inertia, expected, atol=1e-12)
