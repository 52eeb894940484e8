"""A hand that holds what a camera sees tells the camera's scale."""

import gtsam
import numpy as np
import pytest

from akm_fg.manipulation.length_scale import LengthScale
from factors.joint import Joint


def at(x):
    return gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, x]))


def test_a_camera_that_sees_two_per_cent_too_much_is_found_out():
    scale = LengthScale(Joint("prismatic", np.eye(4), 0.0), sd=0.01)
    assert scale.true_state(0.102, 0.0005, 0.0)[1] == pytest.approx(0.00114, abs=1e-4)
    for way in np.linspace(0.0, 0.2, 9):
        scale.held(1.02 * (0.1 + way), 0.0005, at(0.7 + way))
    q, sd = scale.true_state(1.02 * 0.3, 0.0005, 0.0)
    # 0.2 m by a hand good to a millimetre tell a scale to half a per cent: a fifth is the prior's.
    assert q == pytest.approx(0.3, abs=0.0035)
    assert sd < 0.0025
    scale.let_go()
    assert scale.true_state(1.02 * 0.3, 0.0005, 0.0) == pytest.approx((q, sd))


def test_a_hand_that_slips_along_the_handle_tells_no_scale():
    scale = LengthScale(Joint("prismatic", np.eye(4), 0.0), sd=0.01)
    for way in np.linspace(0.0, 0.2, 9):
        scale.held(0.1 + 0.8 * way, 0.0005, at(0.7 + way))  # a fifth of the way is the hand's alone
    assert scale.mean == pytest.approx(0.0, abs=1e-9)
    assert scale.true_state(0.26, 0.0005, 0.0) == (0.26, pytest.approx(0.0026, rel=0.1))


def test_short_ways_and_single_frames_tell_nothing():
    scale = LengthScale(Joint("prismatic", np.eye(4), 0.0), sd=0.01)
    scale.held(0.1, 0.0005, at(0.0))
    scale.held(0.15, 0.0005, at(0.02))
    assert scale.mean == 0.0
    assert scale.sd == pytest.approx(0.01)


def test_angles_have_no_scale():
    scale = LengthScale(Joint("revolute", np.eye(4), 0.0), sd=0.01)
    for way in (0.0, 0.2):
        scale.held(1.5 * way, 0.0005, at(way))
    assert scale.true_state(0.5, 0.01, 0.0) == (0.5, 0.01)


def test_the_deviation_is_true_over_many_draws():
    rng = np.random.default_rng(3)
    joint = Joint("prismatic", np.eye(4), 0.0)
    ratio = []
    for _ in range(300):
        s = 0.01 * rng.standard_normal()
        scale = LengthScale(joint, sd=0.01)
        slack = 0.001 * rng.standard_normal()
        for k, way in enumerate((0.0, 0.05, 0.12)):
            q = (1 + s) * (0.1 + way + (k == 2) * slack)
            scale.held(q + 0.0005 * rng.standard_normal(), 0.0005, at(way))
        ratio.append((scale.mean - s) / scale.sd)
    assert 0.85 < np.std(ratio) < 1.15
