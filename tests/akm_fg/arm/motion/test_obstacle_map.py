from __future__ import annotations

from collections.abc import Iterator

import coal
import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.arm.body.collision import ArmCollisions, Obstacle, arm_corners
from akm_fg.arm.body.kinematics import Q_HOME, Q_MAX, Q_MIN, FrankaKinematics
from akm_fg.arm.motion.obstacle_map import (
    MapConfig,
    ObstacleMap,
    _arm_in_picture,
    map_from_frame,
    own_surroundings,
)
from akm_fg.arm.motion.reaching import ReachConfig
from akm_fg.arm.motion.surroundings import GraspRoom
from akm_fg.records import PinholeCamera, RgbdFrame
from sim.camera.noise import NOISE_LEVELS, noisy_depth
from sim.camera.views import look_at

CAMERA = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
FULL_SIZE = PinholeCamera(640, 480, 600.0, 600.0, 319.5, 239.5)
T_WORLD_CAM = look_at(np.array([0.2, -1.0, 0.6]), np.array([0.7, 0.0, 0.3]))
# A block in front of the robot: middle and half sides, world.
MIDDLE, HALF = np.array([0.75, 0.0, 0.25]), np.array([0.15, 0.25, 0.25])
BAR = np.array([0.55, 0.0, 0.35])  # middle of a handle, 5 cm before the face towards the robot
ALONG = np.array([0.0, 1.0, 0.0])
BAR_HALF = np.array([0.006, 0.08, 0.006])  # 12 mm thick, as handles are: 3 px of CAMERA


def depth_of_block(
    bar: np.ndarray | None = None,
    bar_half: np.ndarray = BAR_HALF,
    camera: PinholeCamera = CAMERA,
) -> np.ndarray:
    """Exact depth (H, W) of the block on a floor at z = 0, with a bar about a point before it."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    rays_cam = camera.back_project(np.stack([u, v], -1), np.ones_like(u))
    rays = rays_cam @ T_WORLD_CAM.rotation().matrix().T
    eye = T_WORLD_CAM.translation()
    with np.errstate(divide="ignore"):
        depth = np.where(rays[..., 2] < 0, -eye[2] / rays[..., 2], np.inf)
        boxes = [(MIDDLE, HALF)]
        if bar is not None:
            boxes.append((bar, bar_half))
        for middle, half in boxes:
            a, b = (middle - half - eye) / rays, (middle + half - eye) / rays
            enter = np.minimum(a, b).max(axis=-1)
            leave = np.maximum(a, b).min(axis=-1)
            depth = np.where(enter < leave, np.minimum(depth, enter), depth)
    return np.where(depth < 8.0, depth, np.nan).astype(np.float32)


def frame(depth: np.ndarray, camera: PinholeCamera = CAMERA) -> RgbdFrame:
    rgb = np.zeros((*depth.shape, 3), np.uint8)
    return RgbdFrame(0.1, rgb, depth, camera, T_WORLD_CAM)


def mapped(depth: np.ndarray, camera: PinholeCamera = CAMERA) -> ObstacleMap:
    return map_from_frame(frame(depth, camera), Q_HOME, 0.0)


def seen(depth: np.ndarray, camera: PinholeCamera = CAMERA) -> Obstacle:
    obstacle = mapped(depth, camera).obstacle()
    assert obstacle is not None
    return obstacle


def touches(obstacle: Obstacle, point: np.ndarray, radius_m: float) -> bool:
    ball = coal.Transform3s(np.eye(3), np.asarray(point, dtype=float))
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    still = coal.Transform3s()
    return coal.collide(obstacle.geometry, still, coal.Sphere(radius_m), ball, request, result) > 0


def seen_faces() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Points on the two upright faces and the top that the camera sees, and their normals."""
    across = np.linspace(-0.95, 0.95, 9)
    for axis, side in ((0, -1.0), (1, -1.0), (2, 1.0)):
        for a in across:
            for b in across:
                unit = np.insert(np.array([a, b]), axis, side)
                yield MIDDLE + HALF * unit, side * np.eye(3)[axis]


def test_the_shell_covers_what_is_seen_and_nothing_before_it():
    found, voxel = seen(depth_of_block()), MapConfig().voxel_m
    for point, normal in seen_faces():
        towards = T_WORLD_CAM.translation() - point
        towards /= np.linalg.norm(towards)
        # At a grazing angle, and in a corner with the floor, the shell lies before the face.
        at_the_face = point + np.linspace(0.0, 4.0 * voxel, 33)[:, None] * towards
        assert any(touches(found, x, 1e-3) for x in at_the_face)
        if point[2] > 3.0 * voxel and towards @ normal > 0.3:
            assert not touches(found, point + 2.5 * voxel * normal, 1e-3)


def test_what_lies_behind_is_closed_off_and_what_is_out_of_view_is_free():
    found = seen(depth_of_block())
    hidden = MIDDLE + np.array([0.0, HALF[1] + 0.1, 0.0])  # behind the block, seen by nobody
    for start in (np.array([0.3, 0.0, 0.6]), np.array([0.9, 0.2, 1.0])):
        way = np.linspace(start, hidden, 60)
        assert any(touches(found, x, 0.02) for x in way)
    assert not touches(found, np.array([-0.2, 0.3, 0.5]), 0.02)  # beside the camera


def gaps(found: Obstacle, bar: np.ndarray) -> list[float]:
    """Where along a bar a ball of 1 cm, half of what the arm keeps, could pass through its axis."""
    along = np.linspace(-0.075, 0.075, 31)
    return [y for y in along if not touches(found, bar + y * ALONG, 0.01)]


@pytest.mark.parametrize(("camera", "trials"), [(CAMERA, 4), (FULL_SIZE, 1)])
def test_a_bar_as_thin_as_a_handle_is_an_obstacle_under_noise(camera: PinholeCamera, trials: int):
    """The sensor loses a third of the pixels at edges: of three, none is safe."""
    for seed in range(trials):
        rng = np.random.default_rng(seed)
        with_bar, without = (
            noisy_depth(depth_of_block(bar, camera=camera), camera, NOISE_LEVELS["d455"], rng)
            for bar in (BAR, None)
        )
        assert gaps(seen(with_bar, camera), BAR) == []
        assert len(gaps(seen(without, camera), BAR)) == 31


def test_a_thing_thinner_than_a_voxel_is_found_wherever_it_lies_between_their_middles():
    rod_half, voxel_m = np.array([0.003, 0.08, 0.003]), MapConfig().voxel_m
    for x_m in (0.0, voxel_m / 2.0):
        for z_m in (0.0, voxel_m / 2.0):
            rod = BAR + np.array([x_m, 0.0, z_m])
            assert gaps(seen(depth_of_block(rod, rod_half)), rod) == []


def test_a_hole_is_no_opening_and_one_wrong_pixel_no_wall():
    depth = depth_of_block()
    u, v = CAMERA.project(T_WORLD_CAM.transformTo(MIDDLE - [HALF[0], 0.0, 0.0])).round().astype(int)
    hole = depth.copy()
    hole[v - 15 : v + 15, u - 15 : u + 15] = np.nan
    assert touches(seen(hole), MIDDLE - [HALF[0], 0.0, 0.0], 1e-3)
    wrong = depth.copy()
    wrong[v, u] = 0.6
    np.testing.assert_array_equal(mapped(wrong).p_world, mapped(depth).p_world)


def test_the_arms_own_space_is_free_even_where_it_seems_hidden():
    hand = FrankaKinematics().T_world_gripper(Q_HOME).translation()
    depth = depth_of_block()
    uv = CAMERA.project(T_WORLD_CAM.transformTo(hand)).round().astype(int)
    depth[uv[1] - 30 : uv[1] + 30, uv[0] - 30 : uv[0] + 30] = 0.5  # something before the arm
    margin_m = ReachConfig().margins_m[0]
    assert ArmCollisions([seen(depth)], margin_m).free(Q_HOME)
    elsewhere = Q_HOME + np.array([2.0, 0, 0, 0, 0, 0, 0])
    away = map_from_frame(frame(depth), elsewhere, 0.0).obstacle()
    assert away is not None and not ArmCollisions([away], margin_m).free(Q_HOME)


def test_without_depth_there_is_nothing_to_avoid():
    assert mapped(np.full((240, 320), np.nan, np.float32)).obstacle() is None


def test_behind_the_robots_silhouette_a_face_goes_on():
    """Bridged in its plane: neither open nor pushed towards the camera."""
    depth = depth_of_block()
    left = MIDDLE - [0.0, HALF[1], 0.0]
    u, v = CAMERA.project(T_WORLD_CAM.transformTo(left)).round().astype(int)
    depth[v - 20 : v + 20, u - 25 : u + 20] = np.nan
    assert touches(seen(depth), left, 0.02)
    assert not touches(seen(depth), left - [0.0, 0.05, 0.0], 1e-3)


def test_what_the_arm_hides_may_be_more_of_the_object():
    """The arm before a corner of the block, its lower part in view: the block may go on behind."""
    corner = MIDDLE + HALF * np.array([-1.0, -1.0, 1.0])
    points = corner + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.03], [0.0, 0.0, -0.12]])
    u, v = CAMERA.project(T_WORLD_CAM.transformTo(points.T).T).round().astype(int).T
    rng, exact = np.random.default_rng(0), depth_of_block()
    away = Q_HOME + 2.0 * np.eye(7)[0]  # not in the picture: the same gap, made by the sensor
    config, inside = MapConfig(carve_m=0.0), points[0] - [0.0, 0.0, 0.02]
    by_arm, by_sensor = [], []
    for q in rng.uniform(Q_MIN, Q_MAX, (1000, 7)):
        arm = _arm_in_picture(frame(exact), arm_corners(q))
        if list(arm[v, u]) == [True, True, False]:
            torn = frame(np.where(arm, np.nan, exact))
            for result, q_map in ((by_arm, q), (by_sensor, away)):
                obstacle = map_from_frame(torn, q_map, 0.0, config).obstacle()
                assert obstacle is not None
                result.append(touches(obstacle, inside, 0.03))
    assert len(by_arm) >= 10 and all(by_arm)
    assert not all(by_sensor)


def test_a_bridge_from_a_near_edge_to_a_far_wall_is_no_wall_between():
    exact = depth_of_block()
    corner = MIDDLE - [HALF[0], -HALF[1], 0.0]  # of the block, the floor far behind it
    u, v = CAMERA.project(T_WORLD_CAM.transformTo(corner)).astype(int)
    torn = exact.copy()
    torn[v - 5 : v + 5, u - 20 : u + 20] = np.nan
    assert exact[v, u - 20 : u + 20].max() - exact[v, u - 20 : u + 20].min() > 0.2
    whole = {tuple(x) for x in mapped(exact).p_world.round(3)}
    extra = np.array([x for x in mapped(torn).p_world if tuple(x.round(3)) not in whole])
    p_cam = np.array([T_WORLD_CAM.transformTo(x) for x in extra])
    at_u, at_v = CAMERA.project(p_cam).round().astype(int).T
    nearest = cv2.erode(exact, np.ones((9, 9), np.uint8))[at_v, at_u]
    assert (nearest - p_cam[:, 2]).max() < 2.0 * MapConfig().voxel_m


def surfaces_at(found: ObstacleMap, points: np.ndarray) -> list[bool | None]:
    """Of the shell's voxel nearest to each point: is a surface in it? None: no voxel is near."""
    away = np.linalg.norm(found.p_world[None] - np.asarray(points)[:, None], axis=2)
    nearest = away.argmin(axis=1)
    near = away.min(axis=1) < 1.5 * found.voxel_m
    return [bool(found.surface[i]) if ok else None for i, ok in zip(nearest, near, strict=True)]


def test_seen_faces_are_surfaces_and_the_edge_of_a_shadow_is_none():
    found = mapped(depth_of_block())
    eye = T_WORLD_CAM.translation()
    slopes = [(x, normal @ (eye - x) / np.linalg.norm(eye - x)) for x, normal in seen_faces()]
    faces = np.array([x for x, slope in slopes if slope > 0.3 and x[2] > 0.04])
    assert len(faces) > 100 and all(surfaces_at(found, faces))
    # Behind the block's far upright edge the shadow's side begins, seen from the camera.
    edge = MIDDLE + HALF * np.array([-1.0, 1.0, 0.0])
    along = edge - T_WORLD_CAM.translation()
    along /= np.linalg.norm(along)
    shadow = edge + np.array([[0.08], [0.14]]) * along
    assert surfaces_at(found, shadow) == [False, False]


def test_a_hole_in_a_face_is_surface():
    torn = depth_of_block()
    face = MIDDLE - [0.0, HALF[1], 0.0]
    u, v = CAMERA.project(T_WORLD_CAM.transformTo(face)).astype(int)
    torn[v - 5 : v + 5, u - 20 : u + 20] = np.nan
    assert surfaces_at(mapped(torn), [face]) == [True]


def test_what_is_bridged_from_a_near_edge_to_what_is_far_behind_is_no_surface():
    """The sensor loses the pixels at edges, all along them; some it puts into the air between."""
    exact = np.nan_to_num(depth_of_block(), nan=9.0)
    window, wide = np.ones((5, 5), np.uint8), np.ones((9, 9), np.uint8)
    at_an_edge = cv2.dilate(exact, window) - cv2.erode(exact, window) > 0.15
    torn = np.where(at_an_edge, np.nan, depth_of_block())
    rng = np.random.default_rng(1)
    in_the_air = np.argwhere(at_an_edge & (rng.uniform(size=exact.shape) < 0.1))
    between = (cv2.erode(exact, window) + cv2.dilate(exact, window)) / 2.0
    torn[tuple(in_the_air.T)] = between[tuple(in_the_air.T)]
    found = mapped(torn)
    p_cam = np.array([T_WORLD_CAM.transformTo(x) for x in found.p_world])
    u, v = CAMERA.project(p_cam).round().astype(int).T
    u, v = np.clip(u, 0, CAMERA.width - 1), np.clip(v, 0, CAMERA.height - 1)
    near, far = cv2.erode(exact, wide)[v, u], cv2.dilate(exact, wide)[v, u]
    above_floor = found.p_world[:, 2] > 0.05
    air = above_floor & (p_cam[:, 2] > near + 0.06) & (p_cam[:, 2] < far - 0.06)
    assert air.sum() > 500 and found.surface[air].mean() < 0.01


def test_a_map_near_a_point_is_finer_and_agrees():
    depth = depth_of_block(BAR)
    config = MapConfig().near(BAR, 0.15, 0.01)
    fine = map_from_frame(frame(depth), Q_HOME, 0.0, config)
    assert np.abs(fine.p_world - BAR).max() < 0.16 and fine.voxel_m == 0.01
    obstacle = fine.obstacle(fine.surface)
    assert obstacle is not None and gaps(obstacle, BAR) == []
    assert not touches(obstacle, BAR - [0.05, 0.0, 0.0], 0.005)  # the coarse one is padded so far
    below = MapConfig().near(np.array([0.5, 0.0, -1.0]), 0.1, 0.01)
    assert map_from_frame(frame(depth), Q_HOME, 0.0, below).obstacle() is None


def test_what_lies_before_the_palm_is_left_out_for_the_hand():
    face = MIDDLE - [HALF[0], 0.0, 0.0]
    R = gtsam.Rot3(np.array([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]]))  # z into the face
    room = GraspRoom(gtsam.Pose3(R, face - [0.03, 0.0, 0.0]), radius_m=0.14, ahead_m=0.04)
    points = face + np.array([[0, 0, 0], [0, 0.13, 0], [0, 0, 0.15], [-0.06, 0, 0], [-0.08, 0, 0]])
    np.testing.assert_array_equal(room.holds(points), [True, True, False, True, False])


def test_chosen_voxels_alone_are_an_obstacle():
    found = mapped(depth_of_block())
    whole, some = found.obstacle(), found.obstacle(found.surface)
    assert whole is not None and some is not None
    assert 0 < some.geometry.size() < whole.geometry.size()
    assert found.obstacle(np.zeros(len(found.p_world), dtype=bool)) is None


def test_the_robot_knows_the_floor_and_its_pedestal():
    (floor,) = own_surroundings(0.0)
    assert floor.T_world_obstacle.translation()[2] + floor.geometry.halfSide[2] == 0.0
    floor, pedestal = own_surroundings(-0.4)
    assert floor.T_world_obstacle.translation()[2] + floor.geometry.halfSide[2] == -0.4
    np.testing.assert_allclose(pedestal.geometry.halfSide, [0.15, 0.15, 0.2])
    np.testing.assert_allclose(pedestal.T_world_obstacle.translation(), [-0.05, 0.0, -0.2])


@pytest.mark.parametrize("floor_m", [0.0, 0.1])
def test_nothing_below_the_floor_is_mapped(floor_m: float):
    found = map_from_frame(frame(depth_of_block()), Q_HOME, floor_m)
    assert len(found.p_world)
    assert floor_m < found.p_world[:, 2].min() < floor_m + found.voxel_m
