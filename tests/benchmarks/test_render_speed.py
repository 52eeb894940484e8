"""Timings of the simulated camera, whole and in its shares: `make bench`.

Processor time of this process, not of the clock: other work on the machine does not count.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from sim.camera.mirror import poses_of
from sim.camera.noise import NOISE_LEVELS
from sim.camera.sensor import NoisySensor
from sim.episode import SimEpisode, open_world

pytestmark = pytest.mark.benchmark(timer=time.process_time, min_time=0.2, max_time=2.0)


@pytest.fixture(scope="module", params=["door", "furniture-dev/drawer-001"])
def episode(request) -> Iterator[SimEpisode]:
    with open_world(request.param, 0, "d455") as opened:
        opened.camera.capture()
        yield opened


def test_a_whole_frame(benchmark, episode: SimEpisode):
    frame = benchmark(episode.camera.capture)
    assert frame.rgb.shape == (480, 640, 3)
    if not benchmark.disabled:
        assert benchmark.stats.stats.median < 0.12  # seconds: what the simulator may take


def test_share_of_drawing_robot_and_part(benchmark, episode: SimEpisode):
    camera = episode.camera

    def draw():
        poses = poses_of(episode.world.client, camera._shapes)
        return camera._scene.draw(poses, camera._shot)

    assert benchmark(draw).rgb.any()


def test_share_of_putting_them_before_what_stands_still(benchmark, episode: SimEpisode):
    """Drawing included."""
    _, depth = benchmark(episode.camera.exact)
    assert depth.shape == (480, 640)


def test_share_of_masking_the_robot(benchmark, episode: SimEpisode):
    depth = benchmark(episode.camera.robot_depth)
    assert depth.shape == (480, 640)


@pytest.mark.parametrize("level", ["d455", "d455-filtered", "harsh"])
def test_share_of_noise(benchmark, episode: SimEpisode, level: str):
    surface, depth = episode.camera._exact()
    rng = np.random.default_rng(0)
    sensor = NoisySensor(NOISE_LEVELS[level], episode.camera.intrinsics, rng)

    def both():
        sensor.rgb(surface, 0.0)
        return sensor.depth(depth, surface)

    assert benchmark(both).shape == (480, 640)
