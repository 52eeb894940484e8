import numpy as np
import pytest

from experiments.baselines.config import CoarseConfig
from experiments.baselines.starts import (
    centroid_displacements,
    heuristic_hinge,
    prismatic_start,
    revolute_starts,
)
from experiments.trials.openings import make_opening


def _line_angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(np.abs(a @ b), 0, 1)))


def test_a_drawer_starts_along_the_line_between_its_first_and_last_centroid():
    opening = make_opening(0, "prismatic", noise_m=0.0, steady=True)
    start = prismatic_start(opening.tracks.p_world)
    np.testing.assert_allclose(start.axis[0], opening.axis, atol=1e-9)
    np.testing.assert_allclose(start.states[0], opening.q, atol=1e-9)


def test_a_hinge_starts_across_the_plane_of_motion_at_the_point_that_moves_least(angle_deg):
    opening = make_opening(1, "revolute", noise_m=0.0)
    p = opening.tracks.p_world
    axis, pivot = heuristic_hinge(p)
    assert _line_angle_deg(axis, opening.axis) < 1e-4
    hinge = opening.T_world_joint[:3, 3]
    radii = np.linalg.norm(np.cross(p[0] - hinge, opening.axis), axis=1)
    np.testing.assert_allclose(pivot, p[0, np.argmin(radii)])


def test_random_starts_fill_their_limits_and_stay_within():
    opening = make_opening(2, "revolute")
    p = opening.tracks.p_world
    starts = revolute_starts(p, CoarseConfig(starts=2000), np.random.default_rng(0))
    axis, pivot = heuristic_hinge(p)
    offset = np.abs(starts.pivot - pivot)
    tilt = _line_angle_deg(axis, starts.axis.T)
    assert starts.axis.shape == (2000, 3) and starts.states.shape == (2000, 20)
    assert 0.49 < offset.max() <= 0.5 + 1e-12
    assert 50 < tilt.max() <= 60 + 1e-6
    assert offset[0].max() == 0 and tilt[0] < 1e-4  # the heuristic itself is one of them
    np.testing.assert_allclose(np.linalg.norm(starts.axis, axis=1), 1)


def test_every_start_turns_forward_from_zero():
    opening = make_opening(3, "revolute", noise_m=0.0, steady=True)
    p = opening.tracks.p_world
    starts = revolute_starts(p, CoarseConfig(starts=50), np.random.default_rng(0))
    arm = p[0].mean(axis=0) - starts.pivot
    turning = np.cross(arm, arm + p[-1].mean(axis=0) - p[0].mean(axis=0))
    assert ((turning * starts.axis).sum(axis=1) >= 0).all()
    assert (starts.states[:, 0] == 0).all() and (starts.states >= 0).all()


def test_with_the_true_hinge_the_states_are_the_angles():
    opening = make_opening(4, "revolute", noise_m=0.0)
    p = opening.tracks.p_world.copy()
    p[:, 0] = opening.T_world_joint[:3, 3]  # a point on the axis never moves: the pivot
    starts = revolute_starts(p, CoarseConfig(starts=1), np.random.default_rng(0))
    np.testing.assert_allclose(starts.states[0], opening.q, atol=1e-6)


def test_lost_points_do_not_pull_the_centroid():
    p = np.zeros((2, 3, 3))
    p[1] = [1.0, 2.0, 3.0]
    p[1, 2] = np.nan
    np.testing.assert_allclose(centroid_displacements(p)[1], [1, 2, 3])


def test_points_that_end_where_they_began_give_no_direction():
    with pytest.raises(ValueError, match="no direction"):
        prismatic_start(np.zeros((3, 4, 3)))
