"""Merging vertices: fewer triangles, the same shape."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial import cKDTree

from akm_fg.arm.body.description import franka_description
from sim.camera.robot_meshes import Triangles, light_panda_urdf, merged, read_obj, write_obj

PANDA = franka_description()
HAND = PANDA.urdf.parent / "meshes" / "visual" / "hand.obj"
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


@pytest.mark.parametrize("differ", ["colour", "facing", "shape"])
def test_sheets_in_one_place_stay_apart_where_they_differ(differ: str):
    corners = np.array([[0.001, 0.001, 0.001], [0.021, 0.001, 0.001], [0.001, 0.021, 0.001]])
    up = np.tile([0.1, 0.1, 1.0], (3, 1))
    other = differ == "facing"
    uv = [0.1, 0.9 if differ == "colour" else 0.1]
    sheets = Triangles(
        np.concatenate([corners, corners + 1e-3]),
        np.repeat(uv, 3)[:, None] * np.ones(2),
        np.concatenate([up, -up if other else up]),
        np.arange(6).reshape(2, 3),
        ["white", "black"],
        np.array([0, 1 if differ == "shape" else 0]),
    )
    light = merged(sheets, CELL_M)
    assert len(light.p_link) == 6
    np.testing.assert_allclose(light.uv[light.faces], sheets.uv[sheets.faces])
    np.testing.assert_allclose(light.normals[light.faces], sheets.normals[sheets.faces])


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
    urdf = light_panda_urdf(PANDA)
    assert urdf.is_relative_to(tmp_path)
    text, original = urdf.read_text(), PANDA.urdf.read_text()
    names = re.findall(r'"package://meshes/(collision/[^"]*)"', original)
    assert names and re.findall(r'"(collision/[^"]*)"', text) == names
    for name in names:
        source = PANDA.urdf.parent / "meshes" / name
        assert (urdf.parent / name).read_bytes() == source.read_bytes()
    assert str(PANDA.urdf.parent) not in text  # which may be removed while the cache stays
    made = urdf.stat().st_mtime_ns
    assert light_panda_urdf(PANDA) == urdf and urdf.stat().st_mtime_ns == made
