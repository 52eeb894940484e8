"""Following a path while holding a part, with a hand that is where the test says."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from akm_fg.arm.motion.reference import pose_reference
from akm_fg.arm.motion.tracking import PathTracker, TrackConfig
from akm_fg.records import HandPath, WayLimits

STEP_S = 1e-3
CONFIG = TrackConfig()


def tracker(length_m: float, duration_s: float) -> PathTracker:
    """Along world x, from the origin, in so long.

    With speed and acceleration free, from rest to rest takes (32 d / j)^(1/3).
    """
    way = np.linspace(0.0, 1.0, 12)
    poses = tuple(gtsam.Pose3(gtsam.Rot3(), np.array([length_m * s, 0.0, 0.0])) for s in way)
    path = HandPath(way, poses, WayLimits(1e3, 1e3, 32.0 / duration_s**3))
    return PathTracker(pose_reference(path, np.eye(4), STEP_S), CONFIG)


def held_at(follower: PathTracker, x_m: float, seconds: float, y_m: float = 0.0) -> np.ndarray:
    """Wrenches (N, 6) on a hand that does not give way."""
    T = np.eye(4)
    T[:3, 3] = [x_m, y_m, 0.0]
    steps = round(seconds / STEP_S)
    return np.array([follower.wrench(T, np.zeros(6), STEP_S) for _ in range(steps)])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_part_that_does_not_give_way_is_pulled_no_harder_than_the_spring_and_what_parts_ask_for(
    side: float,
):
    """Stuck 1 cm before the end: 7 N of spring, and 25 N more, what furniture asks for at most.

    For that see `sim.objects.suites.furniture_physics`. Two pads pressed on with 70 N hold
    2 * 0.5 * 70 N = 70 N even where the friction is 0.5.
    """
    follower = tracker(side * 0.05, 1.0)
    held_at(follower, side * 0.05, 1.0)  # the path's time goes by
    force = held_at(follower, side * 0.04, 2.5)[:, 0] * side
    assert force[0] < 10.0 + 7.0
    assert np.abs(force).max() <= 700.0 * 0.01 + 25.0 + 1e-9
    assert force[-1] == pytest.approx(32.0)


def test_a_part_that_stuck_is_let_go_before_the_hand_has_gone_far_beyond():
    """What is taken up is bounded, and falls five times as fast as it grew."""
    follower = tracker(0.05, 1.0)
    held_at(follower, 0.05, 1.0)
    held_at(follower, 0.04, 10.0)
    # 25 N at 5 * 5 / s * 700 N/m * 0.01 m = 175 N/s: after 0.145 s only the spring is left, and
    # from there on the integral grows the other way at 35 N/s.
    force = held_at(follower, 0.06, 0.345)[:, 0]
    assert force[144] == pytest.approx(-7.0, abs=0.5)
    assert force[-1] == pytest.approx(-14.0, abs=0.5)


def test_an_error_across_the_path_builds_up_no_force():
    follower = tracker(0.05, 1.0)
    held_at(follower, 0.05, 1.0)
    force = held_at(follower, 0.05, 2.0, y_m=0.01)
    np.testing.assert_allclose(force[:, 1], -7.0, atol=1e-9)
    np.testing.assert_allclose(force[:, 0], force[0, 0], atol=1e-9)


def test_however_far_off_the_hand_is_the_force_stays_below_what_friction_holds():
    follower = tracker(0.3, 1.0)
    force = held_at(follower, -0.5, 2.0, y_m=0.4)
    assert np.linalg.norm(force[:, :3], axis=1).max() <= 60.0 + 1e-9


def test_a_hand_at_rest_at_the_end_is_done_after_its_rest_and_one_that_is_not_gives_up():
    follower = tracker(0.05, 1.0)
    held_at(follower, 0.05, 1.29)
    assert not follower.finished
    held_at(follower, 0.05, 0.03)
    assert follower.finished
    stuck = tracker(0.05, 1.0)
    # It may pull on for 0.6 * 3 s, and then rests for 0.3 s.
    held_at(stuck, 0.04, 1.0 + 1.8 + 0.28)
    assert not stuck.finished
    held_at(stuck, 0.04, 0.04)
    assert stuck.finished


def test_a_path_that_is_broken_off_comes_to_rest_before_it_lets_go():
    follower = tracker(0.3, 3.0)
    held_at(follower, 0.15, 1.5)  # in the middle, at full speed
    assert not follower.passed
    follower.brake()
    steps = 0
    while not follower.passed:
        held_at(follower, 0.15, STEP_S)
        steps += 1
    # 0.2 m/s at 0.3 * 32 / 27 m/s^3 of jerk: 2 sqrt(v / j) is the fastest stop.
    assert steps * STEP_S == pytest.approx(2.0 * np.sqrt(0.2 / (0.3 * 32.0 / 27.0)), abs=0.01)
