"""What the world says of the truth, and what it does to balanced parts, against Bullet itself."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from sim.bullet import p
from sim.objects.slope import slope_load
from sim.objects.suites.catalogue import find_suite
from sim.robot.contacts import nearby
from sim.world import SimWorld


def part_at(world: SimWorld, state: float) -> gtsam.Pose3:
    """T_world_link of the part, put to a state."""
    client, body, joint = world.client, world.object_id, world.part_joint
    p.resetJointState(body, joint, state, 0.0, physicsClientId=client)
    link = p.getLinkState(body, joint, computeForwardKinematics=1, physicsClientId=client)
    x, y, z, w = link[5]
    return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), np.array(link[4]))


@pytest.mark.parametrize("seed", [1, 4])
@pytest.mark.parametrize("name", ["door", "drawer"])
def test_the_true_axis_is_the_one_the_part_moves_by_in_the_world(name: str, seed: int):
    """By half a radian or ten centimetres, wherever the object was put."""
    with SimWorld(name, seed) as world:
        truth, step = world.truth(), 0.1 if name == "drawer" else 0.5
        closed, open_ = part_at(world, 0.0), part_at(world, step)
        if name == "drawer":
            moved = (open_.translation() - closed.translation()) / step
            np.testing.assert_allclose(moved, truth.axis, atol=1e-5)
            assert truth.pivot is None
            return
        motion = open_ * closed.inverse()
        np.testing.assert_allclose(
            gtsam.Rot3.Logmap(motion.rotation()) / step, truth.axis, atol=1e-5
        )
        np.testing.assert_allclose(motion.transformFrom(truth.pivot), truth.pivot, atol=1e-5)


def test_a_balanced_door_stays_where_it_is_left():
    """Its springs carry its weight in every state; its friction alone would not."""
    name = next(s.name for s in find_suite("furniture-dev") if s.balanced)
    for state in (0.3, 0.9):
        with SimWorld(name, 0) as world:
            part_at(world, state)
            for _ in range(400):
                world.step()
            assert world.part_state() == pytest.approx(state, abs=2e-3)


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_a_locked_part_does_not_give_to_eighty_newtons_and_a_free_one_does(name: str):
    """The motor that locks it is the only difference."""
    moved = []
    for locked in (True, False):
        with SimWorld(name, 1, placement="published", locked=locked) as world:
            built, T = world.built, world.placement.T_world_object
            at = T.transformFrom(built.T_object_handle.translation()).tolist()
            pull_n = (-80.0 * T.rotation().matrix()[:, 1]).tolist()
            for _ in range(500):
                where = (world.object_id, world.part_joint, pull_n, at, p.WORLD_FRAME)
                p.applyExternalForce(*where, physicsClientId=world.client)
                world.step()
            moved.append(abs(world.part_state()))
    assert moved[0] < 1e-3 and moved[1] > 0.05


def test_an_arm_in_the_way_of_a_part_that_is_put_elsewhere_is_put_out_of_it():
    """A drawer at the height of the hand, drawn out to where the arm stands at home."""
    with SimWorld("furniture-dev/drawer-015", 1, placement="published") as world:

        def turned() -> float:
            return float(p.getJointState(world.robot_id, 0, physicsClientId=world.client)[0])

        def apart_m() -> float:
            near = nearby(world.client, world.robot_id, world.object_id, 1.0)
            return min(points.distance_m for points in near)

        home = turned()
        world.put_part(0.1)
        assert turned() == home and apart_m() > 0.0  # nothing is in the way yet
        world.put_part(0.3)
        assert turned() != home and apart_m() > 0.0


def test_a_sliding_door_stays_shut_where_its_cabinet_leans():
    """Its weight on the slope, 8 N, is more than the 4.8 N of friction of its rail."""
    with SimWorld("furniture-dev/slide-002", 1, placement="published") as world:
        assert abs(world.truth().axis[2]) > 0.04
        for _ in range(1000):
            world.step()
        assert abs(world.part_state()) < 1e-3


def test_a_lean_loads_what_it_tips_and_nothing_else():
    """Half the weight along a rail at 30 deg; a flap's hinge that leans carries less, not more."""
    across, along, out = np.eye(3)  # x, y, z
    tipped = gtsam.Rot3.Ry(np.deg2rad(30.0)).matrix()
    assert slope_load(10.0, across, tipped @ across, None) == pytest.approx(5.0)
    assert slope_load(10.0, along, tipped @ along, None) == 0.0  # turned about itself
    assert slope_load(10.0, out, tipped @ out, 0.4) == pytest.approx(10.0 * 0.4 * 0.5)
    assert slope_load(10.0, across, tipped @ across, 0.4) == 0.0


def test_an_arm_that_no_posture_takes_far_from_a_part_stands_where_it_is_farthest():
    """A drawer drawn out to the robot's base is near to all of them, and in some of them."""
    with SimWorld("furniture-116/drawer-049", 10006, placement="published") as world:
        world.put_part(0.384)
        near = nearby(world.client, world.robot_id, world.object_id, 1.0)
        assert min(points.distance_m for points in near) > 0.02
        for _ in range(20):
            world.step()
        assert world.part_state() == pytest.approx(0.384, abs=1e-4)
        with pytest.raises(ValueError, match="robot's base"):
            world.put_part(0.6)
        assert world.part_state() == pytest.approx(0.384, abs=1e-4)
