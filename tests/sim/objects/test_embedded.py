"""The two embedded objects: the same each time, varied within bounds, with textures to track."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.objects.embedded import OBJECT_NAMES, build_object, sample_object
from sim.objects.textures import SIZE_PX, painted, wood


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
    for spec in specs:  # dry rubber on metal or lacquer
        assert 0.5 <= spec.handle_mu <= 1.1


def test_an_unknown_object_is_refused():
    with pytest.raises(ValueError, match="door, drawer"):
        sample_object("window", 0)


@pytest.mark.parametrize("texture", [painted, wood])
def test_front_textures_have_contrast_for_a_tracker(texture):
    image = texture(np.random.default_rng(0)).mean(axis=2)
    assert image.shape == (SIZE_PX, SIZE_PX)
    assert image.std() > 10.0
