"""Timings of the simulated camera, whole and in its shares: `make bench`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from sim.camera import SimCamera, render
from sim.episode import SimEpisode, open_world
from sim.noise import noisy_depth, noisy_rgb


@pytest.fixture(scope="module", params=["door", "furniture-dev/drawer-001"])
def episode(request) -> Iterator[SimEpisode]:
    with open_world(request.param, 0, "d455") as opened:
        yield opened


def test_a_whole_frame(benchmark, episode: SimEpisode):
    frame = benchmark(episode.camera.capture)
    assert frame.rgb.shape == (480, 640, 3)


def test_share_of_drawing_robot_and_part(benchmark, episode: SimEpisode):
    camera: SimCamera = episode.camera
    rgb, _ = benchmark(render, episode.world.client, camera.T_world_cam, camera.config)
    assert rgb.any()


def test_share_of_putting_them_before_what_stands_still(benchmark, episode: SimEpisode):
    """Drawing included."""
    _, depth = benchmark(episode.camera.exact)
    assert depth.shape == (480, 640)


def test_share_of_masking_the_robot(benchmark, episode: SimEpisode):
    depth = benchmark(episode.camera.robot_depth)
    assert depth.shape == (480, 640)


def test_share_of_noise(benchmark, episode: SimEpisode):
    camera: SimCamera = episode.camera
    rgb, depth = camera.exact()
    rng = np.random.default_rng(0)

    def both():
        noisy_rgb(rgb, camera.config.noise, rng)
        return noisy_depth(depth, camera.intrinsics, camera.config.noise, rng)

    assert benchmark(both).shape == (480, 640)
