import numpy as np
import pytest

from akm_fg.posterior import StatePosterior
from akm_fg.records import JointTruth
from akm_fg.report.score import (
    aligned_truth,
    axis_angle_rad,
    coverage,
    line_distance_m,
    point_line_distance_m,
    score,
)

X, Y, Z = np.eye(3)


def test_opposite_axes_have_no_angle():
    assert axis_angle_rad(Z, -Z) == 0


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.01, 1.0, np.pi / 2])
def test_the_angle_between_axes_is_found_also_when_it_is_tiny(angle):
    tilted = np.cos(angle) * Z + np.sin(angle) * X
    np.testing.assert_allclose(axis_angle_rad(Z, tilted), angle, atol=1e-15)
    np.testing.assert_allclose(axis_angle_rad(-Z, tilted), angle, atol=1e-15)


def test_crossing_lines_are_as_far_apart_as_their_common_normal():
    # along x at height 0, along y at height 0.03: 3 cm, wherever the points on them are
    distance = line_distance_m(np.array([5.0, 0, 0]), X, np.array([0, -7.0, 0.03]), 2 * Y)
    np.testing.assert_allclose(distance, 0.03)


def test_parallel_lines_are_as_far_apart_as_their_points_across():
    distance = line_distance_m(np.zeros(3), Z, np.array([0.03, 0.04, 9.0]), -Z)
    np.testing.assert_allclose(distance, 0.05)


def test_a_point_is_as_far_from_a_line_as_its_foot():
    p = np.array([0.3, 0.4, -2.0])
    np.testing.assert_allclose(point_line_distance_m(p, np.zeros(3), 3 * Z), 0.5)


def test_true_states_start_at_zero_and_run_along_the_estimated_axis():
    states = StatePosterior("m", np.array([0.0, 0.1, np.nan, 0.3]), np.full(4, 0.01))
    truth = JointTruth("prismatic", -X, None, np.array([0.5, 0.4, 0.3, 0.19]))
    np.testing.assert_allclose(aligned_truth(states, X, truth), [0, 0.1, 0.2, 0.31])


def test_zero_is_the_first_frame_that_was_seen():
    states = StatePosterior("m", np.array([np.nan, 0.0, 0.1]), np.full(3, 0.01))
    truth = JointTruth("prismatic", X, None, np.array([0.0, 0.1, 0.2]))
    np.testing.assert_allclose(aligned_truth(states, X, truth), [-0.1, 0, 0.1], atol=1e-15)


def test_frames_beyond_the_truth_are_unknown():
    states = StatePosterior("m", np.zeros(3), np.zeros(3))
    truth = JointTruth("prismatic", X, None, np.array([1.0]))
    np.testing.assert_array_equal(aligned_truth(states, X, truth), [0, np.nan, np.nan])


def test_a_hinge_is_scored_by_hand_worked_values(scenes):
    found = score(scenes.posterior("revolute"), scenes.truth("revolute"))
    assert found.kind_correct
    np.testing.assert_allclose(found.axis_error_rad, 0.01)  # tilted by 0.01 rad about x
    np.testing.assert_allclose(found.pivot_error_m, np.hypot(0.003, 0.002))
    np.testing.assert_allclose(found.axis_distance_m, 0.003)  # the tilt meets the y offset
    assert np.isnan(found.state_errors[6]) and found.state_errors[0] == 0
    assert 0 < found.state_rms < 0.01


def test_an_undecided_answer_is_not_correct_but_its_likeliest_joint_is_scored(scenes):
    found = score(scenes.posterior("prismatic", "undecided"), scenes.truth("prismatic"))
    assert not found.kind_correct
    assert found.axis_error_rad == 0
    assert found.pivot_error_m is None and found.axis_distance_m is None


@pytest.mark.parametrize("kind", ["rigid", "prismatic"])
def test_joints_of_different_kinds_are_not_compared(scenes, kind):
    found = score(scenes.posterior(kind), scenes.truth("revolute"))
    assert not found.kind_correct
    assert found.axis_error_rad is None and found.state_errors is None
    assert found.state_rms is None and found.last_state_error is None


def test_coverage_counts_frames_within_the_bound_and_leaves_out_the_zero():
    states = StatePosterior("m", np.zeros(5), np.array([0.0, 1, 1, 1, 1]))
    errors = np.array([0.0, 1.9, -1.9, 2.0, np.nan])
    np.testing.assert_allclose(coverage(states, errors), 2 / 3)
    np.testing.assert_allclose(coverage(states, -errors), 2 / 3)
    assert coverage(states, np.full(5, np.nan)) is None
