from __future__ import annotations

import functools

import coal
import gtsam
import numpy as np
import pinocchio as pin
import pytest

from akm_fg.arm.body.collision import (
    REACH_OF_JOINT_M,
    SELF_PAIRS,
    ArmCollisions,
    Obstacle,
    hull_parts,
    inside_arm,
    resampled,
)
from akm_fg.arm.body.description import franka_description
from akm_fg.arm.body.kinematics import Q_HOME, Q_MAX, Q_MIN, FrankaKinematics
from akm_fg.arm.body.model import ROBOT_LINKS
from sim.bullet import p
from sim.robot.contacts import nearby
from sim.robot.true_obstacles import true_obstacles
from sim.world import SimWorld


def table(top_m: float, *spared: str) -> Obstacle:
    pose = gtsam.Pose3(gtsam.Rot3(), np.array([0.5, 0.0, top_m - 0.1]))
    return Obstacle("the table", coal.Box(0.6, 0.6, 0.2), pose, spared)


def free_height(margin_m: float) -> float:
    """The highest table under the hand at home that the arm is clear of, by bisection."""
    low, high = 0.0, 0.6
    for _ in range(14):
        middle = (low + high) / 2.0
        if ArmCollisions([table(middle)], margin_m).free(Q_HOME):
            low = middle
        else:
            high = middle
    return low


def test_the_margin_is_kept_from_obstacles():
    bare = free_height(0.0)
    fingertip = FrankaKinematics().T_world_gripper(Q_HOME).translation()[2]
    assert fingertip - 0.02 < bare < fingertip + 0.001
    assert bare - free_height(0.02) == pytest.approx(0.02, abs=3e-4)


def test_what_touches_is_named_and_spared_links_may_touch():
    through_the_fingers = free_height(0.0) + 0.01
    assert ArmCollisions([table(0.2)], 0.02).touched(Q_HOME) is None
    touched = ArmCollisions([table(through_the_fingers)], 0.0).touched(Q_HOME)
    assert touched is not None and touched.endswith("finger and the table")
    fingers = ("panda_leftfinger", "panda_rightfinger")
    assert ArmCollisions([table(through_the_fingers, *fingers)], 0.0).free(Q_HOME)


def test_the_arm_may_not_fold_into_itself():
    alone = ArmCollisions([], 0.02)
    folded = Q_HOME.copy()
    folded[5] = 0.0  # the flange against the forearm
    assert alone.touched(Q_HOME) is None
    assert alone.touched(folded) == "panda_link5 and panda_link7"


def test_no_other_parts_than_the_listed_pairs_and_neighbours_can_meet():
    model, hulls = hull_parts(franka_description())
    others = hulls.copy()
    others.removeAllCollisionPairs()
    n = len(ROBOT_LINKS)
    neighbours = {*((i, i + 1) for i in range(n - 1)), (8, 10)}
    for first in range(n):
        for second in range(first + 1, n):
            if (first, second) not in neighbours and (first, second) not in SELF_PAIRS:
                others.addCollisionPair(pin.CollisionPair(first, second))
    assert len(others.collisionPairs) == 55 - 11 - len(SELF_PAIRS)
    data, contacts, rng = model.createData(), others.createData(), np.random.default_rng(0)
    fingers = np.array([0.04, 0.04])
    for q in rng.uniform(Q_MIN, Q_MAX, (2000, 7)):
        q_all = np.concatenate([q, fingers])
        assert not pin.computeCollisions(model, data, others, contacts, q_all, True)


@functools.cache
def corners() -> list[np.ndarray]:
    return [
        np.array([shape.geometry.point(i) for i in range(shape.geometry.num_points)])
        for shape in hull_parts(franka_description())[1].geometryObjects
    ]


def corners_world(q: np.ndarray) -> np.ndarray:
    model, hulls = hull_parts(franka_description())
    data, places = model.createData(), hulls.createData()
    q_all = np.concatenate([q, [0.04, 0.04]])
    pin.updateGeometryPlacements(model, data, hulls, places, q_all)
    return np.concatenate(
        [c @ T.rotation.T + T.translation for c, T in zip(corners(), places.oMg, strict=True)]
    )


def test_no_point_of_the_arm_moves_farther_than_the_joints_reach_allows():
    rng, most = np.random.default_rng(1), 0.0
    for _ in range(150):
        q, step = rng.uniform(Q_MIN, Q_MAX), rng.normal(0.0, 1e-3, 7)
        moved = np.linalg.norm(corners_world(q + step) - corners_world(q), axis=1).max()
        most = max(most, moved / (np.abs(step) @ REACH_OF_JOINT_M))
    for joint in (1, 3, 5):  # one joint alone comes near to its bound
        step = np.eye(7)[joint] * 1e-3
        moved = max(
            np.linalg.norm(corners_world(q + step) - corners_world(q), axis=1).max()
            for q in rng.uniform(Q_MIN, Q_MAX, (150, 7))
        )
        assert 0.7 < moved / (1e-3 * REACH_OF_JOINT_M[joint]) < 1.0
    assert most < 1.0


def test_a_path_is_resampled_to_the_asked_step():
    corner = np.stack([Q_HOME, Q_HOME + 0.4, Q_HOME + 0.4 * np.array([1, 1, 1, 0, 1, 1, 1])])
    path = resampled(corner, 0.01)
    np.testing.assert_allclose(path[[0, -1]], corner[[0, -1]])
    steps = np.abs(np.diff(path, axis=0)) @ REACH_OF_JOINT_M
    assert steps.max() < 0.0101 and steps[2:-2].min() > 0.005
    standing = resampled(np.stack([Q_HOME, Q_HOME]), 0.01)
    np.testing.assert_array_equal(standing[0], Q_HOME)


def test_points_in_the_arm_are_known():
    T = FrankaKinematics().T_world_gripper(Q_HOME)
    hand = np.array([0.0, 0.0, -0.06])
    aside = hand + np.array([0.06, 0.0, 0.0])  # 3 cm outside: the hand is 6 cm thick
    below = np.array([0.0, 0.0, 0.10])
    points = np.array([T.transformFrom(x) for x in (hand, aside, below)])
    np.testing.assert_array_equal(inside_arm(points, Q_HOME, 0.0), [True, False, False])
    np.testing.assert_array_equal(inside_arm(points, Q_HOME, 0.05), [True, True, False])
    assert not inside_arm(np.zeros((1, 3)), Q_HOME, 0.0).any()  # the base


def test_the_true_obstacles_touch_where_the_simulator_touches():
    """Boxes and cylinders, at rest and moved; what PyBullet finds within 2 mm may go either way."""
    rng = np.random.default_rng(4)
    with SimWorld("furniture-dev/drawer-005", 0) as world:
        client, robot = world.client, world.robot_id
        p.resetJointState(world.object_id, world.part_joint, 0.2, physicsClientId=client)
        arm, alone = ArmCollisions([*true_obstacles(world)], 0.0), ArmCollisions([], 0.0)
        bodies = [p.getBodyUniqueId(i, client) for i in range(p.getNumBodies(client))]
        counted = [0, 0]
        for q in rng.uniform(Q_MIN, Q_MAX, (150, 7)):
            if not alone.free(q):
                continue
            for joint, angle in enumerate(q):
                p.resetJointState(robot, joint, angle, physicsClientId=client)
            found = [
                c.distance_m
                for body in bodies
                if body != robot
                for c in nearby(client, robot, body, 0.005)
                if c.link >= 0
            ]
            nearest = min(found, default=1.0)
            if abs(nearest) > 0.002:
                assert arm.free(q) == (nearest > 0.0)
                counted[int(nearest > 0.0)] += 1
        assert min(counted) > 15
