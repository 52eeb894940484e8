from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.objects.embedded import OBJECT_NAMES, build_object, sample_object
from sim.objects.meshes import Box, box_faces, inertia_of_boxes
from sim.objects.textures import SIZE_PX, painted, wood

import gtsam  # isort: skip


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_the_same_seed_builds_the_same_files(name: str, tmp_path: Path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        build_object(sample_object(name, 4), folder)
    files = sorted(f.name for f in folders[0].iterdir())
    assert files == sorted(f.name for f in folders[1].iterdir())
    for file in files:
        assert (folders[0] / file).read_bytes() == (folders[1] / file).read_bytes(), file


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_seeds_vary_the_object_within_furniture_like_bounds(name: str):
    specs = [sample_object(name, seed) for seed in range(20)]
    masses = [spec.mass_kg for spec in specs]
    assert len(set(masses)) == 20
    low, high = (2.0, 6.0) if name == "drawer" else (3.0, 8.0)
    assert low <= min(masses) and max(masses) <= high


def test_an_unknown_object_is_refused():
    with pytest.raises(ValueError, match="door, drawer"):
        sample_object("window", 0)


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


@pytest.mark.parametrize("texture", [painted, wood])
def test_front_textures_have_contrast_for_a_tracker(texture):
    image = texture(np.random.default_rng(0)).mean(axis=2)
    assert image.shape == (SIZE_PX, SIZE_PX)
    assert image.std() > 10.0
