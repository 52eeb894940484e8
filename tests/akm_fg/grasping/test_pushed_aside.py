import gtsam
import numpy as np
import pytest

from akm_fg.grasping.pushed_aside import PushedAside

GRASP = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 1.1), np.array([0.4, -0.2, 0.3]))


def beside(x: float, y: float = 0.0, z: float = 0.0) -> gtsam.Pose3:
    return GRASP * gtsam.Pose3(gtsam.Rot3(), np.array([x, y, z]))


def test_the_next_try_goes_to_the_other_side_than_the_hand_was_pushed_to():
    aside = PushedAside()
    aside.failed(GRASP, beside(0.009, 0.001, 0.005))
    corrected = aside.corrected(GRASP)
    assert GRASP.transformTo(corrected.translation()) == pytest.approx([-0.009, 0.0, 0.0], abs=1e-9)
    aside.failed(corrected, corrected * gtsam.Pose3(gtsam.Rot3(), np.array([-0.004, 0.0, 0.0])))
    again = aside.corrected(GRASP)
    assert GRASP.transformTo(again.translation()) == pytest.approx([-0.005, 0.0, 0.0], abs=1e-9)


def test_a_hand_that_is_turned_about_is_moved_to_the_same_place():
    aside = PushedAside()
    aside.failed(GRASP, beside(0.009))
    turned = GRASP * gtsam.Pose3(gtsam.Rot3.Rz(np.pi), np.zeros(3))
    here, there = (aside.corrected(T).translation() for T in (GRASP, turned))
    assert here == pytest.approx(there, abs=1e-9)


@pytest.mark.parametrize(
    "off", [(0.001, 0.0, 0.0), (0.0, 0.009, 0.0), (0.02, 0.0, 0.0), (0.009, 0.0, 0.06)]
)
def test_what_is_no_push_along_the_pads_tells_nothing(off):
    aside = PushedAside()
    aside.failed(GRASP, beside(*off))
    assert aside.corrected(GRASP).equals(GRASP, 1e-12)


def test_other_places_are_left_as_they_are():
    aside = PushedAside()
    aside.failed(GRASP, beside(0.009))
    far = beside(0.1)
    assert aside.corrected(far).equals(far, 1e-12)
