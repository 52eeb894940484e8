from __future__ import annotations

from dataclasses import replace

import coal
import gtsam
import numpy as np
import pinocchio as pin
import pytest

from akm_fg.arm.body.collision import Obstacle, hull_parts
from akm_fg.arm.body.description import franka_description
from akm_fg.arm.body.impedance import ImpedanceConfig
from akm_fg.arm.body.kinematics import Q_HOME, FrankaKinematics
from akm_fg.arm.body.model import ROBOT_LINKS
from akm_fg.arm.motion.obstacle_map import ObstacleMap
from akm_fg.arm.motion.reaching import (
    ReachConfig,
    choose_grasp_configuration,
    grasp_options,
    line_motion,
    looked_along,
    standoff,
)
from akm_fg.arm.motion.surroundings import AroundConfig, SeenAround, Surroundings, surroundings

R_FORWARD = gtsam.Rot3(np.array([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]]))
GRASP = gtsam.Pose3(R_FORWARD, np.array([0.6, 0.1, 0.5]))
MARGIN_M = ReachConfig().margins_m[0]
EVERYWHERE = np.arange(-0.12, 0.13, 0.02)
FRONT = np.array([[0.62, 0.1 + y, 0.5 + z] for y in EVERYWHERE for z in EVERYWHERE])
HANDLE = np.array([[0.57, 0.1 + y, 0.5] for y in EVERYWHERE])  # as padded voxels show it


def box(name: str, size_m: list[float], middle_m: np.ndarray) -> Obstacle:
    return Obstacle(name, coal.Box(*size_m), gtsam.Pose3(gtsam.Rot3(), np.asarray(middle_m)))


def shown(surface: np.ndarray, hidden: np.ndarray | None = None) -> SeenAround:
    """Voxels of 2 cm with these middles, the same near the grasp as everywhere."""
    rest = np.empty((0, 3)) if hidden is None else hidden
    kinds = np.repeat([True, False], [len(surface), len(rest)])
    both = ObstacleMap(np.concatenate([surface, rest]), kinds, 0.02)
    return SeenAround(both, both)


def among(*known: Obstacle, seen: SeenAround | None = None) -> Surroundings:
    return surroundings(list(known), seen, GRASP, AroundConfig(), MARGIN_M)


def test_out_of_reach_there_is_no_configuration():
    far = gtsam.Pose3(GRASP.rotation(), np.array([1.6, 0.0, 0.5]))
    assert choose_grasp_configuration(FrankaKinematics(), far) is None
    assert not grasp_options(FrankaKinematics(), far, among()).reachable


def test_the_pregrasp_lies_behind_the_grasp_along_the_approach():
    kinematics = FrankaKinematics()
    grasp = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([0.6, 0.1, 0.5]))
    choice = choose_grasp_configuration(kinematics, grasp)
    assert choice is not None and choice.standoff_m == ReachConfig().standoffs_m[0]
    wanted = standoff(grasp, choice.standoff_m)
    assert wanted.equals(kinematics.T_world_gripper(choice.q_pregrasp), 1e-3)
    np.testing.assert_allclose(wanted.translation(), [0.5, 0.1, 0.5], atol=1e-9)


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
    model, hulls = hull_parts(franka_description())
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


def test_fingers_may_enter_what_is_seen_at_the_grasp_and_the_palm_may_not():
    seen = shown(np.concatenate([FRONT, HANDLE]))
    options = grasp_options(FrankaKinematics(), GRASP, among(seen=seen))
    assert options.configurations and not any(x.unseen for x in options.configurations)
    overhang = np.array([[0.60 - x, 0.1 + y, 0.5] for x in (0.07, 0.09) for y in EVERYWHERE])
    options = grasp_options(
        FrankaKinematics(), GRASP, among(seen=shown(np.concatenate([FRONT, HANDLE, overhang])))
    )
    assert not options.configurations
    assert options.touched is not None and options.touched.endswith("what the camera sees")


SHADOW = np.array(  # a slab that reaches from the front 7 cm towards the robot, where the palm goes
    [[0.6 - x, 0.1 + y, 0.5] for x in (0.03, 0.05, 0.07) for y in np.arange(0.0, 0.2, 0.02)]
)


def test_hand_and_wrist_may_go_where_nobody_could_look_and_the_arm_may_not():
    around = among(seen=shown(FRONT, SHADOW))
    options = grasp_options(FrankaKinematics(), GRASP, around)
    assert options.configurations and all(x.unseen for x in options.configurations)
    q = options.configurations[0].q_grasp
    assert around.approach.free(q) and not around.free_motion.free(q)
    for link, free in (("panda_link7", True), ("panda_link5", False)):
        at_link = corners_of_link(q, link).mean(axis=0)[None]
        assert among(seen=shown(FRONT, at_link)).approach.free(q) is free
        assert not among(seen=shown(np.concatenate([FRONT, at_link]))).approach.free(q)


def test_where_the_first_standoff_is_not_clear_the_hand_starts_from_farther_back():
    """Something unseen beside the palm as it is at the first pre-grasp."""
    shadow = GRASP.translation() - [0.10, 0.0, 0.0] + [[0.0, y, 0.0] for y in (0.0, 0.02, 0.04)]
    options = grasp_options(FrankaKinematics(), GRASP, among(seen=shown(FRONT, shadow)))
    assert options.configurations
    for choice in options.configurations:
        assert choice.standoff_m > ReachConfig().standoffs_m[0] and choice.unseen
        wanted = standoff(GRASP, choice.standoff_m)
        assert wanted.equals(FrankaKinematics().T_world_gripper(choice.q_pregrasp), 1e-3)
    near = replace(ReachConfig(), standoffs_m=(0.10,))
    assert not grasp_options(
        FrankaKinematics(), GRASP, among(seen=shown(FRONT, shadow)), near
    ).configurations


def test_a_smaller_margin_is_kept_where_the_larger_leaves_no_way():
    """A ball under hand and wrist, as near to them as lies between the two margins."""
    kinematics, reach = FrankaKinematics(), replace(ReachConfig(), standoffs_m=(0.10,))
    choice = grasp_options(kinematics, GRASP, None, reach).configurations[0]
    lowest = corners_of_link(choice.q_grasp, "panda_hand")
    lowest = lowest[lowest[:, 2].argmin()]
    ball = Obstacle(
        "a ball", coal.Sphere(0.005), gtsam.Pose3(gtsam.Rot3(), lowest - [0.0, 0.0, 0.027])
    )
    around = among(ball)
    assert not around.approach.free(choice.q_grasp)
    options = grasp_options(kinematics, GRASP, around, reach)
    assert any(np.array_equal(x.q_grasp, choice.q_grasp) for x in options.configurations)
    assert around.free_motion.margin_m == around.approach.margin_m == reach.margins_m[1]


def test_the_hand_may_come_near_to_modelled_furniture_in_the_approach_alone():
    """A strip before the palm, nearer to it than the margin; a lamp stays in the elbow's way."""
    strip = box("a board", [0.01, 0.4, 0.02], GRASP.translation() - [0.03, 0.0, 0.0])
    modelled = surroundings([], None, GRASP, AroundConfig(), MARGIN_M, [strip])
    choice = choose_grasp_configuration(FrankaKinematics(), GRASP)
    assert choice is not None
    touched = modelled.free_motion.touched(choice.q_grasp)
    assert touched is not None and "a board" in touched
    assert modelled.approach.touched(choice.q_grasp) is None
    elbow = box("a lamp", [0.1, 0.1, 0.1], np.array([0.25, 0.0, 0.55]))
    around = surroundings([], None, GRASP, AroundConfig(), MARGIN_M, [elbow])
    assert around.approach.touched(Q_HOME)


def test_the_hands_own_inertia_does_not_look_like_a_block_on_the_approach():
    """4 kg on a spring of 900 N/m: what starts or stops it may be no more than 3 of 12 mm."""
    way = np.array([0.0, 0.0, *line_motion(0.1, 1e-3, 0.08)])
    speed, acceleration = np.diff(way) / 1e-3, np.diff(way, 2) / 1e-6
    assert speed.max() <= 0.08 + 1e-9 and way[-1] == pytest.approx(0.1)
    assert 4.0 * np.abs(acceleration).max() / ImpedanceConfig().stiffness_n_m < 0.003
    # It begins and ends at rest, without a step of acceleration.
    assert np.abs(acceleration[[0, -1]]).max() < 0.01


def test_the_way_of_feeling_is_the_cameras_look_no_farther_aslant_than_fingers_may_go():
    T_world_grasp = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([0.6, 0.0, 0.5]))  # z is x
    beside = np.array([0.6 - np.cos(0.3), -np.sin(0.3), 0.5])
    np.testing.assert_allclose(
        looked_along(T_world_grasp, beside, 0.6), [np.cos(0.3), np.sin(0.3), 0.0], atol=1e-12
    )
    above = np.array([0.6 - np.cos(0.3), 0.0, 0.5 + np.sin(0.3)])  # along the gripper's x
    np.testing.assert_allclose(
        looked_along(T_world_grasp, above, 0.1), [np.cos(0.1), 0.0, -np.sin(0.1)], atol=1e-12
    )
    # Farther aslant than allowed and along the fingers' opening: these take up what depth errs.
    both, off = above + beside - T_world_grasp.translation(), np.arctan(np.tan(0.3) / 2)
    np.testing.assert_allclose(
        looked_along(T_world_grasp, both, 0.2), [np.cos(off), 0.0, -np.sin(off)], atol=1e-12
    )
    for eye, most_rad in ((None, 0.6), (beside, 0.0), (beside, 0.1)):
        np.testing.assert_allclose(
            looked_along(T_world_grasp, eye, most_rad), [1.0, 0.0, 0.0], atol=1e-12
        )
