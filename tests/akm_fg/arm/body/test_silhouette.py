"""The robot's silhouette from its own meshes, against what the simulator draws."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.arm.body.kinematics import Q_HOME, Q_MAX, Q_MIN, FrankaKinematics
from akm_fg.arm.body.silhouette import ArmSilhouette, SilhouetteConfig
from akm_fg.records import PinholeCamera, RgbdFrame
from sim.bullet import p
from sim.camera.camera import CameraConfig, SimCamera
from sim.camera.mirror import LocalScene, poses_of, shapes_of
from sim.camera.views import ViewConfig, camera_pose, look_at
from sim.robot.contacts import finger_links
from sim.world import SimWorld

EXACT = SilhouetteConfig(margin_m=0.0, margin_px=0.0)
CAMERA = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
T_WORLD_CAM = look_at(np.array([0.2, -1.2, 0.6]), np.array([0.4, 0.0, 0.4]))
FINGERS_M = 0.02


@pytest.fixture(scope="module")
def camera() -> Iterator[SimCamera]:
    """Draws the robot for masking as large as the image, and does not grow it."""
    with SimWorld("door", 0) as world:
        config = CameraConfig(mask_scale=1, mask_grow_px=0)
        opened = SimCamera(world, camera_pose(world, ViewConfig()), 0, config)
        yield opened
        opened.close()


def poses(n: int) -> Iterator[tuple[np.ndarray, float]]:
    rng = np.random.default_rng(5)
    yield Q_HOME, 0.04
    for q in rng.uniform(Q_MIN, Q_MAX, (n - 1, 7)):
        yield q, float(rng.uniform(0.0, 0.04))


def put(world: SimWorld, q: np.ndarray, fingers_m: float) -> None:
    fingers = finger_links(world.client, world.robot_id)
    for joint, x in [*enumerate(q), *((finger, fingers_m) for finger in fingers)]:
        p.resetJointState(world.robot_id, joint, float(x), physicsClientId=world.client)


def wider(mask: np.ndarray, radius_px: int) -> np.ndarray:
    square = np.ones((2 * radius_px + 1,) * 2, np.uint8)
    return cv2.dilate(mask.astype(np.uint8), square).astype(bool)


def test_it_is_where_the_simulator_draws_the_robot(camera: SimCamera):
    arm = ArmSilhouette(config=EXACT)
    for q, fingers_m in poses(6):
        put(camera._world, q, fingers_m)
        drawn = camera.robot_depth()
        found = arm.depth(q, fingers_m, camera.intrinsics, camera.T_world_cam)
        here, there = np.isfinite(found), np.isfinite(drawn)
        assert there.sum() > 5000
        assert wider(here, 2)[there].mean() > 0.999 and wider(there, 2)[here].mean() > 0.999
        assert (here == there).mean() > 0.9995
        off_m = np.abs(found - drawn)[here & there]
        assert np.median(off_m) < 1e-5 and np.quantile(off_m, 0.99) < 1e-4


def test_grown_it_covers_all_that_is_seen_of_the_robot_by_a_camera_that_is_a_little_off(
    camera: SimCamera,
):
    """As far off as the worst calibration of docs/calibration.md: 4 mm at 1 m."""
    world, arm, rng = camera._world, ArmSilhouette(), np.random.default_rng(6)
    shapes = shapes_of(world.client, [world.robot_id])
    scene = LocalScene()
    scene.show(shapes)
    for q, fingers_m in poses(6):
        put(world, q, fingers_m)
        shot = camera.config.shot(camera.T_world_cam)
        seen = scene.draw(poses_of(world.client, shapes), shot).body >= 0
        turn, shift = (x / np.linalg.norm(x) for x in rng.normal(size=(2, 3)))
        error = gtsam.Pose3(gtsam.Rot3.Expmap(np.deg2rad(0.15) * turn), 1.4e-3 * shift)
        T_believed = camera.T_world_cam * error
        mask = arm.mask(q, fingers_m, camera.intrinsics, T_believed)
        assert seen.sum() > 5000 and mask[seen].all()
        assert mask.sum() < 1.8 * seen.sum()
    scene.close()


def test_a_margin_in_pixels_moves_the_edge_by_so_many():
    exact = ArmSilhouette(config=EXACT).mask(Q_HOME, FINGERS_M, CAMERA, T_WORLD_CAM)
    three = replace(EXACT, margin_px=3.0)
    grown = ArmSilhouette(config=three).mask(Q_HOME, FINGERS_M, CAMERA, T_WORLD_CAM)
    # Columns and rows at the image's edge may grow in from beyond it.
    np.testing.assert_array_equal(grown[4:-4, 4:-4], wider(exact, 3)[4:-4, 4:-4])


def test_a_margin_in_metres_is_so_wide_where_the_robot_is():
    """Seen from above at home, far enough away for all parts to be at about one depth."""
    above = look_at(np.array([0.3, 0.0, 4.0]), np.array([0.3, 0.01, 0.0]))
    exact = ArmSilhouette(config=EXACT).depth(Q_HOME, FINGERS_M, CAMERA, above)
    silhouette = ArmSilhouette(config=replace(EXACT, margin_m=0.05))
    grown = silhouette.mask(Q_HOME, FINGERS_M, CAMERA, above)
    nearest_m, farthest_m = np.nanmin(exact), np.nanmax(exact)
    least, most = (int(np.ceil(300.0 * 0.05 / z)) for z in (farthest_m, nearest_m))
    mask = np.isfinite(exact)
    assert 3 < least < most < 6
    assert grown[wider(mask, least)].all() and not grown[~wider(mask, most)].any()


def test_what_is_beside_the_image_grows_into_it_and_nothing_else_changes():
    """A window of a larger image shows what the larger image shows there."""
    arm = ArmSilhouette()
    whole = arm.depth(Q_HOME, FINGERS_M, CAMERA, T_WORLD_CAM)
    rows, columns = np.nonzero(np.isfinite(whole))
    for u, v in ((columns.max() - 3, rows.min()), (columns.min() + 40, rows.max() - 2), (0, 0)):
        part = PinholeCamera(60, 50, 300.0, 300.0, 159.5 - u, 119.5 - v)
        cut = whole[v : v + 50, u : u + 60]
        shown = arm.depth(Q_HOME, FINGERS_M, part, T_WORLD_CAM)[: cut.shape[0], : cut.shape[1]]
        np.testing.assert_array_equal(shown, cut)


def test_a_camera_that_looks_away_sees_no_robot_and_one_in_the_hand_sees_the_fingers():
    arm = ArmSilhouette()
    away = look_at(np.array([1.5, 0.0, 0.5]), np.array([2.5, 0.0, 0.5]))
    assert not arm.mask(Q_HOME, FINGERS_M, CAMERA, away).any()
    beside = look_at(np.array([1.5, 0.0, 0.5]), np.array([1.5, 9.0, 0.5]))
    assert not arm.mask(Q_HOME, FINGERS_M, CAMERA, beside).any()
    hand = FrankaKinematics().T_world_gripper(Q_HOME)
    on_the_wrist = look_at(hand.transformFrom(np.array([0.08, 0.0, -0.12])), hand.translation())
    depth = arm.depth(Q_HOME, FINGERS_M, CAMERA, on_the_wrist)
    assert 0.05 < np.isfinite(depth).mean() < 0.7
    assert 0.02 < np.nanmin(depth) < 0.1 and (depth < 0.2).mean() > 0.05


def test_the_fingers_are_as_far_apart_as_they_are_said_to_be():
    hand = FrankaKinematics().T_world_gripper(Q_HOME)
    aside = look_at(hand.transformFrom(np.array([0.5, 0.0, 0.0])), hand.translation())
    arm, v_u = ArmSilhouette(config=EXACT), np.mgrid[0:240, 0:320].astype(float)
    widths_m = []
    for fingers_m in (0.0, 0.04):
        depth = arm.depth(Q_HOME, fingers_m, CAMERA, aside).astype(float)
        p_cam = CAMERA.back_project(np.stack([v_u[1], v_u[0]], axis=-1), depth)
        p_hand = hand.between(aside).transformFrom(p_cam[np.isfinite(depth)].T).T
        tips = np.abs(p_hand).max(axis=1) < 0.1
        tips &= p_hand[:, 2] > -0.02  # the palm ends before
        widths_m.append(np.ptp(p_hand[tips, 1]))
    assert widths_m[1] - widths_m[0] == pytest.approx(0.08, abs=0.004)  # a pixel is 1.7 mm


def test_a_masked_frame_keeps_what_is_in_front_of_the_robot_and_beside_it():
    arm = ArmSilhouette()
    robot = arm.depth(Q_HOME, FINGERS_M, CAMERA, T_WORLD_CAM)
    inside = np.isfinite(robot)
    depth = np.full((240, 320), 2.0, np.float32)
    depth[inside] = robot[inside] + 0.01  # as a camera measures it: near what it is
    v, u = (x[len(x) // 2] for x in np.nonzero(inside))
    depth[v, u] = robot[v, u] - 0.05  # something in front
    depth[v, u + 1] = robot[v, u + 1] - 0.02  # still the robot, with noise
    depth[0, 0] = np.nan
    frame = RgbdFrame(1.5, np.zeros((240, 320, 3), np.uint8), depth, CAMERA, T_WORLD_CAM)
    masked = arm.masked(frame, Q_HOME, FINGERS_M)
    kept = ~inside
    kept[v, u], kept[0, 0] = True, False
    np.testing.assert_array_equal(np.isfinite(masked.depth_m), kept)
    np.testing.assert_array_equal(masked.depth_m[kept], depth[kept])
    assert masked.stamp_s == 1.5 and masked.rgb is frame.rgb
