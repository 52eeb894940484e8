"""An episode of pull, whole and in its shares, in seconds of CPU: `make bench`.

CPU time, not wall time: on a machine that others use too, only that can be compared.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the simulator is not installed")

from akm_fg.arm.body.impedance import ImpedanceConfig, cartesian_torques
from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.arm.motion.pulling import Pull, PullConfig
from sim.episode import SimEpisode, open_world

FRAMES = 30
PULL_M = 0.15
ALLOWED_CPU_S = 12.0


def pull_episode(episode: SimEpisode) -> dict[str, float]:
    """Grasp the handle, pull, and take 30 frames of 640 x 480 on the way; CPU s of each share."""
    cpu_s = {"grasp": -time.process_time()}
    for _ in episode.arm.grasp(episode.T_world_grasp, 0.1):
        pass
    cpu_s["grasp"] += time.process_time()
    cpu_s |= {"pull": -time.process_time(), "rendering": 0.0}
    frames = []
    for _ in episode.arm.pull(episode.pull_direction_world, PULL_M, 0.1):
        if len(frames) < FRAMES:
            cpu_s["rendering"] -= time.process_time()
            frames.append(episode.camera.capture())
            cpu_s["rendering"] += time.process_time()
    cpu_s["pull"] += time.process_time() - cpu_s["rendering"]
    assert len(frames) == FRAMES
    assert frames[0].rgb.shape == (480, 640, 3)
    return cpu_s


@pytest.mark.parametrize("name", ["drawer", "door"])
def test_an_episode_of_pull_with_thirty_frames(benchmark, name: str):
    with open_world(name, 0, "d455") as episode:
        shares = benchmark.pedantic(pull_episode, (episode,), rounds=1)
        assert episode.world.part_state() > 0.1
    benchmark.extra_info["cpu_s"] = {key: round(value, 2) for key, value in shares.items()}
    print(f"\n{name}, CPU s: {benchmark.extra_info['cpu_s']}, in all {sum(shares.values()):.1f}")
    assert sum(shares.values()) <= ALLOWED_CPU_S


@pytest.fixture(scope="module")
def held() -> Iterator[SimEpisode]:
    with open_world("drawer", 0, "clean") as episode:
        for _ in episode.arm.grasp(episode.T_world_grasp, 0.1):
            pass
        yield episode


def test_share_of_physics_in_a_step_while_the_hand_holds(benchmark, held: SimEpisode):
    benchmark.pedantic(held.world.step, rounds=20, iterations=5)


def test_share_of_dynamics_and_jacobian_in_a_step(benchmark, held: SimEpisode):
    kinematics, still = held.world.kinematics, np.zeros(7)

    def sense():
        kinematics.inverse_dynamics(Q_HOME, still, still, 0.02)
        return kinematics.update(Q_HOME)[1]

    assert benchmark(sense).shape == (6, 7)


def test_share_of_the_pulls_law_in_a_step(benchmark, held: SimEpisode):
    T, J = held.world.kinematics.update(Q_HOME)
    T, J, still = T.copy(), J.copy(), np.zeros(7)
    pull = Pull(np.array([-1.0, 0.0, 0.0]), 0.2, T, PullConfig())

    def law():
        wrench = pull.wrench(T, np.full(6, 0.01), 1e-3)
        return cartesian_torques(wrench, J, Q_HOME, still, Q_HOME, still, ImpedanceConfig())

    assert benchmark(law).shape == (7,)
