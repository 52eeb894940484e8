"""The dry run plans as the arm does, says so, and loads nothing that could move one."""

from __future__ import annotations

import subprocess
import sys

import gtsam
import numpy as np
import pytest

pytest.importorskip("pybullet_data", reason="the arm's description is not installed")
pytest.importorskip("pinocchio", reason="the arm's packages are not installed")
from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.errors import DryRunEnded, MotionInfeasible
from akm_fg.hardware.franka.dry_run import DryRunArm
from akm_fg.hardware.franka.planning import ArmPlanner
from akm_fg.records import HandPath, WayLimits

FORWARD = gtsam.Rot3(np.column_stack([[0.0, 1, 0], [0.0, 0, 1], [1.0, 0, 0]]))
HANDLE = gtsam.Pose3(FORWARD, np.array([0.5, 0.0, 0.45]))


@pytest.fixture
def told():
    return []


@pytest.fixture
def arm(told):
    return DryRunArm(ArmPlanner(floor_m=0.0), told.append)


def test_a_grasp_is_told_leg_by_leg_and_the_run_ends(arm, told):
    with pytest.raises(DryRunEnded, match="nothing was moved"):
        for _ in arm.grasp(HANDLE, 0.1, feel_m=0.01):
            pass
    assert len(told) == 2
    assert told[0].startswith("to the pre-grasp: ") and " s, to joint angles (" in told[0]
    assert "10 cm along (1.00, 0.00, 0.00) to (0.500, 0.000, 0.450) m" in told[1]
    assert "up to 10 mm on until it is felt" in told[1]
    assert not arm.holding()


def test_what_the_arm_would_refuse_is_refused(arm, told):
    far = gtsam.Pose3(FORWARD, np.array([1.5, 0.0, 0.45]))
    with pytest.raises(MotionInfeasible, match="out of the arm's reach"):
        next(arm.grasp(far, 0.1))
    below = gtsam.Pose3(FORWARD, np.array([0.5, 0.0, 0.01]))
    with pytest.raises(MotionInfeasible, match="is not clear"):
        next(arm.grasp(below, 0.1))
    assert told == []


def test_pulls_and_paths_are_told(arm, told):
    for _ in arm.pull(np.array([-1.0, 0.0, 0.0]), 0.1, 0.1):
        pass
    here = arm.T_world_gripper()
    back = gtsam.Pose3(here.rotation(), here.translation() - np.array([0.05, 0.0, 0.0]))
    path = HandPath(np.array([0.0, 0.05]), (here, back), WayLimits(0.1, 0.3, 2.0))
    for _ in arm.follow(path, 0.1):
        pass
    assert told[0] == "pull: 10 cm along (-1.00, 0.00, 0.00), 40 N at most"
    assert told[1].startswith("follow: from ")


def test_a_robot_with_narrower_joints_goes_nowhere_beyond_them():
    planner = ArmPlanner(floor_m=0.0)
    planner.grasp(HANDLE, Q_HOME)
    low, high = planner.q_limits
    planner.q_limits = low, np.minimum(high, Q_HOME + 1e-3)
    with pytest.raises(MotionInfeasible, match="joint limits"):
        planner.grasp(HANDLE, Q_HOME)


def test_an_arm_that_stands_folded_into_itself_leaves_by_the_way_out_of_it():
    folded = np.array([2.561, -1.368, 1.560, -3.011, -1.528, 3.264, -0.869])
    planner = ArmPlanner(floor_m=-0.5)
    around = planner.scene.around(HANDLE, 0.0)
    planned = planner.grasp(HANDLE, folded)
    np.testing.assert_array_equal(planned.waypoints[0], folded)
    np.testing.assert_array_equal(planned.waypoints[-1], planned.choice.q_pregrasp)
    touches = around.free_motion.touched(folded)
    assert touches is not None
    for share in np.linspace(0.0, 1.0, 20):  # nothing else is touched on the first leg
        q = (1.0 - share) * folded + share * planned.waypoints[1]
        assert around.free_motion.touched(q) in (touches, None)
    assert around.free_motion.free_along(planned.waypoints[1:], 0.01)


def test_nothing_that_moves_an_arm_is_loaded():
    code = (
        "import sys; import akm_fg.hardware.opening; "
        "sys.exit('franky' in sys.modules or 'pyrealsense2' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
