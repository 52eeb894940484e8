"""Contact points, by hand: two balls that overlap, and the robot that is where it is."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from sim.bullet import p
from sim.robot.contacts import contacts, finger_links, link_name, nearby
from sim.world import SimWorld

RADIUS_M = 0.05


@pytest.fixture(scope="module")
def world() -> Iterator[SimWorld]:
    with SimWorld("drawer", 0) as opened:
        yield opened


def ball(client: int, x_m: float, mass_kg: float = 0.0) -> int:
    shape = p.createCollisionShape(p.GEOM_SPHERE, radius=RADIUS_M, physicsClientId=client)
    at = [x_m, 5.0, 5.0]
    return p.createMultiBody(mass_kg, shape, -1, at, physicsClientId=client)


def test_two_balls_are_as_far_apart_as_their_middles_say(world: SimWorld):
    one, other = ball(world.client, 0.0), ball(world.client, 0.12)
    assert nearby(world.client, one, other, 0.01) == []
    (near,) = nearby(world.client, one, other, 0.03)
    assert near.distance_m == pytest.approx(0.02, abs=1e-6)
    assert (near.link, near.other_body, near.other_link) == (-1, other, -1)
    assert nearby(world.client, one, other, 0.03, other_link=0) == []


def test_a_ball_on_a_ball_presses_with_its_weight(world: SimWorld):
    below = ball(world.client, 1.0)
    above = ball(world.client, 1.0, mass_kg=2.0)
    where = [1.0, 5.0, 5.0 + 2.0 * RADIUS_M]
    p.resetBasePositionAndOrientation(above, where, [0, 0, 0, 1], physicsClientId=world.client)
    for _ in range(50):
        world.step()
    (contact,) = contacts(world.client, above)
    assert contact.other_body == below and abs(contact.distance_m) < 1e-3
    assert contact.force_n == pytest.approx(2.0 * 9.81, rel=0.02)
    assert contacts(world.client, above, below) == [contact]
    assert contacts(world.client, above, world.object_id) == []


def test_the_fingers_are_found_by_name(world: SimWorld):
    names = [
        link_name(world.client, world.robot_id, link)
        for link in finger_links(world.client, world.robot_id)
    ]
    assert names == ["panda_leftfinger", "panda_rightfinger"]


def test_the_pads_slide_on_the_handle_as_the_spec_says(world: SimWorld):
    """Bullet's coefficient of a contact is the product of both bodies', entry 1 of the dynamics."""
    (pad, _), client = finger_links(world.client, world.robot_id), world.client
    on_pad = p.getDynamicsInfo(world.robot_id, pad, physicsClientId=client)[1]
    on_part = p.getDynamicsInfo(world.object_id, world.part_joint, physicsClientId=client)[1]
    assert on_pad * on_part == pytest.approx(world.spec.handle_mu)  # against rubber with mu 1
    assert 0.5 <= on_pad * on_part <= 1.1
