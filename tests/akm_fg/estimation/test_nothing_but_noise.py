"""Points that jump about at random are no joint, however little of their noise is unexplained."""

from __future__ import annotations

import numpy as np
import pytest

from akm_fg.estimation.fit import fit_poses, fit_tracks
from akm_fg.io.tracks import read_tracks
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import PoseTrack

T, N = 10, 20


def fitted(points: np.ndarray, tmp_path) -> ArticulationPosterior:
    """As a file without a noise level is read."""
    np.savez(tmp_path / "tracks.npz", points=points)
    read = read_tracks(tmp_path / "tracks.npz")
    return fit_tracks(read.tracks, noise_known=read.noise_known)


@pytest.mark.parametrize("seed", [0, 9])
def test_numbers_that_were_cut_off_at_eight_bits_are_no_joint(seed: int, tmp_path) -> None:
    """Called revolute at 99.2 and 99.8 % before."""
    drawn = 10 * np.random.default_rng(seed).normal(size=(T, N, 3))
    posterior = fitted(drawn.astype(int).astype(np.uint8) / 1e3, tmp_path)
    assert posterior.kind == "undecided"
    assert not posterior.fit.parametric


def test_a_small_part_with_much_noise_that_goes_far_is_a_joint(tmp_path) -> None:
    """Noise of half its size, a thirtieth of its way."""
    rng = np.random.default_rng(0)
    part = rng.uniform(-0.01, 0.01, size=(N, 3))
    way = np.linspace(0.0, 0.3, T)[:, None, None] * np.array([0.0, 1.0, 0.0])
    posterior = fitted(part + way + 5e-3 * rng.normal(size=(T, N, 3)), tmp_path)
    assert posterior.kind == "prismatic"


def test_one_point_at_rest_is_nothing_but_noise_about_its_place() -> None:
    p_world = np.random.default_rng(1).normal([0.3, 0.2, 0.5], 0.002, (60, 3))
    assert fit_poses(PoseTrack(p_world, None, None, ())).kind == "rigid"
