"""Hand poses along a joint."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.arm.motion.reference import pose_reference
from akm_fg.arm.motion.time_law import duration_s
from akm_fg.errors import MotionInfeasible
from akm_fg.planning.opening_path import HandLimits, plan_opening
from akm_fg.posterior import JointPosterior
from factors.joint import Joint

STEP_S = 1e-3


def _followed(path):
    """As the arm's reference goes along it: places (N, 3), and speeds (N, 6) of the hand."""
    reference = pose_reference(path, path.T_world_gripper[0].matrix(), STEP_S)
    return reference.p_world, reference.twist


def _joint(kind, T_world_joint=None):
    T = np.eye(4) if T_world_joint is None else T_world_joint
    return JointPosterior(Joint(kind, T, 0.0), np.zeros((6, 6)))


def test_a_quarter_turn_about_z_takes_the_hand_from_x_to_y_and_turns_it():
    hand = gtsam.Pose3(gtsam.Rot3(), np.array([0.5, 0.0, 0.2]))
    path = plan_opening(_joint("revolute"), hand, 0.3, 0.3 + np.pi / 2)
    last = path.T_world_gripper[-1]
    assert_allclose(last.translation(), [0.0, 0.5, 0.2], atol=1e-6)
    assert_allclose(last.rotation().matrix(), gtsam.Rot3.Rz(np.pi / 2).matrix(), atol=1e-6)


def test_a_drawer_moves_the_hand_along_the_axis_and_does_not_turn_it():
    hand = gtsam.Pose3(gtsam.Rot3.Ypr(0.3, 0.2, 0.1), np.array([0.5, 0.1, 0.2]))
    path = plan_opening(_joint("prismatic"), hand, 0.05, 0.25)
    moved = path.T_world_gripper[-1].translation() - hand.translation()
    assert_allclose(moved, [0.0, 0.0, 0.2], atol=1e-6)
    assert_allclose(
        path.T_world_gripper[-1].rotation().matrix(), hand.rotation().matrix(), atol=1e-9
    )


def test_a_screw_turns_the_hand_by_a_radian_and_lifts_it_by_its_pitch():
    """Pitch 0.1 m/rad, one radian: 0.1 m up the axis; the hand at (0.5, 0, 0.2) goes round it."""
    screw = JointPosterior(Joint("helical", np.eye(4), 0.1), np.zeros((6, 6)), 0.001)
    hand = gtsam.Pose3(gtsam.Rot3(), np.array([0.5, 0.0, 0.2]))
    path = plan_opening(screw, hand, 0.4, 1.4)
    last = path.T_world_gripper[-1]
    assert_allclose(last.translation(), [0.5 * np.cos(1), 0.5 * np.sin(1), 0.3], atol=1e-6)
    assert_allclose(last.rotation().matrix(), gtsam.Rot3.Rz(1.0).matrix(), atol=1e-6)


def test_a_screw_of_large_pitch_keeps_the_hands_speed():
    """On its axis a hand only climbs: half a metre a radian, at most 0.1 m/s."""
    screw = JointPosterior(Joint("helical", np.eye(4), 0.5), np.zeros((6, 6)), 0.001)
    path = plan_opening(screw, gtsam.Pose3(), 0.0, 2.0)
    assert_allclose(_followed(path)[1][:, 2].max(), HandLimits().speed_m_s, rtol=0.01)


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
@pytest.mark.parametrize("distance", [0.3, -0.3, 0.002])
def test_the_hand_keeps_its_limits_and_starts_and_ends_at_rest(kind, distance):
    limits = HandLimits()
    hand = gtsam.Pose3(gtsam.Rot3(), np.array([0.6, 0.0, 0.0]))
    path = plan_opening(_joint(kind), hand, 0.0, distance, limits)
    p, twist = _followed(path)
    speed = np.linalg.norm(twist[:, :3], axis=1)
    acceleration = np.diff(speed) / STEP_S
    assert speed.max() <= limits.speed_m_s * 1.01
    assert np.abs(acceleration).max() <= limits.acceleration_m_s2 * 1.05
    assert max(speed[0], speed[-1]) <= limits.acceleration_m_s2 * STEP_S
    assert_allclose(p[0], hand.translation(), atol=1e-9)


def test_staying_where_it_is_is_a_path_too():
    path = plan_opening(_joint("prismatic"), gtsam.Pose3(), 0.1, 0.1)
    assert_allclose(path.T_world_gripper[-1].matrix(), np.eye(4), atol=1e-9)


def test_a_target_that_is_not_a_number_is_refused():
    with pytest.raises(MotionInfeasible, match="finite"):
        plan_opening(_joint("prismatic"), gtsam.Pose3(), 0.0, np.nan)


def test_the_hand_is_jerked_no_more_than_a_person_jerks_a_cup():
    """A drawer's way is its hand's: third differences of it are the jerk.

    A reach of minimum jerk over a way d in a time T begins with 60 d / T^3 (Flash, Hogan, The
    coordination of arm movements, 1985): 5.3 m/s^3 for an easy 0.3 m in 1.5 s.
    """
    limits = HandLimits()
    path = plan_opening(_joint("prismatic"), gtsam.Pose3(), 0.0, 0.3, limits)
    jerk = np.diff(_followed(path)[0][:, 2], 3) / STEP_S**3
    assert np.abs(jerk).max() < 60 * 0.3 / 1.5**3
    # From rest to rest with bounds v, a and j, all of them met: d / v + v / a + a / j.
    v, a, j = limits.speed_m_s, limits.acceleration_m_s2, limits.jerk_m_s3
    assert_allclose(duration_s(path), 0.3 / v + v / a + a / j, atol=1e-6)


def test_where_the_world_begins_does_not_matter_to_a_door():
    """The lever is the hand's distance from the axis, wherever both are: 0.5 m at 0.1 m/s."""
    speeds = []
    for away in (np.zeros(3), np.array([3.0, -2.0, 1.0])):
        T = np.eye(4)
        T[:3, 3] = away
        hand = gtsam.Pose3(gtsam.Rot3(), away + np.array([0.5, 0.0, 0.2]))
        path = plan_opening(_joint("revolute", T), hand, 0.0, 1.2)
        speeds.append(np.linalg.norm(_followed(path)[1][:, :3], axis=1))
    assert_allclose(speeds[0].max(), 0.10, rtol=0.01)
    assert_allclose(speeds[1], speeds[0], atol=1e-7)


def test_a_hand_near_the_hinge_turns_no_faster_than_half_a_radian_a_second():
    """At 5 cm, 0.1 m/s would be 2 rad/s."""
    hand = gtsam.Pose3(gtsam.Rot3(), np.array([0.05, 0.0, 0.0]))
    path = plan_opening(_joint("revolute"), hand, 0.0, 1.2)
    assert_allclose(np.abs(_followed(path)[1][:, 5]).max(), 0.5, rtol=0.01)


def test_a_cubic_through_its_poses_leaves_the_arc_by_less_than_a_tenth_of_a_millimetre():
    hand = gtsam.Pose3(gtsam.Rot3(), np.array([0.8, 0.0, 0.0]))
    p, _ = _followed(plan_opening(_joint("revolute"), hand, 0.0, 1.5))
    assert_allclose(np.linalg.norm(p[:, :2], axis=1), 0.8, atol=1e-4)
