from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from sim.bullet import load_urdf, p, quiet
from sim.camera.camera import CameraConfig
from sim.camera.mirror import LocalScene, bodies_of, poses_of, shapes_of
from sim.episode import SimEpisode, open_world


@pytest.fixture(scope="module")
def episode() -> Iterator[SimEpisode]:
    with open_world("door", seed=0, noise="clean") as opened:
        yield opened


@pytest.fixture(scope="module")
def oven() -> Iterator[SimEpisode]:
    """A drawer under an oven, whose window stands still."""
    with open_world("furniture-dev/drawer-005", seed=0, noise="d455") as opened:
        yield opened


def all_in_one_picture(episode: SimEpisode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """RGB, depth and where the robot is, drawn afresh: what moves and what stands still."""
    world, camera = episode.world, episode.camera
    with quiet():
        client = p.connect(p.DIRECT)
    for urdf, T_world_body in world.still:
        load_urdf(client, urdf, T_world_body)
    still = shapes_of(client, bodies_of(client))
    moving = shapes_of(world.client, bodies_of(world.client))
    poses = poses_of(client, still) + poses_of(world.client, moving)
    p.disconnect(physicsClientId=client)
    scene = LocalScene()
    scene.show(still + moving)
    picture = scene.draw(poses, camera.config.shot(camera.T_world_cam))
    scene.close()
    robot = [len(still) + i for i, shape in enumerate(moving) if shape.body == world.robot_id]
    return picture.rgb, picture.depth_m, np.isin(picture.body, robot)


def test_pixels_of_the_robot_carry_no_depth(episode: SimEpisode):
    frame = episode.camera.capture()
    robot = all_in_one_picture(episode)[2]
    assert robot.sum() > 5000
    assert np.isnan(frame.depth_m[robot]).all()


def test_the_front_keeps_most_of_its_depth(episode: SimEpisode):
    frame = episode.camera.capture()
    T = episode.world.placement.T_world_object
    spec = episode.world.spec
    x = np.linspace(-0.4, 0.4, 20) * spec.size_m[0]
    z = spec.size_m[2] - np.linspace(0.1, 0.9, 20) * spec.front_height_m
    front = np.array([[a, -spec.size_m[1] / 2, b] for a in x for b in z])
    p_cam = (
        front @ T.rotation().matrix().T + T.translation() - frame.T_world_cam.translation()
    ) @ frame.T_world_cam.rotation().matrix()
    uv = frame.camera.project(p_cam)
    i = uv.round().astype(int)
    assert (i >= 0).all() and (i < [frame.camera.width, frame.camera.height]).all()
    error = frame.depth_m[i[:, 1], i[:, 0]] - p_cam[:, 2]
    assert (np.abs(error) < 0.004).mean() > 0.8
    assert frame.rgb[i[:, 1], i[:, 0]].astype(float).std(axis=0).mean() > 8.0  # textured


def test_drawing_what_stands_still_once_changes_no_pixel(oven: SimEpisode):
    world, camera = oven.world, oven.camera
    p.resetJointState(world.object_id, world.part_joint, 0.2, physicsClientId=world.client)
    rgb, depth = camera.exact()
    assert np.isnan(depth).mean() < 0.5
    rgb_at_once, depth_at_once, _ = all_in_one_picture(oven)
    np.testing.assert_array_equal(rgb, rgb_at_once)
    np.testing.assert_array_equal(depth, depth_at_once)


def test_a_picture_shows_the_part_where_it_is_now_and_bodies_that_came_later():
    with open_world("drawer", seed=1, noise="clean") as opened:
        world, camera = opened.world, opened.camera
        closed = camera.exact()[1]
        p.resetJointState(world.object_id, world.part_joint, 0.2, physicsClientId=world.client)
        opened_m = camera.exact()[1]
        p.setJointMotorControl2(
            world.object_id,
            world.part_joint,
            p.VELOCITY_CONTROL,
            targetVelocity=1.0,
            force=1e4,
            physicsClientId=world.client,
        )
        for _ in range(20):
            world.step()
        gained_m = world.part_state() - 0.2
        assert gained_m > 0.01
        after = camera.exact()[1]
        # The front faces the camera askew: depth shrinks by the share of the way that goes there.
        front = np.isfinite(opened_m) & (closed - opened_m > 0.05) & (opened_m - after > 0.0)
        axis = world.truth().axis @ camera.T_world_cam.rotation().matrix()
        normal = -axis  # of the front, in the camera; depth along z at a fixed pixel
        v, u = np.nonzero(front)
        c = camera.intrinsics
        rays = np.stack([(u - c.cx) / c.fx, (v - c.cy) / c.fy, np.ones(len(u))], axis=-1)
        nearer = gained_m / np.abs(rays @ normal)
        error = (opened_m - after)[front] - nearer
        assert np.median(np.abs(error)) < 1e-5
        ball = p.createVisualShape(p.GEOM_SPHERE, radius=0.05, physicsClientId=world.client)
        where = camera.T_world_cam.transformFrom(np.array([0.0, 0.0, 0.5]))
        p.createMultiBody(0, -1, ball, where.tolist(), physicsClientId=world.client)
        np.testing.assert_allclose(
            camera.exact()[1][239, 320], 0.45, atol=3e-3
        )  # a ball of triangles


def test_a_window_that_stands_still_and_a_handle_that_moves_are_shiny(oven: SimEpisode):
    surface = oven.camera._exact()[0]
    lost = np.isnan(oven.camera.capture().depth_m)
    window, handle = surface.specular > 0.8, (surface.specular > 0.5) & (surface.specular < 0.8)
    assert window.sum() > 2000 and 50 < handle.sum() < 2000
    assert lost[window].mean() > 0.7
    assert lost[surface.specular == 0.0].mean() < 0.3  # edges, and the robot's own pixels


HASHED = """
import hashlib
from sim.bullet import p
from sim.episode import open_world

def seen() -> str:
    digest = hashlib.sha256()
    with open_world("drawer", seed=3, noise="harsh") as e:
        for q in (0.0, 0.1):
            where = {"physicsClientId": e.world.client}
            p.resetJointState(e.world.object_id, e.world.part_joint, q, **where)
            frame = e.camera.capture()
            digest.update(frame.rgb.tobytes() + frame.depth_m.tobytes())
    return digest.hexdigest()
"""


def test_the_same_seed_gives_the_same_bytes_in_two_processes():
    here: dict = {}
    exec(HASHED, here)
    command = [sys.executable, "-c", HASHED + "\nprint(seen())"]
    there = subprocess.run(command, capture_output=True, text=True, check=True)
    assert here["seen"]() == there.stdout.strip()


def test_another_seed_gives_other_noise_of_the_same_scene(episode: SimEpisode):
    from sim.camera.camera import SimCamera

    frames = []
    for seed in (1, 2):
        camera = SimCamera(
            episode.world, episode.camera.T_world_cam, seed, CameraConfig().scaled(0.5)
        )
        frames.append(camera.capture())
        camera.close()
    assert (frames[0].depth_m != frames[1].depth_m).mean() > 0.5


def test_noise_keeps_the_image_range_and_the_clean_level_adds_none(episode: SimEpisode):
    a, b = episode.camera.capture(), episode.camera.capture()
    np.testing.assert_array_equal(a.rgb, b.rgb)
    np.testing.assert_array_equal(a.depth_m, b.depth_m)
