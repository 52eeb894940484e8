"""What the simulator knows of handles and parts. FOR SCORING ALONE: no part of the program."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.records import BoolArray, FloatArray
from sim.bullet import p
from sim.camera.camera import SimCamera
from sim.robot.contacts import nearby
from sim.world import SimWorld

SPECK_M = 1e-3  # radius of the ball that stands for a point


@dataclass(frozen=True, slots=True)
class TrueHandle:
    """A handle, or what looks like one."""

    free: bool  # it is on a part that moves (unless that is locked, too)
    p_world: FloatArray  # (3,) while everything is closed


def true_handles(world: SimWorld) -> tuple[TrueHandle, ...]:
    """Every place that looks as if one could pull there; those of free parts come first.

    An explorer that knows all n of them, but not which is free, needs (n + 1) / 2 tries.
    """
    p_object = world.built.p_object_handles
    if len(p_object) == 0:  # an object with nothing but its free part
        p_object = world.built.T_object_handle.translation()[None]
    T = world.placement.T_world_object
    return tuple(
        TrueHandle(free=i < world.parts, p_world=T.transformFrom(at))
        for i, at in enumerate(p_object)
        if np.isfinite(at).all()
    )


def distance_to_part_m(world: SimWorld, p_world: FloatArray, part: int = 0) -> float:
    """From a point (3,) to a free part where it is now; 0 inside it."""
    where = {"physicsClientId": world.client}
    speck = p.createCollisionShape(p.GEOM_SPHERE, radius=SPECK_M, **where)
    body = p.createMultiBody(0.0, speck, basePosition=np.asarray(p_world).tolist(), **where)
    try:
        found = nearby(world.client, world.object_id, body, np.inf, link=world.part_joints[part])
    finally:
        p.removeBody(body, **where)
    return max(min(contact.distance_m for contact in found) + SPECK_M, 0.0)


def part_pixels(world: SimWorld, camera: SimCamera, part: int = 0) -> BoolArray:
    """(H, W) which pixels show a free part where it is now."""
    return camera.shown(world.object_id, world.part_joints[part])
