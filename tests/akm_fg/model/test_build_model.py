"""Fitted recordings to models: what moves and what rests, in the closed pose."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.errors import InsufficientData
from akm_fg.model.build import FittedRecording, build_model
from akm_fg.model.config import ModelConfig
from akm_fg.model.part_views import spread_frames
from akm_fg.model.surface_cloud import View, averaged, believed, in_one_piece, readings
from akm_fg.perception.depth.depth_noise import DepthNoiseModel


def _off(points: np.ndarray, quads) -> np.ndarray:
    """Distances (N,) to the nearest of some rectangles."""
    off = []
    for quad in quads:
        T = quad.T_world_quad.inverse()
        local = points @ T.rotation().matrix().T + T.translation()
        beside = np.maximum(np.abs(local[:, :2]) - np.array(quad.half), 0)
        off.append(np.sqrt((beside**2).sum(axis=1) + local[:, 2] ** 2))
    return np.min(off, axis=0)


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_the_surfaces_are_those_of_the_closed_object(name, request) -> None:
    clip, model = request.getfixturevalue(name), request.getfixturevalue(f"{name}_model")
    rest, part = clip.scene.quads()
    (moving,) = (each.surface for each in model.parts)
    off = _off(moving.p_world, part)
    assert np.median(off) < 0.0015 and np.quantile(off, 0.99) < 0.008
    # The front of 0.56 x 0.6 m is known as a whole, not where it was when the recording ended.
    front = moving.p_world[np.abs(moving.p_world[:, 0] - 0.02) < 0.01]
    assert np.ptp(front[:, 1]) > 0.5 and np.ptp(front[:, 2]) > 0.55
    own = model.static.objects_own
    assert len(own) > 1000 and np.quantile(_off(own.p_world, rest), 0.95) < 0.012
    assert (own.p_world[:, 0] < 0.05).all()
    assert len(own) < len(model.static)


def test_normals_face_the_camera_and_colours_are_the_woods(door_model, door) -> None:
    surface = door_model.parts[0].surface
    front = np.abs(surface.p_world[:, 0] - 0.02) < 0.004
    assert np.median(surface.normal_world[front, 0]) > 0.99
    np.testing.assert_allclose(np.linalg.norm(surface.normal_world, axis=1), 1, atol=1e-9)
    np.testing.assert_allclose(surface.rgb[front].mean(axis=0), [170, 130, 90], atol=15)


def test_another_closed_state_turns_the_surface(fitted_door, door_model) -> None:
    opened = replace(fitted_door, closed_state=0.4)
    part = build_model(opened, config=ModelConfig(frames=4)).parts[0]
    T = door_model.parts[0].T_world_part(0.4)
    closed = door_model.parts[0].surface.p_world
    np.testing.assert_allclose(
        part.surface.p_world.mean(axis=0), T.transformFrom(closed.mean(axis=0)), atol=0.02
    )
    assert part.T_world_part(0.4).equals(gtsam.Pose3(), 1e-9)


def test_a_grasp_becomes_a_contact_in_the_parts_frame(fitted_door, door) -> None:
    held = gtsam.Pose3(gtsam.Rot3(), np.array([0.06, 0.2, 0.35]))
    poses = [door.scene.motion(float(q)) * held for q in door.states]
    recording = replace(door.recording, T_world_gripper=tuple(poses), grasp_frames=(3, 14))
    model = build_model(replace(fitted_door, recording=recording), config=ModelConfig(frames=3))
    (contact,) = model.parts[0].contacts
    assert contact.state == fitted_door.posterior.best.states.mean[3]
    assert (contact.succeeded, contact.failed) == (1, 0)
    np.testing.assert_allclose(contact.T_part_grasp.matrix(), held.matrix(), atol=0.01)


def test_a_hand_that_was_not_there_in_the_first_frame_is_no_part(door) -> None:
    frames = door.recording.frames
    first, later = frames[0], frames[-1]
    depth = later.depth_m.copy()
    hand = np.zeros(depth.shape, dtype=bool)
    hand[110:130, 150:170] = True
    depth[hand] = 0.9  # in front of everything
    config, noise = ModelConfig(), DepthNoiseModel()
    late = View(replace(later, depth_m=depth), gtsam.Pose3())
    surface = averaged([readings(late, hand, noise, config)], config.voxel_m)
    assert len(surface) > 100
    views = [View(first, gtsam.Pose3(), closed=True), late, late, late, late]
    assert believed(surface, views[1:], noise, config).mean() > 0.9
    assert not believed(surface, views, noise, config).any()


def test_nothing_that_moves_is_no_model(fitted_door) -> None:
    posterior = fitted_door.posterior
    rigid = replace(
        posterior,
        alternatives={"rigid": replace(posterior.best, joint=None, states=None)},
        kind_probability={"rigid": 1.0},
    )
    with pytest.raises(InsufficientData, match="nothing moves"):
        build_model(replace(fitted_door, posterior=rigid))
    with pytest.raises(InsufficientData, match="points of the part's surface"):
        build_model(fitted_door, config=ModelConfig(frames=2, least_points=10**6))


def test_a_posterior_of_other_frames_is_refused(fitted_door) -> None:
    frames = fitted_door.recording.frames
    short = replace(fitted_door.recording, frames=frames[:-1])
    with pytest.raises(ValueError, match=f"{len(frames)} states of {len(frames) - 1} frames"):
        build_model(replace(fitted_door, recording=short))


def test_more_recordings_of_a_part_add_to_its_surface(fitted_door) -> None:
    config = ModelConfig(frames=2)
    one = build_model(fitted_door, config=config)
    two = build_model(fitted_door, [FittedRecording(*_all_of(fitted_door))], config=config)
    assert two.sources == ("clip", "clip") and len(one.sources) == 1
    assert abs(len(two.parts[0].surface) - len(one.parts[0].surface)) < 0.05 * len(
        one.parts[0].surface
    )


def _all_of(fitted: FittedRecording):
    return fitted.recording, fitted.observed, fitted.posterior


def test_small_islands_are_no_part() -> None:
    front = np.random.default_rng(0).uniform(0, [0.4, 0.01, 0.4], (4000, 3))
    handle, island = front[:100] * 0.1 + [0.2, 0.03, 0.2], front[:100] * 0.1 + [0.2, 0.3, 0.2]
    kept = in_one_piece(np.concatenate([front, handle, island]), ModelConfig())
    assert kept[:4100].all() and not kept[4100:].any()
    assert in_one_piece(np.zeros((0, 3)), ModelConfig()).shape == (0,)


def test_frames_are_spread_over_the_states() -> None:
    q = np.array([np.nan, 0.0, 0.01, 0.01, np.nan, 0.1, 0.2, 0.3, 0.3])
    assert spread_frames(q, 4) == [1, 5, 6, 7]
    assert spread_frames(np.full(3, np.nan), 4) == []
    assert spread_frames(np.array([0.1, 0.0]), 5) == [0, 1]
