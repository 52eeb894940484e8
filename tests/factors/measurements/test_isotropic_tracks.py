"""Isotropic noise takes one number a point: the same answers as six numbers give."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.measurements.track_cost import TrackObservations, track_cost
from factors.measurements.track_information import (
    state_information,
    state_step,
    track_normal_equations,
)

DOF = 6.0


@pytest.fixture
def pair(kind, scene):
    """A scene and its tracks twice: in one number, and in six by a covariance hardly different."""
    s = scene(kind, isotropic=True, points=8)
    s.p_world[0, :2] = np.nan
    s.p_world[2:, 5] = np.nan
    cov = s.cov_world * np.random.default_rng(5).uniform(0.5, 2.0, (*s.q.shape, 8, 1, 1))
    nearly = cov.copy()
    nearly[..., 0, 0] *= 1 + 1e-12
    tracks = [TrackObservations.from_points(s.p_world, c) for c in (cov, nearly)]
    return s, *tracks


def test_isotropic_covariances_are_kept_as_one_number_and_others_as_six(pair):
    _, one, six = pair
    assert one.information_world.shape == (4, 1, 8)
    assert six.information_world.shape == (4, 6, 8)
    assert_allclose(one.log_det_cov, six.log_det_cov)


def test_cost_and_normal_equations_are_the_same_in_both_forms(pair):
    s, *forms = pair
    q = s.q + np.array([0.0, 0.002, -0.003, 0.001])
    costs = [track_cost(s.joint, q, t, DOF, 1.2) for t in forms]
    assert_allclose(costs[0].twice_cost, costs[1].twice_cost, rtol=1e-9)
    assert_allclose(costs[0].d2, costs[1].d2, rtol=1e-8, atol=1e-9)
    assert_allclose(costs[0].log_det_latent, costs[1].log_det_latent, rtol=1e-9)
    (H1, g1), (H6, g6) = (track_normal_equations(s.joint, q, cost) for cost in costs)
    assert_allclose(H1, H6, atol=1e-10 * H6.max())
    assert_allclose(g1, g6, atol=1e-9 * np.abs(g6).max())


def test_states_alone_are_the_same_in_both_forms(pair):
    s, *forms = pair
    q, x = s.q + 1e-3, s.x_joint.T
    steps = [state_step(s.joint, q, x, t, DOF, 1.2) for t in forms]
    assert_allclose(steps[0], steps[1], rtol=1e-9)
    information = [state_information(s.joint, track_cost(s.joint, q, t, DOF, 1.2)) for t in forms]
    assert_allclose(information[0], information[1], rtol=1e-8)


def test_selected_tracks_keep_their_form(pair):
    _, one, six = pair
    assert one.select(np.array([1, 3])).information_world.shape == (4, 1, 2)
    assert six.select(np.array([1, 3])).information_world.shape == (4, 6, 2)
