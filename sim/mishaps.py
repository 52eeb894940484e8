"""What may happen to a part, and to the hand, behind a robot's back: for trials."""

from __future__ import annotations

import numpy as np

from sim.bullet import p
from sim.robot.contacts import finger_links
from sim.robot.standing_aside import clearance_m
from sim.world import SimWorld

PUSHES = 40  # steps in which a part is pushed, for each of which there must be room


def push_part(world: SimWorld, state: float, part: int = 0) -> None:
    """A part is moved towards another state, at rest there, as far as the robot lets it."""
    bare_m = clearance_m(world.client, world.robot_id, world.object_id)
    for there in np.linspace(world.part_state(part), state, PUSHES + 1)[1:]:
        last = world.part_state(part)
        world.set_part(float(there), part)
        if clearance_m(world.client, world.robot_id, world.object_id) < bare_m:
            world.set_part(last, part)
            return


def teleport_part(world: SimWorld, state: float, part: int = 0) -> None:
    """A part is at another state at once, at rest, unless the robot is in its place there."""
    before = world.part_state(part)
    world.set_part(state, part)
    if clearance_m(world.client, world.robot_id, world.object_id) <= 0.0:
        world.set_part(before, part)


def stop_part(world: SimWorld, lower: float, upper: float, part: int = 0) -> None:
    """A part meets stops at these states, whatever its range was."""
    p.changeDynamics(
        world.object_id,
        world.part_joints[part],
        jointLowerLimit=lower,
        jointUpperLimit=upper,
        physicsClientId=world.client,
    )


def make_slippery(world: SimWorld, mu: float | None = None) -> None:
    """The fingers' pads rub with this coefficient; None: with their own."""
    for finger in finger_links(world.client, world.robot_id):
        p.changeDynamics(
            world.robot_id,
            finger,
            lateralFriction=world.config.finger_mu if mu is None else mu,
            physicsClientId=world.client,
        )
