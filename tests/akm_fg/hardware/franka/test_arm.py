"""The arm against a robot that is simulated behind libfranka's own protocol."""

from __future__ import annotations

import time

import gtsam
import numpy as np
import pytest

from akm_fg.arm.body.kinematics import DQ_MAX
from akm_fg.errors import ArmStopped, GraspFailed, MotionInfeasible
from akm_fg.hardware.franka.arm import FrankaArm
from akm_fg.hardware.franka.planning import ArmPlanner
from akm_fg.records import HandPath, WayLimits

pytestmark = [pytest.mark.slow, pytest.mark.hardware]  # seconds of robot time each, in real time

TICK_S = 0.1
TOWARDS_ROBOT = np.array([-1.0, 0.0, 0.0])


def opened_arm(counterpart):
    return FrankaArm(counterpart.host, ArmPlanner(floor_m=0.0))


def run(motion):
    for _ in motion:
        pass


def at_rest(counterpart):
    """Whether it comes to rest: the simulated robot's own controller settles for a second."""
    for _ in range(20):
        before = np.array(counterpart.ask("angles"))
        time.sleep(0.5)
        if np.abs(np.array(counterpart.ask("angles")) - before).max() < 1e-3:
            return True
    return False


def straight_path(T_start, way_m, seconds):
    x = np.linspace(0.0, 1.0, 10)
    poses = tuple(
        gtsam.Pose3(T_start.rotation(), T_start.translation() + s * way_m * TOWARDS_ROBOT)
        for s in x
    )
    return HandPath(x, poses, WayLimits(2.0 / seconds, 6.0 / seconds**2, 60.0 / seconds**3))


def test_a_drawer_is_grasped_pulled_and_moved_along_a_path(counterpart, T_world_handle):
    with opened_arm(counterpart) as arm:
        fastest = np.zeros(7)
        for _ in arm.grasp(T_world_handle, TICK_S):
            fastest = np.maximum(fastest, np.abs(arm.measured_joints()[1]))
        assert arm.holding()
        assert np.all(fastest < DQ_MAX)
        assert counterpart.ask("drawer") < 0.005
        ticks = sum(1 for _ in arm.pull(TOWARDS_ROBOT, 0.08, TICK_S))
        assert ticks > 15  # of a tenth of a second: 8 cm at no more than 5 cm/s
        pulled_m = counterpart.ask("drawer")
        assert 0.07 < pulled_m < 0.09
        here = arm.T_world_gripper()
        run(arm.follow(straight_path(here, 0.06, 2.5), TICK_S))
        assert arm.holding()
        moved_m = counterpart.ask("drawer") - pulled_m
        assert moved_m == pytest.approx(0.06, abs=0.006)
        assert at_rest(counterpart)


def test_what_does_not_give_is_left_alone(counterpart, T_world_handle):
    counterpart.ask("jam")
    with opened_arm(counterpart) as arm:
        run(arm.grasp(T_world_handle, TICK_S))
        run(arm.pull(TOWARDS_ROBOT, 0.08, TICK_S))
        off = arm.T_world_gripper().translation() - T_world_handle.translation()
        assert counterpart.ask("drawer") < 0.001
        assert np.linalg.norm(off) < 0.02


def test_fingers_that_meet_hold_nothing(counterpart, T_world_handle):
    above = T_world_handle * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.08, -0.06]))
    with opened_arm(counterpart) as arm:
        with pytest.raises(GraspFailed, match="nothing between them"):
            run(arm.grasp(above, TICK_S))
        assert not arm.holding()
        assert at_rest(counterpart)


def test_something_in_the_way_ends_the_approach(counterpart, T_world_handle):
    counterpart.ask("jam")
    behind_front = T_world_handle * gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.05, 0.08]))
    with opened_arm(counterpart) as arm:
        with pytest.raises(GraspFailed, match="blocked"):
            run(arm.grasp(behind_front, TICK_S))
        assert at_rest(counterpart)


def test_a_grasp_out_of_reach_moves_nothing(counterpart):
    far = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.0, np.pi / 2, 0.0), np.array([1.5, 0.0, 0.5]))
    before = np.array(counterpart.ask("angles"))
    with opened_arm(counterpart) as arm:
        with pytest.raises(MotionInfeasible, match="out of the arm's reach"):
            run(arm.grasp(far, TICK_S))
    assert np.abs(np.array(counterpart.ask("angles")) - before).max() < 1e-3


def test_a_leg_is_a_straight_line_in_joint_space(counterpart):
    with opened_arm(counterpart) as arm:
        start = arm.link.state().q_wanted
        way = np.array([0.3, 0.2, -0.1, 0.2, 0.5, -0.3, 0.1])
        wanted = []
        for _ in arm._along(np.array([start, start + way]), 0.02):
            wanted.append(arm.link.state().q_wanted)
        off = np.array(wanted) - start
        along = off @ way / (way @ way)
        assert along[-1] > 0.9
        assert np.abs(off - along[:, None] * way).max() < 2e-3


def test_a_reflex_is_one_line_and_the_arm_stands_still(counterpart, T_world_handle):
    with opened_arm(counterpart) as arm:
        motion = arm.grasp(T_world_handle, TICK_S)
        for _ in range(25):
            next(motion)
        counterpart.ask("reflex")
        with pytest.raises(ArmStopped, match="reflex") as stopped:
            run(motion)
        assert "\n" not in str(stopped.value)
        assert at_rest(counterpart)


def test_a_lost_connection_is_one_line(counterpart, T_world_handle):
    with pytest.raises(ArmStopped, match=r"connection to the arm .* was lost") as stopped:
        with opened_arm(counterpart) as arm:
            motion = arm.grasp(T_world_handle, TICK_S)
            for _ in range(15):
                next(motion)
            counterpart.tell("drop")
            run(motion)
    assert "\n" not in str(stopped.value)


def test_the_callers_own_error_leaves_the_arm_at_rest(counterpart, T_world_handle):
    with pytest.raises(ZeroDivisionError), opened_arm(counterpart) as arm:
        for i, _ in enumerate(arm.grasp(T_world_handle, TICK_S)):
            if i == 20:
                raise ZeroDivisionError
    assert at_rest(counterpart)


def test_a_pull_waits_for_whoever_is_away(counterpart, T_world_handle):
    with opened_arm(counterpart) as arm:
        assert arm.reachable(T_world_handle, [T_world_handle]) == 1.0
        run(arm.grasp(T_world_handle, TICK_S, onward=[T_world_handle]))
        assert arm.can_follow([arm.T_world_gripper()]) == 1
        motion = arm.pull(TOWARDS_ROBOT, 0.25, TICK_S)
        for _ in range(8):
            next(motion)
        time.sleep(1.5)
        before_m = counterpart.ask("drawer")
        time.sleep(3.0)
        assert counterpart.ask("drawer") - before_m < 0.01
        next(motion)
        run(arm.relax(TICK_S))
        assert at_rest(counterpart)
        assert arm.holding()


def test_nobody_at_the_address_is_one_line():
    pytest.importorskip("franky", reason="franky-control is not installed")
    with pytest.raises(ArmStopped, match=r"no Franka can be commanded at 127\.9\.9\.9"):
        FrankaArm("127.9.9.9", ArmPlanner(floor_m=0.0)).__enter__()
