"""What happens behind the robot's back: where the part is afterwards, and what the arm feels."""

from __future__ import annotations

import pytest

from sim.bullet import p
from sim.mishaps import make_slippery, push_part, stop_part, teleport_part
from sim.robot.contacts import finger_links, nearby
from sim.robot.standing_aside import arm_angles
from sim.world import SimWorld


@pytest.fixture
def world():
    """A drawer at the height of the hand, which meets the arm at home where it is drawn out far."""
    with SimWorld("furniture-dev/drawer-015", 1, placement="published") as world:
        yield world


def test_a_part_is_pushed_as_far_as_the_arm_lets_it_and_teleported_where_there_is_room(world):
    arm = arm_angles(world.client, world.robot_id)
    push_part(world, 0.1)
    assert world.part_state() == pytest.approx(0.1)
    push_part(world, 0.3)
    assert 0.1 < world.part_state() < 0.29
    near = nearby(world.client, world.robot_id, world.object_id, 1.0)
    assert min(points.distance_m for points in near) > 0.0
    teleport_part(world, 0.05)
    assert world.part_state() == pytest.approx(0.05)
    teleport_part(world, 0.3)
    assert world.part_state() == pytest.approx(0.05)
    assert arm_angles(world.client, world.robot_id).tolist() == arm.tolist()


def test_a_part_meets_a_stop_that_it_did_not_have(world):
    stop_part(world, 0.0, 0.1)
    seen = []
    world.every_step.append(lambda: seen.append(world.part_state()))
    out = (80.0 * -world.placement.T_world_object.rotation().matrix()[:, 1]).tolist()
    for _ in range(500):
        at = p.getLinkState(world.object_id, world.part_joint, physicsClientId=world.client)[0]
        where = (world.object_id, world.part_joint, out, at, p.WORLD_FRAME)
        p.applyExternalForce(*where, physicsClientId=world.client)
        world.step()
    assert len(seen) == 500
    assert world.part_state() == pytest.approx(0.1, abs=3e-3)


def test_pads_become_slippery_and_grip_again(world):
    finger = finger_links(world.client, world.robot_id)[0]

    def mu() -> float:
        return p.getDynamicsInfo(world.robot_id, finger, physicsClientId=world.client)[1]

    make_slippery(world, 0.05)
    assert mu() == pytest.approx(0.05)
    make_slippery(world)
    assert mu() == pytest.approx(world.config.finger_mu)
