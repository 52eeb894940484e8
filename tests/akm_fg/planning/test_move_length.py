"""A move goes as far as the joint's covariance bears, and no farther."""

import numpy as np
import pytest

from akm_fg.planning.move_length import LEVEL, MoveConfig, foreseen, next_move
from tests.akm_fg.manipulation.conftest import GRASP, paper_joint

CONFIG = MoveConfig(states=200)


def test_a_joint_that_is_known_is_followed_to_the_target():
    joint = paper_joint("revolute", 0.001, 0.0005)
    move = next_move(joint, GRASP, 0.0, 0.001, 0.6, 0.02, True, CONFIG)
    assert (move.q_end, move.bound) == (0.6, "target")


def test_a_slid_hand_is_off_by_the_axis_times_the_way():
    joint = paper_joint("prismatic", axis_sd=0.02)
    then = foreseen(joint, GRASP, 0.1, 0.0, np.array([0.2, 0.3]))
    assert then.across_m == pytest.approx(LEVEL * 0.02 * np.array([0.1, 0.2]), rel=1e-3)
    assert then.turn_rad == pytest.approx([0.0, 0.0], abs=1e-9)
    move = next_move(joint, GRASP, 0.1, 0.0, 0.6, 0.01, True, CONFIG)
    assert move.bound == "across"
    # 12 mm at 95 % are reached after 0.306 m.
    assert move.q_end - 0.1 == pytest.approx(CONFIG.across_m / (LEVEL * 0.02), abs=0.003)


def test_a_pivot_that_is_off_turns_into_errors_across_and_along():
    joint = paper_joint("revolute", pivot_sd=0.01)
    then = foreseen(joint, GRASP, 0.0, 0.0, np.array([0.5]))
    # A pivot off by e moves a turned point by (I - R) e: 2 sin(q / 2) of it, either way.
    assert then.across_m[0] == pytest.approx(LEVEL * 0.01 * 2 * np.sin(0.25), rel=1e-3)
    lever = np.hypot(0.04, 0.4)
    assert then.state[0] == pytest.approx(LEVEL * 0.01 * 2 * np.sin(0.25) / lever, rel=1e-3)


def test_unwatched_the_state_bounds_the_move_too():
    joint = paper_joint("revolute", pivot_sd=0.004)
    watched = next_move(joint, GRASP, 0.0, 0.002, 0.6, 0.005, True, CONFIG)
    unseen = next_move(joint, GRASP, 0.0, 0.002, 0.6, 0.005, False, CONFIG)
    assert watched.bound == "target"
    assert unseen.bound == "state"
    assert 0.0 < unseen.q_end < watched.q_end


def test_nothing_is_borne_of_a_joint_that_nobody_knows():
    joint = paper_joint("prismatic", axis_sd=1.0)
    assert next_move(joint, GRASP, 0.0, 0.0, 0.6, 0.01, True, MoveConfig()) is None


def test_closing_is_as_opening():
    joint = paper_joint("prismatic", axis_sd=0.02)
    opening = next_move(joint, GRASP, 0.0, 0.0, 0.5, 0.01, True, CONFIG)
    closing = next_move(joint, GRASP, 0.5, 0.0, 0.0, 0.01, True, CONFIG)
    assert opening.q_end == pytest.approx(0.5 - closing.q_end)
