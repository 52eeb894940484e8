"""Slip is what the hand moves in the part, whatever the part does."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from sim.bullet import p
from sim.robot.slip import SlipGauge, true_part_pose
from sim.world import SimWorld


@pytest.mark.parametrize(("name", "state"), [("drawer", 0.2), ("door", 0.6)])
def test_a_hand_that_rides_on_the_part_does_not_slip_and_one_that_moves_on_it_does(
    name: str, state: float
):
    with SimWorld(name, 3) as world:
        T_world_grasp = world.placement.given_grasp()
        gauge = SlipGauge(world, T_world_grasp)
        T_part_grasp = true_part_pose(world).between(T_world_grasp)
        p.resetJointState(world.object_id, world.part_joint, state, physicsClientId=world.client)
        riding = true_part_pose(world) * T_part_grasp
        assert np.linalg.norm(riding.translation() - T_world_grasp.translation()) > 0.1
        still = gauge.slip(riding)
        assert (still.translation_m, still.rotation_rad) == pytest.approx((0.0, 0.0), abs=1e-9)
        moved = gtsam.Pose3(gtsam.Rot3.Rx(0.05), np.array([0.0, 0.003, 0.004]))
        slip = gauge.slip(riding * moved)
        assert (slip.translation_m, slip.rotation_rad) == pytest.approx((0.005, 0.05))


def test_the_true_part_pose_is_the_simulators():
    with SimWorld("door", 3) as world:
        closed = true_part_pose(world)
        link = link_pose(world)
        p.resetJointState(world.object_id, world.part_joint, 0.7, physicsClientId=world.client)
        moved = true_part_pose(world) * closed.inverse()
        assert moved.equals(link_pose(world) * link.inverse(), 1e-5)


def link_pose(world: SimWorld) -> gtsam.Pose3:
    state = p.getLinkState(
        world.object_id,
        world.part_joint,
        computeForwardKinematics=True,
        physicsClientId=world.client,
    )
    R = np.reshape(p.getMatrixFromQuaternion(state[5]), (3, 3))
    return gtsam.Pose3(gtsam.Rot3(R), np.array(state[4]))
