from __future__ import annotations

import itertools

import coal
import gtsam
import numpy as np
import pytest

from akm_fg.arm.body.collision import ArmCollisions, Obstacle, resampled
from akm_fg.arm.body.kinematics import (
    DDDQ_MAX,
    DDQ_MAX,
    DQ_MAX,
    Q_HOME,
    Q_MAX,
    Q_MIN,
    FrankaKinematics,
    limit_margin_rad,
)
from akm_fg.arm.motion.free_motion import (
    FreeMotionPlanner,
    PlanConfig,
    RrtConnectPlanner,
    timed_motion,
    way_out,
)
from akm_fg.arm.motion.joint_path import TimeLawConfig, joint_motion
from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray

LEFT = Q_HOME + np.array([-0.7, 0.4, 0.0, 0.3, 0.0, 0.0, 0.0])
RIGHT = Q_HOME + np.array([0.7, 0.4, 0.0, 0.3, 0.0, 0.0, 0.0])


def box(name: str, size_m: list[float], middle_m: list[float]) -> Obstacle:
    return Obstacle(name, coal.Box(*size_m), gtsam.Pose3(gtsam.Rot3(), np.array(middle_m)))


# Where the hand would pass on the straight way.
POST = box("the post", [0.06, 0.06, 1.0], [0.41, 0.0, 0.3])


def among_posts() -> ArmCollisions:
    return ArmCollisions([POST], 0.02)


def way(seed: int = 1) -> FloatArray:
    planner: FreeMotionPlanner = RrtConnectPlanner(among_posts(), PlanConfig(seed=seed))
    return planner.plan(LEFT, RIGHT)


def test_a_way_around_a_post_is_free_at_half_the_checked_step():
    collisions, waypoints = among_posts(), way()
    assert not collisions.free_along(np.stack([LEFT, RIGHT]), 0.01)
    assert len(waypoints) > 2
    np.testing.assert_array_equal(waypoints[[0, -1]], [LEFT, RIGHT])
    assert collisions.free_along(waypoints, 0.005)
    assert min(limit_margin_rad(q) for q in resampled(waypoints, 0.01)) >= 0.0
    length = np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum()
    assert length < 4.0 * np.linalg.norm(RIGHT - LEFT)  # simplified: no wandering about


def test_the_same_seed_gives_the_same_way_whatever_was_planned_before():
    first = way()
    assert not np.array_equal(way(seed=7), first)
    np.testing.assert_array_equal(way(), first)


def test_where_nothing_is_in_the_way_it_goes_straight():
    planner = RrtConnectPlanner(ArmCollisions([], 0.02))
    np.testing.assert_array_equal(planner.plan(LEFT, RIGHT), [LEFT, RIGHT])


def fingertip(q: FloatArray) -> FloatArray:
    return FrankaKinematics().T_world_gripper(q).translation()


def test_an_arm_that_was_pushed_beyond_its_limits_goes_back_inside_first():
    pushed = LEFT.copy()
    pushed[1] = Q_MIN[1] - 0.07
    waypoints = RrtConnectPlanner(among_posts()).plan(pushed, RIGHT)
    np.testing.assert_array_equal(waypoints[[0, -1]], [pushed, RIGHT])
    np.testing.assert_array_equal(waypoints[1], np.clip(pushed, Q_MIN, Q_MAX))
    assert min(limit_margin_rad(q) for q in waypoints[1:]) >= 0.0
    assert len(joint_motion(waypoints, 0.01).q) > 2


def test_a_goal_or_start_in_an_obstacle_is_named():
    block = box("the block", [0.1, 0.1, 0.1], fingertip(RIGHT).tolist())
    planner = RrtConnectPlanner(ArmCollisions([block], 0.02))
    with pytest.raises(MotionInfeasible, match=r"at the goal .* and the block would touch"):
        planner.plan(LEFT, RIGHT)
    with pytest.raises(MotionInfeasible, match=r"where the arm stands, .* and the block touch"):
        planner.plan(RIGHT, LEFT)
    outside = RIGHT.copy()
    outside[3] = 0.5
    with pytest.raises(MotionInfeasible, match="outside the limits"):
        planner.plan(outside, LEFT)


def test_an_arm_that_stands_close_to_something_may_leave_with_a_smaller_margin():
    tip = fingertip(LEFT)
    floor = box("the shelf", [0.4, 0.4, 0.1], [tip[0], tip[1], tip[2] - 0.05 - 0.025])
    collisions = ArmCollisions([floor], 0.02)
    assert not collisions.free(LEFT)
    up = LEFT + np.array([0.0, -0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    waypoints = RrtConnectPlanner(collisions).plan(LEFT, up)
    assert collisions.margin_m in PlanConfig().margins_m[1:]
    assert collisions.free_along(waypoints, 0.005)


def test_no_way_out_is_said_after_the_stated_number_of_checks():
    wall = box("a wall", [3.0, 0.02, 3.0], [1.7, 0.0, 0.0])
    behind = box("a wall", [3.0, 0.02, 3.0], [-1.7, 0.0, 0.0])
    collisions = ArmCollisions([wall, behind], 0.0)
    planner = RrtConnectPlanner(collisions, PlanConfig(checks_max=300, searches=2))
    with pytest.raises(MotionInfeasible, match="with 600 collision checks"):
        planner.plan(LEFT, RIGHT)


def test_the_timed_motion_is_free_at_its_rounded_corners_and_inside_the_limits():
    collisions, law = among_posts(), TimeLawConfig()
    waypoints = way()
    motion = timed_motion(waypoints, collisions, 1e-3, law, 0.01)
    assert all(collisions.free(q) for q in motion.q[::25])
    np.testing.assert_allclose(motion.q[-1], RIGHT, atol=1e-9)
    dddq = np.diff(motion.ddq, axis=0) / 1e-3
    for rate, limit in ((motion.dq, DQ_MAX), (motion.ddq, DDQ_MAX), (dddq, DDDQ_MAX)):
        assert (np.abs(rate) <= limit).all()


def test_a_corner_that_may_not_be_rounded_is_not():
    """An obstacle just inside the corner: only stopping there keeps the arm clear."""
    corner = Q_HOME + np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    waypoints = np.stack([Q_HOME, corner, corner + np.array([0.0, 0.6, 0, 0, 0, 0, 0])])
    wide = TimeLawConfig(corner_rad=0.5)
    free = timed_motion(waypoints, ArmCollisions([], 0.0), 1e-3, wide, 0.01)
    cut = FrankaKinematics().T_world_gripper(free.q[np.abs(free.q - corner).max(axis=1).argmin()])
    for x, y, z in itertools.product((-0.02, 0.0, 0.02), (-0.09, -0.05, 0.05), (0.0, -0.06, -0.1)):
        centre = gtsam.Pose3(gtsam.Rot3(), cut.transformFrom(np.array([x, y, z])))
        collisions = ArmCollisions([Obstacle("a ball", coal.Sphere(0.004), centre)], 0.0)
        if collisions.free_along(waypoints, 0.005) and not collisions.free_along(free.q, 0.005):
            break
    assert collisions.free_along(waypoints, 0.005)
    assert not collisions.free_along(free.q, 0.005)
    kept = timed_motion(waypoints, collisions, 1e-3, wide, 0.01)
    assert collisions.free_along(kept.q, 0.005)
    assert len(kept.q) > len(free.q)
    blocked = ArmCollisions([box("a block", [0.2, 0.2, 0.1], fingertip(corner).tolist())], 0.0)
    with pytest.raises(MotionInfeasible, match="not free"):
        timed_motion(waypoints, blocked, 1e-3, wide, 0.01)


def test_an_arm_that_is_folded_into_itself_finds_out_of_it_by_the_shortest_way():
    """Hulls of an elbow that is bent too far: no way is planned from there."""
    folded = np.array([2.561, -1.368, 1.560, -3.011, -1.528, 3.264, -0.869])
    collisions = ArmCollisions([], 0.02)
    touches = collisions.touched(folded)
    assert touches is not None
    with pytest.raises(MotionInfeasible, match="where the arm stands"):
        RrtConnectPlanner(collisions).plan(folded, Q_HOME)
    out = way_out(collisions, folded)
    assert collisions.free(out) and np.abs(out - folded).max() < 0.6
    for share in np.linspace(0.0, 1.0, 20):  # nothing else is touched on the way
        assert collisions.touched(folded + share * (out - folded)) in (touches, None)
    assert way_out(collisions, Q_HOME) is None


def test_an_arm_inside_something_large_is_not_led_through_it():
    tip = fingertip(LEFT)
    around = box("the block", [1.6, 1.6, 1.6], tip.tolist())
    with pytest.raises(MotionInfeasible, match=r"where the arm stands, .* and the block touch"):
        way_out(ArmCollisions([around], 0.0), LEFT)
