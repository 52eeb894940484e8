"""Grasps go along with the part, and the one that leads farthest is taken."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.errors import MotionInfeasible
from akm_fg.manipulation.carried_grasps import carried, choose_grasp, not_so_deep, variants, way_of
from akm_fg.manipulation.config import HoldConfig
from tests.akm_fg.manipulation.conftest import GRASP, HINGE

CONFIG = HoldConfig()


class Asked:
    """An arm that answers by the grasp's approach."""

    def __init__(self, reach):
        self.reach, self.asked = reach, []

    def reachable(self, T_world_grasp, onward=()):
        self.asked.append(T_world_grasp)
        told = self.reach(T_world_grasp)
        if told is None:
            raise MotionInfeasible("the grasp is out of the arm's reach")
        return told


def test_a_grasp_turns_with_its_door(paper_part):
    (grasp,) = carried(paper_part("revolute"), np.pi / 2, 0.0, CONFIG)
    # A quarter turn about the hinge at (0.54, 0.4): (0.5, 0) comes to (0.94, 0.36).
    assert_allclose(grasp.T_world_grasp.translation(), [0.94, 0.36, 0.4], atol=0.02)
    turn = HINGE.rotation().between(HINGE.rotation() * gtsam.Rot3.Rz(np.pi / 2))
    assert_allclose(
        grasp.T_world_grasp.rotation().matrix(), (turn * GRASP.rotation()).matrix(), atol=1e-9
    )
    assert grasp.opening_m == pytest.approx(0.0, abs=1e-12)


def test_the_bound_of_the_place_grows_with_the_state_and_its_deviation(paper_part):
    part = paper_part("revolute", pivot_sd=0.01)
    near, far = (carried(part, q, 0.0, CONFIG)[0] for q in (0.1, 1.0))
    assert far.opening_m > 3 * near.opening_m > 0
    unsure = carried(paper_part("revolute"), 0.3, 0.05, CONFIG)[0]
    assert unsure.depth_m == pytest.approx(1.96 * 0.05 * 0.4, rel=0.05)  # along the approach


def test_a_hand_that_felt_to_its_palm_is_sent_back_to_the_bar(paper_part):
    deep = GRASP * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 0.04]))  # tips at the front
    part = paper_part("revolute", T_grasp=deep)
    back = not_so_deep(deep, part.surface.p_world, CONFIG)
    # The bar begins at x = 0.495: the tips go 15 mm beyond it.
    assert back.translation()[0] == pytest.approx(0.51, abs=1e-3)
    shallow = GRASP * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 0.005]))
    assert not_so_deep(shallow, part.surface.p_world, CONFIG).equals(shallow, 1e-12)


def test_the_grasp_that_leads_farthest_is_taken(paper_part):
    part = paper_part("revolute")
    ways = list(variants(carried(part, 0.2, 0.0, CONFIG)[0].T_world_grasp, CONFIG))
    best = ways[4]
    arm = Asked(lambda T: 0.9 if T.equals(best, 1e-9) else 0.4)
    chosen = choose_grasp(arm, part, 0.2, 0.0, 0.6, [], [], CONFIG)
    assert chosen.grasp.T_world_grasp.equals(best, 1e-9)
    assert len(arm.asked) == CONFIG.most_grasps
    arm = Asked(lambda T: 1.0)
    choose_grasp(arm, part, 0.2, 0.0, 0.6, [], [], CONFIG)
    assert len(arm.asked) == 1  # enough is enough


def test_what_was_lost_is_not_taken_again(paper_part):
    part = paper_part("revolute")
    first = carried(part, 0.2, 0.0, CONFIG)[0].T_world_grasp
    arm = Asked(lambda T: 1.0)
    chosen = choose_grasp(arm, part, 0.2, 0.0, 0.6, [], [first], CONFIG)
    assert not chosen.grasp.T_world_grasp.equals(first, 1e-6)


def test_no_way_and_no_place_are_said(paper_part):
    part = paper_part("revolute")
    with pytest.raises(MotionInfeasible, match="farther than 10 %"):
        choose_grasp(Asked(lambda T: 0.1), part, 0.2, 0.0, 0.6, [], [], CONFIG)
    with pytest.raises(MotionInfeasible, match="out of the arm's reach"):
        choose_grasp(Asked(lambda T: None), part, 0.2, 0.0, 0.6, [], [], CONFIG)
    vague = paper_part("revolute", axis_sd=0.01, pivot_sd=0.03)
    with pytest.raises(MotionInfeasible, match="more than fingers open"):
        choose_grasp(Asked(lambda T: 1.0), vague, 1.2, 0.0, 0.6, [], [], CONFIG)
    fresh = [carried(part, 1.2, 0.0, CONFIG)[0].T_world_grasp]
    chosen = choose_grasp(Asked(lambda T: 1.0), vague, 1.2, 0.0, 0.6, fresh, [], CONFIG)
    assert chosen.grasp.T_world_grasp.equals(fresh[0], 1e-9)  # seen now: its place is known


def test_the_way_ahead_ends_at_the_target(paper_part):
    part = paper_part("prismatic")
    way = way_of(part, GRASP, 0.05, 0.25, CONFIG)
    assert len(way) == CONFIG.way_poses
    assert_allclose(way[-1].translation(), [0.3, 0.0, 0.4], atol=1e-9)
