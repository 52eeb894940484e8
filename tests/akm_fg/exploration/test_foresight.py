import gtsam
import numpy as np
import pytest

from akm_fg.exploration.foresight import PLACES, Pulled, foreseen, information
from akm_fg.posterior import JointPosterior
from experiments.trials.bound import cramer_rao_bound
from experiments.trials.openings import SIGMA_M, Opening, make_opening
from factors.joint import Joint


def placed(opening: Opening) -> Joint:
    """The true joint, its frame moved along the axis next to the points, as a posterior's is."""
    R, t = opening.T_world_joint[:3, :3], opening.T_world_joint[:3, 3]
    middle = ((opening.rest_world - t) @ R).mean(axis=0)
    shift = np.array([0.0, 0.0, middle[2]]) if opening.kind == "revolute" else middle
    T = gtsam.Pose3(opening.T_world_joint) * gtsam.Pose3(gtsam.Rot3(), shift)
    return Joint(opening.joint.kind, T.matrix(), 0.0)


def bound(opening: Opening) -> JointPosterior:
    """The Cramer-Rao bound, which shares no line with what is tested, as a posterior."""
    joint, cov = placed(opening), np.zeros((6, 6))
    known = list(joint.kind.observable)
    cov[np.ix_(known, known)] = cramer_rao_bound(opening).cov_line
    return JointPosterior(joint, cov)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_the_information_is_that_of_the_cramer_rao_bound(kind):
    opening = make_opening(1, kind, 0.3, frames=PLACES, steady=True)
    told = information(placed(opening), opening.rest_world, Pulled(opening.q[-1], PLACES))
    want = cramer_rao_bound(opening).cov_line
    np.testing.assert_allclose(SIGMA_M**2 * np.linalg.inv(told), want, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("more", [1.3, 2.0])
def test_what_is_foreseen_is_what_the_longer_pull_then_tells(kind, more):
    """Bounds of a pull of twice the way from those of the shorter one, noise level unknown."""
    short = make_opening(2, kind, 0.15, frames=PLACES, steady=True)
    far = make_opening(2, kind, 0.15 * more, frames=PLACES, steady=True)
    expected = foreseen(
        bound(short),
        short.rest_world,
        Pulled(float(short.q[-1]), PLACES),
        Pulled(float(far.q[-1]), PLACES),
    )
    then = bound(far)
    assert expected.axis_bound_rad() == pytest.approx(then.axis_bound_rad(), rel=0.02)
    if kind == "revolute":
        assert expected.pivot_bound_m() == pytest.approx(then.pivot_bound_m(), rel=0.02)


def test_no_further_way_tells_nothing_more():
    opening = make_opening(3, "revolute", 0.2, frames=PLACES, steady=True)
    here = Pulled(float(opening.q[-1]), PLACES)
    known = bound(opening)
    expected = foreseen(known, opening.rest_world, here, here)
    np.testing.assert_allclose(expected.cov, known.cov, rtol=1e-9, atol=1e-18)


def test_a_part_without_points_foresees_nothing_and_does_not_fail():
    opening = make_opening(3, "revolute", 0.2, frames=PLACES, steady=True)
    known = bound(opening)
    expected = foreseen(known, np.zeros((0, 3)), Pulled(0.2, 8), Pulled(0.4, 16))
    np.testing.assert_array_equal(expected.cov, known.cov)
