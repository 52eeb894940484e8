from __future__ import annotations

import coal
import gtsam
import numpy as np
import pinocchio as pin

from sim.collision import ROBOT_LINKS, Obstacle, _robot
from sim.kinematics import Q_HOME, Q_MAX, Q_MIN, FrankaKinematics, limit_margin_rad
from sim.obstacle_map import ObstacleMap
from sim.reaching import (
    ReachConfig,
    Surroundings,
    choose_grasp_configuration,
    grasp_options,
    standoff,
    surroundings,
)


def is_at(kinematics: FrankaKinematics, q: np.ndarray, wanted: gtsam.Pose3) -> bool:
    """To a tenth of a millimetre and a milliradian, inside the soft limits."""
    found = kinematics.T_world_gripper(q)
    off_m = np.linalg.norm(found.translation() - wanted.translation())
    off_rad = np.linalg.norm(gtsam.Rot3.Logmap(found.rotation().between(wanted.rotation())))
    return bool(off_m < 1e-4 and off_rad < 1e-3 and limit_margin_rad(q) >= 0.0)


def test_inverse_kinematics_reaches_poses_near_by_to_a_tenth_of_a_millimetre():
    """All but one in a hundred, which may end at a joint limit; then it says so."""
    kinematics, rng = FrankaKinematics(), np.random.default_rng(3)
    missed = 0
    for q_true in rng.uniform(Q_MIN + 0.1, Q_MAX - 0.1, (400, 7)):
        wanted = kinematics.T_world_gripper(q_true)
        q = kinematics.solve(wanted, q_true + rng.normal(0.0, 0.2, 7))
        missed += q is None
        assert q is None or is_at(kinematics, q, wanted)
    assert missed <= 4


def test_inverse_kinematics_from_far_is_as_exact_or_says_none():
    kinematics, rng = FrankaKinematics(), np.random.default_rng(4)
    found = 0
    for q_true in rng.uniform(Q_MIN + 0.1, Q_MAX - 0.1, (50, 7)):
        wanted = kinematics.T_world_gripper(q_true)
        starts = [Q_HOME, *rng.uniform(Q_MIN, Q_MAX, (3, 7))]
        answers = [
            q for q in (kinematics.solve(wanted, start) for start in starts) if q is not None
        ]
        assert all(is_at(kinematics, q, wanted) for q in answers)
        found += bool(answers)
    assert found > 40  # from four starts


def test_the_jacobian_is_the_derivative_of_the_pose():
    kinematics, step = FrankaKinematics(), 1e-6
    q = Q_HOME + 0.1
    J = kinematics.update(q)[1].copy()
    for j in range(7):
        dq = np.eye(7)[j] * step
        ahead, behind = kinematics.T_world_gripper(q + dq), kinematics.T_world_gripper(q - dq)
        column = (ahead.translation() - behind.translation()) / (2 * step)
        np.testing.assert_allclose(J[:3, j], column, atol=1e-6)


def test_a_pose_out_of_reach_has_no_solution():
    far = gtsam.Pose3(gtsam.Rot3(), np.array([2.0, 0.0, 0.5]))
    assert FrankaKinematics().solve(far, Q_HOME) is None
    assert choose_grasp_configuration(FrankaKinematics(), far) is None


def test_the_pregrasp_lies_behind_the_grasp_along_the_approach():
    kinematics = FrankaKinematics()
    grasp = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([0.6, 0.1, 0.5]))
    choice = choose_grasp_configuration(kinematics, grasp)
    assert choice is not None
    wanted = standoff(grasp, ReachConfig().standoff_m)
    assert wanted.equals(kinematics.T_world_gripper(choice.q_pregrasp), 1e-3)
    np.testing.assert_allclose(wanted.translation(), [0.5, 0.1, 0.5], atol=1e-9)


GRASP = gtsam.Pose3(
    gtsam.Rot3(np.array([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]])), np.array([0.6, 0.1, 0.5])
)


def box(name: str, size_m: list[float], middle_m: np.ndarray) -> Obstacle:
    return Obstacle(name, coal.Box(*size_m), gtsam.Pose3(gtsam.Rot3(), np.asarray(middle_m)))


def among(*known: Obstacle, seen: ObstacleMap | None = None) -> Surroundings:
    return surroundings(list(known), seen, GRASP, ReachConfig())


def test_branches_that_would_touch_something_are_left_out():
    kinematics = FrankaKinematics()
    free = grasp_options(kinematics, GRASP, among()).configurations
    assert len(free) >= 3
    elbow = corners_of_link(free[0].q_pregrasp, "panda_link4").mean(axis=0)
    block = box("a beam", [0.04, 0.04, 0.04], elbow)
    around = among(block)
    left = grasp_options(kinematics, GRASP, around).configurations
    assert 0 < len(left) < len(free)
    for choice in left:
        assert around.free_motion.free(choice.q_pregrasp) and around.approach.free(choice.q_grasp)
    assert not any(np.array_equal(x.q_grasp, free[0].q_grasp) for x in left)


def corners_of_link(q: np.ndarray, link: str) -> np.ndarray:
    model, hulls = _robot()
    data, places = model.createData(), hulls.createData()
    pin.updateGeometryPlacements(model, data, hulls, places, np.concatenate([q, [0.04, 0.04]]))
    k = ROBOT_LINKS.index(link)
    shape = hulls.geometryObjects[k].geometry
    points = np.array([shape.point(i) for i in range(shape.num_points)])
    return points @ places.oMg[k].rotation.T + places.oMg[k].translation


def test_what_is_in_the_way_is_named_where_no_branch_is_clear():
    wall = box("a wall", [0.02, 2.0, 2.0], GRASP.translation() - [0.12, 0.0, 0.0])
    options = grasp_options(FrankaKinematics(), GRASP, among(wall))
    assert options.reachable and not options.configurations
    assert options.touched is not None and "a wall" in options.touched
    far = gtsam.Pose3(GRASP.rotation(), np.array([1.6, 0.0, 0.5]))
    assert not grasp_options(FrankaKinematics(), far, among()).reachable


def test_fingers_may_enter_what_is_seen_at_the_grasp_and_the_palm_may_not():
    spread = np.arange(-0.12, 0.13, 0.02)
    front = np.array([[0.62, 0.1 + y, 0.5 + z] for y in spread for z in spread])
    handle = np.array([[0.57, 0.1 + y, 0.5] for y in spread])  # as padded voxels show it
    seen = ObstacleMap(np.concatenate([front, handle]), 0.02)
    assert grasp_options(FrankaKinematics(), GRASP, among(seen=seen)).configurations
    overhang = np.array([[0.60 - x, 0.1 + y, 0.5] for x in (0.06, 0.08) for y in spread])
    blocked = ObstacleMap(np.concatenate([front, handle, overhang]), 0.02)
    options = grasp_options(FrankaKinematics(), GRASP, among(seen=blocked))
    assert not options.configurations
    assert options.touched is not None and options.touched.endswith("what the camera sees")


def test_the_hand_may_come_near_to_modelled_furniture_in_the_approach_alone():
    """A strip before the palm, nearer to it than the margin; a lamp stays in the elbow's way."""
    strip = box("a board", [0.01, 0.4, 0.02], GRASP.translation() - [0.03, 0.0, 0.0])
    modelled = surroundings([], None, GRASP, ReachConfig(), [strip])
    choice = choose_grasp_configuration(FrankaKinematics(), GRASP)
    assert choice is not None
    touched = modelled.free_motion.touched(choice.q_grasp)
    assert touched is not None and "a board" in touched
    assert modelled.approach.touched(choice.q_grasp) is None
    elbow = box("a lamp", [0.1, 0.1, 0.1], np.array([0.25, 0.0, 0.55]))
    assert surroundings([], None, GRASP, ReachConfig(), [elbow]).approach.touched(Q_HOME)
