"""Merging vertices: fewer triangles, the same shape."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sim.bullet import PANDA_URDF
from sim.robot_meshes import Triangles, light_panda_urdf, merged, read_obj, write_obj

HAND = PANDA_URDF.parent / "meshes" / "visual" / "hand.obj"
CELL_M = 0.006


@pytest.fixture(scope="module")
def hand() -> Triangles:
    return read_obj(HAND)


def test_merging_leaves_far_fewer_triangles_within_a_cell_of_the_first(hand: Triangles):
    light = merged(hand, CELL_M)
    assert len(light.faces) < 0.3 * len(hand.faces)
    diagonal = np.sqrt(3.0) * CELL_M
    assert cKDTree(hand.p_link).query(light.p_link)[0].max() < diagonal
    assert cKDTree(light.p_link).query(hand.p_link)[0].max() < diagonal


def test_a_vertex_keeps_its_colour_shape_and_facing(hand: Triangles):
    light = merged(hand, CELL_M)
    nearby = cKDTree(hand.p_link)
    for k in np.linspace(0, len(light.p_link) - 1, 50).astype(int):
        near = nearby.query_ball_point(light.p_link[k], 2.0 * CELL_M)
        off = np.abs(hand.uv[near] - light.uv[k]).max(axis=1)
        facing = hand.normals[near] @ light.normals[k]
        assert ((off < 1.0 / 16.0) & (facing > 0.0)).any()


def test_a_written_mesh_reads_back(hand: Triangles, tmp_path):
    light = merged(hand, CELL_M)
    write_obj(tmp_path / "hand.obj", light)
    back = read_obj(tmp_path / "hand.obj")
    np.testing.assert_allclose(back.p_link[back.faces], light.p_link[light.faces], atol=1e-6)
    np.testing.assert_allclose(back.uv[back.faces], light.uv[light.faces], atol=1e-5)
    named = [back.materials[s] for s in back.shapes]
    assert named == [light.materials[s] for s in light.shapes]


def test_the_light_robot_keeps_its_collision_meshes_and_is_made_once(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    urdf = light_panda_urdf()
    assert urdf.is_relative_to(tmp_path)
    text, original = urdf.read_text(), PANDA_URDF.read_text()
    collision = (PANDA_URDF.parent / "meshes" / "collision").as_posix()
    assert text.count(collision) == original.count("package://meshes/collision")
    made = urdf.stat().st_mtime_ns
    assert light_panda_urdf() == urdf and urdf.stat().st_mtime_ns == made
