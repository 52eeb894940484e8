"""Priors of a joint are densities: what they integrate to is known."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import integrate

from akm_fg.estimation.config import PriorConfig
from akm_fg.estimation.joint_prior import log_joint_prior, log_state_prior, metres_per_unit
from factors.joint import Joint

PRIOR = PriorConfig()
CENTROID = np.array([0.4, -0.2, 0.7])
HALF_SPHERE = 2 * math.pi  # an axis' sign is a convention


def _hinge(dx: float, dy: float, pitch: float = 0.0) -> Joint:
    """Upright, at an offset from the centroid."""
    T = np.eye(4)
    T[:3, 3] = CENTROID + np.array([dx, dy, 0.3])
    return Joint("helical" if pitch else "revolute", T, pitch)


def _density(rho: float, bearing: float) -> float:
    joint = _hinge(rho * math.cos(bearing), rho * math.sin(bearing))
    return math.exp(log_joint_prior(joint, CENTROID, PRIOR))


def test_hinges_over_the_whole_plane_have_probability_one():
    """In square metres of the plane across the axis, one solid angle of axes at a time."""
    whole, _ = integrate.quad(lambda rho: 2 * math.pi * rho * _density(rho, 0.7), 0, 30, limit=400)
    assert_allclose(whole * HALF_SPHERE, 1.0, rtol=1e-6)


def test_half_of_the_hinges_lie_within_the_median_distance_and_95_percent_within_the_stated_range():
    """Of a log-normal: exp(1.96 * 0.6) = 3.24 times and a 3.24th of the median."""

    def share(low: float, high: float) -> float:
        found, _ = integrate.quad(lambda r: 2 * math.pi * r * _density(r, 0.0), low, high)
        return found * HALF_SPHERE

    assert_allclose(share(1e-6, 0.3), 0.5, atol=1e-4)
    assert_allclose(share(0.3 / 3.2414, 0.3 * 3.2414), 0.95, atol=1e-3)


def test_no_bearing_of_the_hinge_is_likelier_than_another():
    assert_allclose([_density(0.35, b) for b in (0.0, 1.0, 3.0, 5.0)], _density(0.35, 2.0))


def test_screws_of_all_pitches_together_weigh_what_their_hinge_weighs():
    hinge = math.exp(log_joint_prior(_hinge(0.3, 0.0), CENTROID, PRIOR))

    def screw(pitch: float) -> float:
        return math.exp(log_joint_prior(_hinge(0.3, 0.0, pitch), CENTROID, PRIOR))

    whole = 2 * integrate.quad(screw, 1e-12, 1.0, points=[0.05, 0.2])[0]
    assert_allclose(whole, hinge, rtol=1e-6)


def test_a_drawers_axis_is_uniform_over_the_half_sphere():
    drawer = Joint("prismatic", np.eye(4), 0.0)
    assert_allclose(math.exp(log_joint_prior(drawer, CENTROID, PRIOR)) * HALF_SPHERE, 1.0)


@pytest.mark.parametrize("spread", [0.05, 0.3])
def test_the_density_of_a_state_is_that_of_a_travel_of_unknown_length_and_place(spread: float):
    """n states with spread R (state zero among them): the integral over travels L of
    p(L) * (the places of [0, L] that hold them all) / L * L^-n is solved by quadrature.
    """
    q = np.array([0.0, spread, 0.4 * spread, 0.7 * spread])
    n, low, high = 3, PRIOR.least_travel_m, PRIOR.largest_travel_m

    def joint_density(L: float) -> float:
        return 1 / (L * math.log(high / low)) * (L - spread) / L * L**-n

    whole, _ = integrate.quad(joint_density, spread, math.inf)
    assert_allclose(log_state_prior(q, 1.0, PRIOR), math.log(whole) / n, rtol=1e-6)
    # The same motion in other units of the state.
    assert_allclose(log_state_prior(q / 0.5, 0.5, PRIOR) - math.log(0.5), math.log(whole) / n)


def test_a_part_moves_by_the_root_mean_square_of_its_points():
    """Four points 0.1 m about a centroid 0.3 m from the axis: 0.3^2 + 0.1^2, and the pitch."""
    x = CENTROID + np.array([[0.1, 0, 0], [-0.1, 0, 0], [0, 0.1, 0], [0, -0.1, 0]])
    for pitch in (0.0, 0.2):
        joint = _hinge(0.3, 0.0, pitch)
        R, t = joint.motion(np.array([1e-6]))
        moved = np.linalg.norm(x @ R[0].T + t[0] - x, axis=1) / 1e-6
        rms = math.sqrt(float((moved**2).mean()))
        assert_allclose(metres_per_unit(joint, CENTROID, 0.1), rms, rtol=1e-5)
    assert metres_per_unit(Joint("prismatic", np.eye(4), 0.0), CENTROID, 0.1) == 1.0
