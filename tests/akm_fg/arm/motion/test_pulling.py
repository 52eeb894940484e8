"""The compliant pull on a hand that is where the test says, and on one with mass and friction."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from akm_fg.arm.motion.pulling import Pull, PullConfig

DT_S = 1e-3
CONFIG = PullConfig()
X = np.array([1.0, 0.0, 0.0])


def pose(p: np.ndarray, R: np.ndarray | None = None) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = p
    T[:3, :3] = np.eye(3) if R is None else R
    return T


def pulled(pull: Pull, friction_n: float, seconds: float, mass_kg: float = 5.0) -> np.ndarray:
    """Positions and speeds (N, 2) along x of a sliding part of such a mass, at rest at 0."""
    x, v, way = 0.0, 0.0, []
    for _ in range(round(seconds / DT_S)):
        force = pull.wrench(pose(x * X), np.array([v, 0, 0, 0, 0, 0]), DT_S)[0]
        if v == 0.0 and abs(force) <= friction_n:
            a = 0.0
        else:
            a = (force - friction_n * np.sign(v or force)) / mass_kg
        stops = v != 0.0 and v * (v + a * DT_S) <= 0.0
        v = 0.0 if stops else v + a * DT_S
        x += v * DT_S
        way.append((x, v))
        if pull.finished:
            break
    return np.array(way)


@pytest.mark.parametrize("friction_n", [2.0, 8.0, 25.0])
def test_a_part_that_slides_is_pulled_as_far_as_asked_and_no_faster(friction_n: float):
    pull = Pull(X, 0.10, pose(np.zeros(3)), CONFIG)
    way = pulled(pull, friction_n, 8.0)
    assert pull.finished and pull.gave
    assert 0.095 < way[-1, 0] < 0.105
    assert way[:, 1].max() < 1.5 * CONFIG.speed_m_s
    assert abs(way[-1, 1]) < 1e-3


def test_a_part_that_does_not_give_feels_40_newton_for_a_second_and_a_half():
    """At 0.05 m/s of wanted speed the force grows by 12.5 N/s, 3 N of damping on top."""
    pull = Pull(X, 0.10, pose(np.zeros(3)), CONFIG)
    forces = []
    while not pull.finished and len(forces) < 10_000:
        forces.append(pull.wrench(pose(np.zeros(3)), np.zeros(6), DT_S)[0])
    assert not pull.gave and pull.travelled_m == 0.0
    assert max(forces) == pytest.approx(40.0)
    # 1 s to reach 0.05 m/s, in which half a second's lag is lost; 38 N of lag are 0.95 of the most.
    # Then it fades, so that a hand that lets go does not spring.
    held_s = 0.5 + 0.95 * 40.0 / 12.5 + 1.5
    assert len(forces) * DT_S == pytest.approx(held_s + CONFIG.settle_s, abs=0.05)
    assert forces[round(held_s / DT_S) - 60] > 35.0 and abs(forces[-1]) < 2.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_across_the_way_it_only_brakes(side: float):
    """40 N s/m on 0.1 m/s are 4 N, against the motion; where the hand is does not matter."""
    pull = Pull(X, 0.10, pose(np.zeros(3)), CONFIG)
    wrench = pull.wrench(pose(np.zeros(3)), np.array([0, 0.1 * side, 0, 0, 0, 0]), DT_S)
    assert wrench[1] == pytest.approx(-4.0 * side)
    assert Pull(X, 0.1, pose(np.zeros(3)), CONFIG).wrench(
        pose(np.array([0.0, 0.0005 * side, 0.0])), np.zeros(6), DT_S
    )[1] == pytest.approx(0.0)


def test_the_force_turns_with_the_way_the_hand_is_taken():
    """Round a hinge 0.3 m away; its direction is that of a few millimetres ago, 12 mm remembered.

    The chord of the memory lies half of it behind, its later half a quarter: three eighths.
    """
    radius, v = 0.3, 0.05
    pull = Pull(np.array([0.0, 1.0, 0.0]), 0.4, pose(np.array([radius, 0, 0])), CONFIG)
    for k in range(6000):
        q = v / radius * DT_S * k
        tangent = np.array([-np.sin(q), np.cos(q), 0.0])
        p = radius * np.array([np.cos(q), np.sin(q), 0.0])
        force = pull.wrench(pose(p), np.append(0.7 * v * tangent, np.zeros(3)), DT_S)[:3]
    turned = np.arccos(force @ tangent / np.linalg.norm(force))
    assert turned < (3 / 8 * CONFIG.memory_m + 0.001) / radius
    assert pull.travelled_m == pytest.approx(0.3, abs=0.002)


def test_the_wanted_orientation_follows_the_hand_that_a_door_turns():
    """0.1 rad give 0.6 N m against the turn; after the time constant of 0.2 s a share of 1 / e."""
    pull = Pull(X, 0.10, pose(np.zeros(3)), CONFIG)
    turned = pose(np.zeros(3), gtsam.Rot3.Rz(0.1).matrix())
    moments = np.array([pull.wrench(turned, np.zeros(6), DT_S)[3:] for _ in range(201)])
    np.testing.assert_allclose(moments[0], [0.0, 0.0, -0.6], atol=1e-9)
    np.testing.assert_allclose(moments[200, 2], -0.6 / np.e, rtol=0.02)
    spinning = pull.wrench(turned, np.array([0, 0, 0, 0, 0, 0.3]), DT_S)
    assert spinning[5] < moments[200, 2]  # damped


def test_a_part_that_suddenly_gives_is_braked():
    """At 0.2 m/s, 0.15 m/s too fast: 200 N s/m brake with 30 N where 60 N s/m would with 9."""
    pull = Pull(X, 0.10, pose(np.zeros(3)), CONFIG)
    for k in range(2000):
        pull.wrench(pose(0.05 * DT_S * k * X), np.array([0.05, 0, 0, 0, 0, 0]), DT_S)
    force = pull.wrench(pose(0.1 * X), np.array([0.2, 0, 0, 0, 0, 0]), DT_S)[0]
    assert force < -9.0
