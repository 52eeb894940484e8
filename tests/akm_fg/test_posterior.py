"""What the answer says about itself: axis, pivot, and bounds that hold what they promise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    FitReport,
    JointPosterior,
    KindPosterior,
    StatePosterior,
    normal_bound,
    radius_quantile,
)
from factors.joint import Joint


def _joint(kind="revolute", cov=None):
    T = np.array([[0, 0, 1.0, 2], [1, 0, 0, 3], [0, 1, 0, 4], [0, 0, 0, 1]])
    return JointPosterior(Joint(kind, T, 0.0), np.zeros((6, 6)) if cov is None else cov)


@pytest.mark.parametrize("level", [0.5, 0.95, 0.99])
@pytest.mark.parametrize("sds", [(1.0, 1.0), (3.0, 1.0), (1.0, 0.05)])
def test_radius_quantile_holds_its_share_of_samples(level, sds):
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    cov = turn @ np.diag(np.square(sds)) @ turn.T
    x = np.random.default_rng(0).multivariate_normal(np.zeros(2), cov, 200_000)
    inside = (np.hypot(*x.T) <= radius_quantile(cov, level)).mean()
    assert_allclose(inside, level, atol=4 * np.sqrt(level * (1 - level) / 200_000))


def test_radius_quantile_of_a_round_cloud_is_rayleighs():
    assert_allclose(radius_quantile(4e-6 * np.eye(2), 0.95), 0.002 * stats.rayleigh.ppf(0.95))


def test_radius_quantile_of_a_line_is_the_normals():
    assert_allclose(radius_quantile(np.diag([9.0, 0.0]), 0.95), 3 * 1.959964, rtol=1e-4)


def test_radius_quantile_of_no_uncertainty_is_zero():
    assert radius_quantile(np.zeros((2, 2)), 0.95) == 0


def test_radius_quantile_grows_with_the_level():
    radii = [radius_quantile(np.diag([4.0, 1.0]), level) for level in (0.1, 0.5, 0.9, 0.999)]
    assert (np.diff(radii) > 0).all()


def test_normal_bound_at_95_percent_is_1_96():
    assert_allclose(normal_bound(0.95), 1.959964, rtol=1e-6)
    assert_allclose(normal_bound(0.6826895), 1.0, rtol=1e-6)


def test_axis_is_the_z_axis_and_pivot_the_origin_of_the_joint_frame():
    assert_allclose(_joint().axis, [1, 0, 0])
    assert_allclose(_joint().pivot, [2, 3, 4])


def _evidence(total):
    return Evidence(total, 0.0, 0.0, 0.0)


def test_a_drawer_has_no_pivot():
    drawer = _joint("prismatic")
    assert drawer.pivot is None and drawer.pivot_sd_m is None and drawer.pivot_bound_m() is None


def test_deviations_and_bounds_are_those_of_the_covariance():
    joint = _joint(cov=np.diag([9e-6, 1e-6, 0, 4e-6, 4e-6, 0]))
    assert_allclose(joint.axis_sd_rad, np.sqrt(5e-6))
    assert_allclose(joint.pivot_sd_m, 0.002)
    assert_allclose(joint.axis_bound_rad(), radius_quantile(np.diag([9e-6, 1e-6]), 0.95))
    assert_allclose(joint.pivot_bound_m(0.9), 0.002 * stats.rayleigh.ppf(0.9))


def test_best_is_the_most_probable_kind_even_where_none_is_named():
    alternatives = {
        "rigid": KindPosterior(None, None, _evidence(-9.0)),
        "prismatic": KindPosterior(_joint("prismatic"), None, _evidence(-1.0)),
        "revolute": KindPosterior(_joint(), None, _evidence(-2.0)),
    }
    posterior = ArticulationPosterior(
        name="x",
        kind="undecided",
        kind_probability={"rigid": 0.0, "prismatic": 0.73, "revolute": 0.27},
        alternatives=alternatives,
        fit=None,  # plays no part
    )
    assert posterior.best is alternatives["prismatic"]


def test_an_answer_of_some_frames_knows_nothing_of_the_others():
    states = StatePosterior("rad", np.array([0.0, 0.1, 0.3]), np.array([0.0, 0.01, 0.02]))
    best = KindPosterior(_joint(), states, _evidence(0.0))
    rigid = KindPosterior(None, None, _evidence(-9.0))
    report = FitReport(0, 1, 0, 0, 1, 1, 1, True, keyframes_registered=(0, 2), holds=((1, 2),))
    alternatives = {"rigid": rigid, "revolute": best}
    some = ArticulationPosterior("x", "revolute", {"revolute": 1.0}, alternatives, report)
    of_all = some.over_frames(np.array([0, 2, 5]), 6)
    mean = of_all.best.states.mean
    np.testing.assert_array_equal(np.isfinite(mean), [1, 0, 1, 0, 0, 1])
    assert_allclose(mean[[0, 2, 5]], states.mean)
    assert_allclose(of_all.best.states.sd[[0, 2, 5]], states.sd)
    assert of_all.alternatives["rigid"] is not None and of_all.best.joint is best.joint
    assert of_all.fit.keyframes_registered == (0, 5) and of_all.fit.holds == ((2, 5),)
