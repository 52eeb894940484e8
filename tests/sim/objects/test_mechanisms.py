"""Catches and closers: their laws, and that the world applies them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.bullet import p
from sim.objects.mechanisms import Catch, Closer, resistance
from sim.world import SimWorld

CATCH = Catch(force=8.0, peak=0.002, travel=0.010)


@pytest.mark.parametrize(
    ("state", "held"), [(-0.001, 0.0), (0.0, 0.0), (0.001, 4.0), (0.002, 8.0), (0.006, 4.0)]
)
def test_a_catch_holds_most_at_its_peak_and_lets_go_at_its_travel(state: float, held: float):
    assert CATCH.holds(state) == pytest.approx(held)
    assert CATCH.stiffness == pytest.approx(4000.0)
    assert CATCH.holds(0.010) == CATCH.holds(1.0) == 0.0


@pytest.mark.parametrize("bad", [(0.0, 0.001, 0.01), (1.0, 0.01, 0.01), (1.0, 0.0, 0.01)])
def test_a_catch_that_makes_no_sense_is_refused(bad: tuple[float, float, float]):
    with pytest.raises(ValueError, match="expected force"):
        Catch(*bad)


def test_a_closer_pulls_harder_the_wider_it_is_open_until_it_lets_go():
    closer = Closer(preload=2.0, stiffness=10.0, until=0.3)
    assert [closer.pulls(q) for q in (-0.01, 0.0, 0.1, 0.3)] == [2.0, 2.0, 3.0, 0.0]
    assert resistance(0.001, CATCH, closer) == pytest.approx(4.0 + 2.01)
    assert resistance(0.001, None, None) == 0.0


def test_a_caught_drawer_needs_its_friction_and_its_catch_to_be_overcome():
    name = "furniture-dev/drawer-004"  # neither catch nor closer of its own: both are set here
    opened = {}
    with SimWorld(name, 0) as world:
        assert world.spec.catch is None and world.spec.closer is None
        plain = world.spec
        for caught in (False, True):
            world.spec = replace(plain, catch=CATCH if caught else None)
            for more_n in (-1.0, 4.0, 12.0):
                _set(world, 0.0)
                _push(world, plain.friction + more_n, 0.5)
                opened[caught, more_n] = world.part_state()
    assert opened[False, -1.0] < 1e-4 < 0.02 < opened[False, 4.0]
    assert opened[True, 4.0] < CATCH.peak < 0.05 < opened[True, 12.0]


def test_a_closer_stronger_than_friction_shuts_the_drawer_and_a_weaker_one_does_not():
    with SimWorld("furniture-dev/drawer-004", 0) as world:
        plain = world.spec
        for share, shut in ((0.5, False), (2.0, True)):
            closer = Closer(share * plain.friction, 0.0, np.inf)
            world.spec = replace(plain, closer=closer)
            _set(world, 0.05)
            for _ in range(1000):
                world.step()
            assert (world.part_state() < 0.001) is shut


def _set(world: SimWorld, state: float) -> None:
    p.resetJointState(world.object_id, world.part_joint, state, physicsClientId=world.client)


def _push(world: SimWorld, force_n: float, seconds: float) -> None:
    way = world.placement.T_world_object.rotation().matrix() @ world.built.axis_object
    for _ in range(round(seconds / world.config.step_s)):
        at = p.getLinkState(world.object_id, world.part_joint, physicsClientId=world.client)[0]
        p.applyExternalForce(
            world.object_id,
            world.part_joint,
            (force_n * way).tolist(),
            at,
            p.WORLD_FRAME,
            physicsClientId=world.client,
        )
        world.step()
