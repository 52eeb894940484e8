from __future__ import annotations

from collections.abc import Iterator

import coal
import gtsam
import numpy as np

from akm_fg.records import PinholeCamera, RgbdFrame
from sim.collision import Obstacle
from sim.kinematics import Q_HOME
from sim.obstacle_map import GraspRoom, MapConfig, ObstacleMap, map_from_frame, own_surroundings
from sim.views import look_at

CAMERA = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
T_WORLD_CAM = look_at(np.array([0.2, -1.0, 0.6]), np.array([0.7, 0.0, 0.3]))
# A block in front of the robot: middle and half sides, world.
MIDDLE, HALF = np.array([0.75, 0.0, 0.25]), np.array([0.15, 0.25, 0.25])


def depth_of_block(bar: bool = False) -> np.ndarray:
    """Exact depth (H, W) of the block on a floor at z = 0, with a thin bar before its face."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    rays_cam = CAMERA.back_project(np.stack([u, v], -1), np.ones_like(u))
    rays = rays_cam @ T_WORLD_CAM.rotation().matrix().T
    eye = T_WORLD_CAM.translation()
    with np.errstate(divide="ignore"):
        depth = np.where(rays[..., 2] < 0, -eye[2] / rays[..., 2], np.inf)
        boxes = [(MIDDLE, HALF)]
        if bar:  # 12 mm thick, as handles are, 5 cm before the face that looks at the robot
            boxes.append((np.array([0.55, 0.0, 0.35]), np.array([0.006, 0.08, 0.006])))
        for middle, half in boxes:
            a, b = (middle - half - eye) / rays, (middle + half - eye) / rays
            enter = np.minimum(a, b).max(axis=-1)
            leave = np.maximum(a, b).min(axis=-1)
            depth = np.where(enter < leave, np.minimum(depth, enter), depth)
    return np.where(depth < 8.0, depth, np.nan).astype(np.float32)


def frame(depth: np.ndarray) -> RgbdFrame:
    rgb = np.zeros((*depth.shape, 3), np.uint8)
    return RgbdFrame(0.1, rgb, depth, CAMERA, T_WORLD_CAM)


def mapped(depth: np.ndarray) -> ObstacleMap:
    return map_from_frame(frame(depth), Q_HOME, 0.0)


def seen(depth: np.ndarray) -> Obstacle:
    obstacle = mapped(depth).obstacle()
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


def test_a_bar_as_thin_as_a_handle_is_an_obstacle():
    bar = np.array([0.55, 0.0, 0.35])
    assert touches(seen(depth_of_block(bar=True)), bar, 1e-3)
    assert not touches(seen(depth_of_block()), bar, 1e-3)


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
    hand = np.array([0.55, 0.0, 0.58])  # the wrist at home is about here
    depth = depth_of_block()
    uv = CAMERA.project(T_WORLD_CAM.transformTo(hand)).round().astype(int)
    depth[uv[1] - 30 : uv[1] + 30, uv[0] - 30 : uv[0] + 30] = 0.5  # something before the arm
    near = np.linalg.norm(mapped(depth).p_world - hand, axis=1) < 0.03
    elsewhere = Q_HOME + np.array([2.0, 0, 0, 0, 0, 0, 0])
    away = map_from_frame(frame(depth), elsewhere, 0.0).obstacle()
    assert not near.any()
    assert away is not None and touches(away, np.array([0.5, 0.0, 0.55]), 0.2)


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
    edge = depth_of_block()  # from the near face to the far floor: the bridge is no wall between
    u, v = CAMERA.project(T_WORLD_CAM.transformTo(MIDDLE - [HALF[0], -HALF[1], 0.0])).astype(int)
    edge[v - 5 : v + 5, u - 20 : u + 10] = np.nan
    before = MIDDLE - [HALF[0] + 0.1, -HALF[1] - 0.1, 0.0]
    assert not touches(seen(edge), before, 0.02)


def test_what_lies_before_the_palm_is_left_out_for_the_hand():
    found = mapped(depth_of_block())
    face = MIDDLE - [HALF[0], 0.0, 0.0]
    R = gtsam.Rot3(np.array([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]]))  # z into the face
    room = GraspRoom(gtsam.Pose3(R, face - [0.03, 0.0, 0.0]), radius_m=0.14, ahead_m=0.04)
    points = face + np.array([[0, 0, 0], [0, 0.13, 0], [0, 0, 0.15], [-0.06, 0, 0], [-0.08, 0, 0]])
    np.testing.assert_array_equal(room.holds(points), [True, True, False, True, False])
    rest = found.obstacle(room)
    assert rest is not None and rest.geometry.size() < found.obstacle().geometry.size()
    assert ObstacleMap(face[None], 0.02).obstacle(room) is None


def test_the_robot_knows_the_floor_and_its_pedestal():
    (floor,) = own_surroundings(0.0)
    assert floor.T_world_obstacle.translation()[2] + floor.geometry.halfSide[2] == 0.0
    floor, pedestal = own_surroundings(-0.4)
    assert floor.T_world_obstacle.translation()[2] + floor.geometry.halfSide[2] == -0.4
    np.testing.assert_allclose(pedestal.geometry.halfSide, [0.15, 0.15, 0.2])
    np.testing.assert_allclose(pedestal.T_world_obstacle.translation(), [-0.05, 0.0, -0.2])
