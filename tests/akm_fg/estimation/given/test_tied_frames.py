"""Which frames belong together: patches that both see tie them, and points that are followed."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.given.problem import problem_of_tracks
from akm_fg.estimation.given.tied_frames import most_telling, off_the_path, tied_frames
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.records import PointTracks
from experiments.trials.openings import make_opening
from factors.joint import Joint, JointKind

NONE, ALL = np.zeros((5, 0), dtype=bool), np.arange(5)


def _seen(*ranges: tuple[int, int]) -> np.ndarray:
    seen = np.zeros((len(ranges), 300), dtype=bool)
    for row, (a, b) in zip(seen, ranges, strict=True):
        row[a:b] = True
    return seen


def _tied_to_first(label: np.ndarray) -> np.ndarray:
    return label == label[0]


def test_views_with_patches_in_common_are_tied_also_through_others():
    seen = _seen((0, 100), (80, 180), (160, 260), (80, 150), (100, 200))
    assert _tied_to_first(tied_frames(NONE, ALL, seen)).all()


def test_views_of_another_surface_are_not_however_many_they_are():
    seen = _seen((0, 100), (0, 100), (100, 300), (100, 300), (100, 300))
    label = tied_frames(NONE, ALL, seen)
    assert_array_equal(_tied_to_first(label), [True, True, False, False, False])


def test_a_few_patches_in_common_are_chance():
    seen = _seen((0, 100), (0, 100), (91, 291), (95, 295), (0, 100))
    label = tied_frames(NONE, ALL, seen)
    assert_array_equal(_tied_to_first(label), [True, True, False, False, True])


def test_tracks_tie_views_that_share_no_patch():
    seen = _seen((0, 100), (100, 200), (200, 300), (0, 100), (0, 100))
    followed = np.array([[True], [True], [False], [False], [False]])
    label = tied_frames(followed, ALL, seen)
    assert_array_equal(_tied_to_first(label), [True, True, False, True, True])


def test_tracks_of_one_side_do_not_tie_frames_with_those_of_the_other():
    """Points of the front end before those of the back begin: nothing is in both."""
    followed = np.array([[1, 0], [1, 0], [0, 0], [0, 1], [0, 1]], dtype=bool)
    seen = np.zeros((2, 300), dtype=bool)
    seen[:, :50] = True  # of frames 2 and 3
    label = tied_frames(followed, np.array([2, 3]), seen)
    assert_array_equal(_tied_to_first(label), [True, True, False, False, False])
    assert label[2] == label[3] == label[4]


def test_the_group_that_moves_most_tells_most_and_what_rests_nothing():
    """Three frames of what rests, well seen; two that turn a little, three that turn far."""
    label = np.array([0, 0, 0, 1, 1, 2, 2, 2])
    q = np.array([0.0, 0.0, 0.0, 0.1, 0.2, 1.0, 1.3, 1.6])
    guess = JointGuess(Joint(JointKind.REVOLUTE, np.eye(4), 0.0), q)
    weights = np.array([100.0, 100, 100, 2, 2, 1, 1, 1])
    information = np.kron(np.diag(weights), np.eye(6))
    assert_array_equal(most_telling(label, guess, information), label == 2)


@pytest.mark.parametrize("at", [4, 9])
def test_a_state_that_lies_beyond_both_its_neighbours_is_off_the_path(at: int):
    q = np.linspace(0.0, 0.9, 10)
    assert not off_the_path(q).any()
    q[at] = -0.8
    assert_array_equal(off_the_path(q), np.arange(10) == at)


def test_a_part_may_go_far_and_on_or_come_back_a_little():
    q = np.concatenate([np.linspace(0.0, 0.4, 5), 2.0 + np.linspace(0.0, 0.4, 5)])
    assert not off_the_path(q).any()
    q[-1] = q[-2] - 0.2
    assert not off_the_path(q).any()
    assert not off_the_path(np.append(q[:-1], 4.0)).any()
    assert not off_the_path(np.array([0.0, 0.1, 0.2, 2.0, 4.0, 4.1, 4.2, 4.3])).any()


def test_tracks_of_frames_that_are_left_out_are_left_out_with_them():
    opening = make_opening(1, "revolute")
    p_world = opening.tracks.p_world.copy()
    half = len(p_world) // 2
    p_world[half:, :10] = np.nan
    tracks = PointTracks(p_world, opening.tracks.cov_world)
    problem = problem_of_tracks("door", tracks, True, 0, FitConfig())
    lost = np.isin(problem.members, np.arange(10))
    assert lost.any()
    left = problem.restricted(np.arange(half, len(problem.keyframes)))
    assert_array_equal(left.members, problem.members[~lost])
    assert left.tracks.observations.observed.any(axis=0).all()
    assert left.points.p_world.shape[1] == left.members.size


def test_states_that_jump_back_to_before_where_the_part_began_are_off_the_path():
    """A door's face that is edge-on is lost; the cabinet's side then looks like it, far behind."""
    opening = [0.0, 0.13, 0.19, 0.24, 0.41, 0.46, 0.53, 0.55, 0.62]
    q = np.array([*opening, -1.56, -1.56, -1.56])
    frames = np.array([*range(9), 12, 13, 14])
    assert_array_equal(off_the_path(q, None, frames), frames >= 12)
    assert_array_equal(off_the_path(-q, None, frames), frames >= 12)
    again = np.array([*q, 1.1, 1.2])
    assert_array_equal(
        off_the_path(again, None, np.array([*frames, 15, 16])),
        [False] * 9 + [True] * 3 + [False] * 2,
    )


def test_states_between_a_far_step_back_and_a_far_step_on_are_off_the_path():
    """A laptop's lid that is edge-on is lost, and its base lies where the lid began."""
    q = np.array([0.0, 0.05, 0.06, 0.12, 0.17, 0.22, -0.04, -0.04, -0.05, 0.7, 0.72, 0.87, 0.95])
    lost = (q < 0) & (np.arange(q.size) > 0)
    assert_array_equal(off_the_path(q), lost)
    assert_array_equal(off_the_path(-q), lost)


def test_of_a_run_astray_and_the_path_after_it_the_shorter_is_off():
    """A dark seat that is edge-on fits far ahead; a step near the end is a little too far."""
    q = np.array([0.0, 0.02, 0.1, 0.21, 0.23, 1.52, 1.64, 1.65, 1.65, 0.59, 0.6, 0.67, 0.73, 0.75,
                  0.79, 0.83, 0.94, 0.96, 1.18, 1.2])  # fmt: skip
    assert_array_equal(off_the_path(q), q > 1.3)


def test_a_door_that_is_slammed_shut_stays_on_the_path():
    opening = np.linspace(0.0, 0.6, 10)
    assert not off_the_path(np.array([*opening, 0.02, 0.01, 0.0])).any()


def test_far_steps_over_frames_that_nobody_sees_are_none():
    """Six frames apart it goes six times as far."""
    q = np.array([0.0, 0.1, 0.2, 0.3, 1.2, 0.45, 0.6])
    frames = np.array([0, 1, 2, 3, 9, 13, 14])
    assert off_the_path(q).any()
    assert not off_the_path(q, None, frames).any()
