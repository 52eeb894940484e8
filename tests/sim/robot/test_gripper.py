"""The hand squeezes with the force it is given, however slowly it closes."""

import numpy as np
import pytest

from sim.bullet import p
from sim.robot.contacts import contacts
from sim.robot.gripper import GripperConfig, SimGripper
from sim.world import SimWorld

Q = [0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.785]
GRASP_POINT = 11  # link


@pytest.fixture
def world():
    with SimWorld("furniture-dev/drawer-001", 1) as world:
        for joint, q in enumerate(Q):
            p.resetJointState(world.robot_id, joint, q, physicsClientId=world.client)
            p.setJointMotorControl2(
                world.robot_id,
                joint,
                p.POSITION_CONTROL,
                q,
                force=300,
                physicsClientId=world.client,
            )
        yield world


def bar(world: SimWorld, half_m: float) -> int:
    """Across the fingers, where they meet; nothing moves it."""
    state = p.getLinkState(
        world.robot_id, GRASP_POINT, computeForwardKinematics=True, physicsClientId=world.client
    )
    box = p.createCollisionShape(
        p.GEOM_BOX, halfExtents=[0.05, half_m, 0.007], physicsClientId=world.client
    )
    return p.createMultiBody(0.0, box, -1, state[4], state[5], physicsClientId=world.client)


def stepped(world: SimWorld, gripper: SimGripper, steps: int) -> np.ndarray:
    """(steps, 2) speeds of the fingers."""
    speeds = []
    for _ in range(steps):
        p.stepSimulation(physicsClientId=world.client)
        states = p.getJointStates(world.robot_id, gripper.joints, physicsClientId=world.client)
        travel, speed = ([state[i] for state in states] for i in (0, 1))
        gripper.advance(tuple(travel), tuple(speed), world.config.step_s)
        speeds.append(speed)
    return np.array(speeds)


def held(world: SimWorld, close_m_s: float) -> tuple[SimGripper, int]:
    thing = bar(world, 0.0095)
    gripper = SimGripper(world, GripperConfig(close_m_s=close_m_s))
    for joint in gripper.joints:
        p.resetJointState(world.robot_id, joint, 0.02, physicsClientId=world.client)
    gripper.close()
    stepped(world, gripper, 2600)
    return gripper, thing


@pytest.mark.parametrize("close_m_s", [0.015, 0.007])
def test_both_fingers_press_with_the_full_force(world, close_m_s):
    gripper, thing = held(world, close_m_s)
    assert gripper.at_full_force and gripper.closed_on_something()
    for finger in gripper.joints:
        met = [
            each for each in contacts(world.client, world.robot_id, thing) if each.link == finger
        ]
        force_n = sum(each.force_n for each in met)
        assert force_n == pytest.approx(gripper.config.force_n, rel=0.03)


def test_fingers_that_lose_what_they_squeezed_are_braked_at_once_and_seek(world):
    gripper, thing = held(world, 0.007)
    p.removeBody(thing, physicsClientId=world.client)
    speeds = np.abs(stepped(world, gripper, 400)).max(axis=1)
    assert (speeds > gripper.config.slips_m_s).sum() <= 2
    assert speeds[10:] == pytest.approx(gripper.config.close_m_s, rel=0.1)
    assert not gripper.at_full_force
