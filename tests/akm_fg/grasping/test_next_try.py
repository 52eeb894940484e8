import gtsam
import numpy as np
import pytest

from akm_fg.grasping.next_try import NextTry

GRASP = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 1.1), np.array([0.4, -0.2, 0.3]))


def beside(x: float, y: float = 0.0, z: float = 0.0) -> gtsam.Pose3:
    return GRASP * gtsam.Pose3(gtsam.Rot3(), np.array([x, y, z]))


def test_the_next_try_goes_to_the_other_side_than_the_hand_was_pushed_to():
    next_try = NextTry()
    next_try.failed(GRASP, beside(0.009, 0.001, 0.005))
    corrected = next_try.corrected(GRASP)
    assert GRASP.transformTo(corrected.translation()) == pytest.approx([-0.009, 0.0, 0.0], abs=1e-9)
    next_try.failed(corrected, corrected * gtsam.Pose3(gtsam.Rot3(), np.array([-0.004, 0.0, 0.0])))
    again = next_try.corrected(GRASP)
    assert GRASP.transformTo(again.translation()) == pytest.approx([-0.005, 0.0, 0.0], abs=1e-9)


def test_a_hand_that_is_turned_about_is_moved_to_the_same_place():
    next_try = NextTry()
    next_try.failed(GRASP, beside(0.009))
    turned = GRASP * gtsam.Pose3(gtsam.Rot3.Rz(np.pi), np.zeros(3))
    here, there = (next_try.corrected(T).translation() for T in (GRASP, turned))
    assert here == pytest.approx(there, abs=1e-9)


@pytest.mark.parametrize("off", [(0.02, 0.0, 0.0), (0.009, 0.0, 0.06)])
def test_a_hand_that_did_not_get_there_tells_nothing(off):
    next_try = NextTry()
    next_try.failed(GRASP, beside(*off))
    assert next_try.corrected(GRASP).equals(GRASP, 1e-12)


def test_a_hand_that_met_nothing_and_was_not_pushed_goes_deeper_twice_and_no_more():
    next_try, depths = NextTry(), []
    for _ in range(4):
        T = next_try.corrected(GRASP)
        depths.append(GRASP.transformTo(T.translation())[2])
        next_try.failed(T, T * gtsam.Pose3(gtsam.Rot3(), np.array([0.001, 0.006, 0.004])))
    assert depths == pytest.approx([0.0, 0.008, 0.016, 0.016])


def test_other_places_are_left_as_they_are():
    next_try = NextTry()
    next_try.failed(GRASP, beside(0.009))
    far = beside(0.1)
    assert next_try.corrected(far).equals(far, 1e-12)
