import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.geometry.lines import line_in_joint_frame
from akm_fg.records import JointTruth
from experiments.scores.answers import JointFit, Uncertainty
from experiments.scores.scoring import brier_score, consistency_of, errors_of

T_EST = gtsam.Pose3(gtsam.Rot3.Expmap([0.3, -0.5, 0.8]), [0.2, 0.4, -0.1])
XI = np.array([2e-4, -1e-4, 0.0, 0.003, -0.001, 0.0])
SD = np.array([1e-4, 1e-4, 0.0, 0.001, 0.001, 0.0])


def _truth(xi=XI, sign=1.0, along=0.0, kind="revolute"):
    """The joint that is off by xi; its axis and pivot may be given otherwise, as the same line."""
    T = (T_EST * gtsam.Pose3.Expmap(xi)).matrix()
    pivot = T[:3, 3] + along * T[:3, 2] if kind == "revolute" else None
    states = sign * np.array([0.0, 0.1, 0.2])
    return JointTruth(kind, sign * T[:3, 2], pivot, states)


def _fit(kind="revolute", states=(0.0, 0.11, 0.222)):
    T = T_EST.matrix()
    claimed = Uncertainty(T, np.diag(SD**2), 2.45e-4, 0.00245, np.array([0.0, 0.01, 0.01]))
    pivot = T[:3, 3] if kind == "revolute" else None
    return JointFit(T[:3, 2], pivot, np.array(states), claimed)


@pytest.mark.parametrize(("sign", "along"), [(1.0, 0.0), (-1.0, 0.0), (1.0, 0.3)])
def test_the_tangent_of_a_line_is_the_one_it_was_made_with(sign, along):
    truth = _truth(sign=sign, along=along)
    assert_allclose(line_in_joint_frame(T_EST.matrix(), truth.axis, truth.pivot), XI, atol=2e-6)


def test_nees_is_the_error_over_the_claimed_sd_squared_and_summed():
    found = consistency_of(_fit(), _truth())
    assert_allclose(found.nees_axis, 4 + 1, rtol=1e-2)
    assert_allclose(found.nees_pivot, 9 + 1, rtol=1e-2)
    assert_allclose(found.nees_joint, 15, rtol=1e-2)
    assert found.dof_joint == 4
    assert_allclose(found.nees_last_state, 2.2**2)


def test_inside_is_below_chi_squares_95_percent():
    """5 < 5.99 (2), 10 > 5.99 (2), 15 > 9.49 (4), 4.84 > 3.84 (1)."""
    found = consistency_of(_fit(), _truth())
    assert (found.axis_inside95, found.pivot_inside95) == (True, False)
    assert (found.joint_inside95, found.last_state_inside95) == (False, False)
    assert (found.axis_inside_bound, found.pivot_inside_bound) == (True, False)
    assert found.states_inside95 == 0.5  # 0.01 off at sd 0.01; 0.022 off


def test_a_drawer_has_an_axis_and_no_pivot():
    found = consistency_of(_fit("prismatic"), _truth(kind="prismatic"))
    assert found.dof_joint == 2 and found.nees_pivot is None and found.pivot_inside95 is None
    assert_allclose(found.nees_joint, 5, rtol=1e-2)
    assert errors_of(_fit("prismatic"), _truth(kind="prismatic")).line_distance_m is None


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_errors_by_hand_with_either_sign_of_the_axis(sign):
    """Lines apart by |w . v| / |w|: (2 * 3 + 1 * 1) / sqrt(5) mm."""
    found = errors_of(_fit(), _truth(sign=sign))
    assert_allclose(found.axis_error_deg, np.degrees(np.hypot(2e-4, 1e-4)), rtol=1e-6)
    assert_allclose(found.pivot_error_m, np.hypot(0.003, 0.001), rtol=1e-3)
    assert_allclose(found.line_distance_m, 0.007 / np.sqrt(5), rtol=2e-3)
    assert_allclose(found.last_state_error, 0.022)
    assert_allclose(found.state_rms_error, np.sqrt((0.01**2 + 0.022**2) / 3))


def test_a_fit_without_a_covariance_is_scored_for_accuracy_alone():
    fit = JointFit(T_EST.matrix()[:3, 2], T_EST.translation(), np.array([0.0, 0.1, np.nan]))
    assert consistency_of(fit, _truth()).nees_joint is None
    assert_allclose(errors_of(fit, _truth()).last_state_error, 0.0, atol=1e-12)


def test_brier_score_by_hand():
    assert_allclose(
        brier_score({"revolute": 0.7, "prismatic": 0.2, "rigid": 0.1}, "revolute"), 0.14
    )
