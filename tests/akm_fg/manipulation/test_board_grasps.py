"""A front that stands open is pinched at its free edge, where the hand has room behind it."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.errors import MotionInfeasible
from akm_fg.manipulation.board_grasps import BoardConfig, board_grasps
from akm_fg.manipulation.carried_grasps import choose_grasp, room_for
from akm_fg.manipulation.config import HoldConfig
from akm_fg.posterior import JointPosterior
from factors.joint import Joint, JointKind
from tests.akm_fg.manipulation.conftest import paper_posterior

# The front of the paper parts: x = 0.54, y from -0.3 to 0.3, z from 0.2 to 0.6, seen along +x.
CONFIG, BOARD = HoldConfig(), BoardConfig()


class FromAbove:
    """An arm that reaches nothing but by going down."""

    def reachable(self, T_world_grasp, onward=()):
        if T_world_grasp.rotation().matrix()[2, 2] > -0.9:
            raise MotionInfeasible("the grasp is out of the arm's reach")
        return 1.0


def test_a_drawers_front_is_pinched_at_its_upper_edge_from_above(paper_part):
    first = board_grasps(paper_part("prismatic"))[0]
    T = first.T_part_grasp
    assert_allclose(T.rotation().matrix()[:, 2], [0.0, 0.0, -1.0], atol=1e-9)
    assert_allclose(T.rotation().matrix()[:, 1], [-1.0, 0.0, 0.0], atol=1e-9)
    # Half a board behind the front, and as deep as the pads go; rims are seen to a percentile.
    x, y, z = T.translation()
    assert x == pytest.approx(0.54 + BOARD.edge.board_m / 2, abs=1e-6) and y == pytest.approx(0.0)
    assert z == pytest.approx(0.6 - BOARD.edge.deep_m, abs=0.02)


def test_a_doors_front_is_pinched_at_the_edge_off_its_hinge_first(paper_part):
    grasps = board_grasps(paper_part("revolute"))  # hinge at y = 0.4
    approach = [grasp.T_part_grasp.rotation().matrix()[:, 2] for grasp in grasps]
    assert_allclose(approach[0], [0.0, 1.0, 0.0], atol=1e-9)
    assert grasps[0].p_part_edge[1] == pytest.approx(-0.3, abs=0.02)
    assert any(np.allclose(way, [0.0, 0.0, -1.0]) for way in approach)  # and from above


def test_a_part_that_slides_along_its_front_has_no_free_edge(paper_part):
    along = gtsam.Pose3(gtsam.Rot3.Rx(-np.pi / 2), np.zeros(3))  # z of the joint is y of the world
    joint = JointPosterior(Joint(JointKind.PRISMATIC, along.matrix(), 0.0), np.zeros((6, 6)))
    part = replace(paper_part("prismatic"), posterior=paper_posterior(joint))
    assert board_grasps(part) == []


def test_the_edge_is_held_where_the_handle_is_out_of_reach_and_the_part_stands_open(paper_part):
    part = paper_part("prismatic")
    chosen = choose_grasp(FromAbove(), part, 0.3, 0.0, 0.4, [], [], CONFIG)
    assert chosen.grasp.board is not None and chosen.reach == 1.0
    assert chosen.grasp.T_world_grasp.translation()[0] == pytest.approx(0.549 - 0.3, abs=1e-6)
    with pytest.raises(MotionInfeasible, match="out of the arm's reach"):
        choose_grasp(FromAbove(), part, 0.1, 0.0, 0.4, [], [], CONFIG)  # no room behind it yet


def test_the_way_ends_where_the_hand_would_meet_what_the_part_closes_against(paper_part):
    part = paper_part("prismatic")
    board = board_grasps(part)[0]
    share = room_for(part, board, 0.3, 0.0, CONFIG)
    assert share == pytest.approx((0.3 - BOARD.room_m) / 0.3, abs=1.0 / CONFIG.way_poses)
    assert room_for(part, None, 0.3, 0.0, CONFIG) == 1.0
    chosen = choose_grasp(FromAbove(), part, 0.3, 0.0, 0.0, [], [], CONFIG)
    assert chosen.reach == pytest.approx(share)
