"""A front that stands open is pushed towards closed where it goes that way, beside its handle."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.errors import MotionInfeasible
from akm_fg.manipulation.config import HoldConfig, PushConfig
from akm_fg.manipulation.pushing import choose_push
from akm_fg.posterior import JointPosterior
from factors.joint import Joint, JointKind
from tests.akm_fg.manipulation.conftest import paper_posterior

# The front of the paper parts: x = 0.54, y from -0.3 to 0.3, z from 0.2 to 0.6, seen along +x;
# its bar stands upright at y = 0, from z = 0.3 to 0.5.
PUSH, HOLD = PushConfig(), HoldConfig()


class Everywhere:
    """An arm that gets to all poses, or to those that it is told."""

    def __init__(self, may=lambda T: True, share=1.0):
        self.may, self.share, self.asked = may, share, []

    def reachable(self, T_world_grasp, onward=()):
        self.asked.append(T_world_grasp)
        if not self.may(T_world_grasp):
            raise MotionInfeasible("the grasp is out of the arm's reach")
        return self.share


def test_a_drawer_is_pushed_near_its_middle_and_not_on_its_handle(paper_part):
    arm = Everywhere()
    T, reach = choose_push(arm, paper_part("prismatic"), 0.3, 0.1, PUSH, HOLD)
    assert reach == 1.0
    assert_allclose(T.rotation().matrix()[:, 2], [1.0, 0.0, 0.0], atol=1e-9)  # into the front
    x, y, z = T.translation()
    assert x == pytest.approx(0.54 - 0.3 - PUSH.tip_m)  # the tips are on it where it stands
    assert PUSH.clear_m <= abs(y) < 0.09 or not 0.25 < z < 0.55
    # The arm was asked for where the hand begins, before the front.
    assert arm.asked[0].translation()[0] == pytest.approx(x - PUSH.before_m)


def test_a_door_is_pushed_far_from_its_hinge(paper_part):
    T, _ = choose_push(Everywhere(), paper_part("revolute"), -0.3, 0.0, PUSH, HOLD)
    lever = T.translation() - [0.54, 0.4, 0.0]  # off the hinge
    assert np.hypot(*lever[:2]) > 0.6


def test_what_opens_is_not_pushed_and_neither_is_what_slides_along_its_front(paper_part):
    with pytest.raises(MotionInfeasible, match="no place of its front"):
        choose_push(Everywhere(), paper_part("prismatic"), 0.1, 0.3, PUSH, HOLD)
    along = gtsam.Pose3(gtsam.Rot3.Rx(-np.pi / 2), np.zeros(3))  # z of the joint is y of the world
    joint = JointPosterior(Joint(JointKind.PRISMATIC, along.matrix(), 0.0), np.zeros((6, 6)))
    part = replace(paper_part("prismatic"), posterior=paper_posterior(joint))
    with pytest.raises(MotionInfeasible, match="no place of its front"):
        choose_push(Everywhere(), part, 0.3, 0.1, PUSH, HOLD)


def test_a_place_that_the_arm_gets_to_is_looked_for_and_its_word_is_told_where_there_is_none(
    paper_part,
):
    part = paper_part("prismatic")
    T, _ = choose_push(Everywhere(lambda T: T.translation()[2] > 0.45), part, 0.3, 0.1, PUSH, HOLD)
    assert T.translation()[2] > 0.45
    nowhere = Everywhere(lambda T: False)
    with pytest.raises(MotionInfeasible, match="out of the arm's reach"):
        choose_push(nowhere, part, 0.3, 0.1, PUSH, HOLD)
    assert len(nowhere.asked) <= PUSH.most
    with pytest.raises(MotionInfeasible, match="far enough"):
        choose_push(Everywhere(share=0.1), part, 0.3, 0.1, PUSH, HOLD)


def test_a_part_without_a_front_is_not_pushed(paper_part):
    part = replace(paper_part("prismatic"), contacts=())
    with pytest.raises(MotionInfeasible, match="no front"):
        choose_push(Everywhere(), part, 0.3, 0.1, PUSH, HOLD)
