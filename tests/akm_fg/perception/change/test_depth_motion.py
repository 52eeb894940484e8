"""Motion from depth alone, on a rendered cabinet whose joint is known."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from akm_fg.perception.change.depth_change import depth_change, explained_share
from akm_fg.perception.change.depth_motion import DepthMotion, DepthMotionConfig, depth_motion
from akm_fg.perception.change.face_joints import FaceJointConfig, starts_from_faces
from akm_fg.perception.change.face_planes import FacePlanes
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import Recording
from akm_fg.steps import to_end

BACKGROUND = 0
NOISE = DepthNoiseModel()


def _object_mask(clip):
    return np.asarray(clip.labels[0] != BACKGROUND)


def _seen(clip) -> DepthMotion:
    found = to_end(depth_motion(clip.recording, _object_mask(clip), NOISE))
    assert found is not None
    return found


def _true_motion(clip, factor: float = 1.0):
    motions = [clip.scene.motion(factor * q) for q in clip.states]
    R = np.array([m.rotation().matrix() for m in motions])
    return R, np.array([m.translation() for m in motions]), np.ones(len(motions), dtype=bool)


def _off_line(point, through, axis):
    return np.linalg.norm(np.cross(point - through, axis))


@pytest.mark.parametrize("name", ["door", "door_behind_robot"])
def test_a_door_is_a_hinge_with_its_states(name, request):
    clip = request.getfixturevalue(name)
    found = _seen(clip)
    best = found.guesses[0]
    assert best.kind == "revolute"
    axis, origin = best.joint.T_world_joint[:3, 2], best.joint.T_world_joint[:3, 3]
    assert np.degrees(np.arccos(-axis[2])) < 2.0  # it opens about -z
    assert _off_line(origin, np.array(clip.scene.hinge), axis) < 0.03
    np.testing.assert_allclose(np.degrees(best.q), np.degrees(clip.states), atol=1.0)
    assert best.q[0] == 0
    assert found.explained[0] > 0.9


def test_a_drawer_slides_along_the_normal_of_its_front(drawer):
    best = _seen(drawer).guesses[0]
    assert best.kind == "prismatic"
    assert np.degrees(np.arccos(best.joint.T_world_joint[0, 2])) < 1.0
    np.testing.assert_allclose(best.q, drawer.states, atol=0.003)


def test_plain_fronts_are_no_harder(make_clip):
    clip = make_clip(0.15, 8, joint="prismatic", contrast=0.0)
    best = _seen(clip).guesses[0]
    assert best.kind == "prismatic"
    np.testing.assert_allclose(best.q, clip.states, atol=0.003)


def test_nothing_changed_is_no_motion(still):
    assert to_end(depth_motion(still.recording, _object_mask(still), NOISE)) is None


def test_noise_worse_than_told_is_no_motion(still, depth_noise_image):
    frames, rng, focal_px = [], np.random.default_rng(3), still.scene.focal_px
    for frame in still.frames:
        z = np.nan_to_num(frame.depth_m[::2, ::2], nan=1.0)
        extra = 3 * np.kron(depth_noise_image(rng, z, focal_px), np.ones((2, 2)))
        frames.append(replace(frame, depth_m=(frame.depth_m + extra).astype(np.float32)))
    recording = Recording("clip", tuple(frames))
    assert not to_end(depth_change(recording, _object_mask(still), NOISE)).nearer.any()
    assert to_end(depth_motion(recording, _object_mask(still), NOISE)) is None


def test_a_change_off_the_object_is_no_motion(still):
    frames = list(still.frames)
    passer_by = frames[-1].depth_m.copy()
    passer_by[60:180, 5:45] = 0.5
    frames[-1] = replace(frames[-1], depth_m=passer_by)
    mask = _object_mask(still)
    assert not mask[60:180, :50].any()
    assert to_end(depth_motion(Recording("clip", tuple(frames)), mask, NOISE)) is None


def test_states_below_the_noise_of_a_pixel_are_found(drawer, make_clip):
    slow = make_clip(0.004, 3, seed=5, joint="prismatic")  # 2 and 4 mm: no pixel tells
    frames, states = list(drawer.frames), drawer.states.copy()
    frames[1:3], states[1:3] = slow.frames[1:3], slow.states[1:3]
    found = to_end(depth_motion(Recording("clip", tuple(frames)), _object_mask(drawer), NOISE))
    assert found is not None
    assert not found.change.nearer[1:3].any()
    np.testing.assert_allclose(found.guesses[0].q[1:3], states[1:3], atol=0.001)


def test_a_frame_far_from_the_keyframes_is_found(drawer):
    order = [0, 3, 5, 10, 6, 7]  # the fourth is 14 cm out, halfway between keyframes at 4 and 10
    recording = Recording("clip", tuple(drawer.frames[i] for i in order))
    found = to_end(
        depth_motion(recording, _object_mask(drawer), NOISE, DepthMotionConfig(keyframes=2))
    )
    assert found is not None
    np.testing.assert_allclose(found.guesses[0].q, drawer.states[order], atol=0.003)


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_the_true_motion_explains_the_change_and_others_do_not(name, request):
    clip = request.getfixturevalue(name)
    change = to_end(depth_change(clip.recording, _object_mask(clip), NOISE))
    assert explained_share(change, *_true_motion(clip)) > 0.95
    for factor in (0.0, 0.5, 1.5):
        assert explained_share(change, *_true_motion(clip, factor)) < 0.75
    R, t, known = _true_motion(clip)
    assert np.isnan(explained_share(change, R, t, np.zeros_like(known)))


def test_that_nothing_moved_explains_no_change_however_long_it_stays(drawer):
    order = [0, 14, 14, 14, 14, 14]  # frames at the same state agree with one another
    recording = Recording("clip", tuple(drawer.frames[i] for i in order))
    change = to_end(depth_change(recording, _object_mask(drawer), NOISE))
    rest = np.tile(np.eye(3), (6, 1, 1)), np.zeros((6, 3)), np.ones(6, dtype=bool)
    assert explained_share(change, *rest) < 0.05


def test_changed_pixels_are_those_of_the_part(drawer):
    change = to_end(depth_change(drawer.recording, _object_mask(drawer), NOISE))
    part = drawer.labels[-1] == 2
    mask = change.mask(len(drawer.frames) - 1)
    assert mask.shape == part.shape
    assert (mask & part).sum() > 0.9 * mask.sum()
    assert (mask & part).sum() > 0.6 * part.sum()


def test_a_mask_of_another_size_is_refused(drawer):
    with pytest.raises(ValueError, match=r"mask \(10, 10\), expected"):
        to_end(depth_change(drawer.recording, np.ones((10, 10), dtype=bool), NOISE))


def _turned_faces(axis, pivot, angles):
    """Planes of a front through x = 0 that turns about a hinge."""
    R = [gtsam.Rot3.Rodrigues(axis * a).matrix() for a in angles]
    normals = np.array([M @ [1.0, 0, 0] for M in R])
    centres = np.array([M @ (np.array([0, 0, 0.3]) - pivot) + pivot for M in R])
    offsets = (normals * centres).sum(axis=1)
    points = tuple(c[None] for c in centres)
    frames = tuple(range(1, len(angles) + 1))
    return FacePlanes(frames, normals, offsets, centres, points, np.array([1.0, 0, 0]), 0.0)


def test_planes_meet_in_the_hinge_though_one_is_of_another_face():
    axis, pivot = np.array([0.0, 0, -1]), np.array([0.0, -0.3, 0.3])
    faces = _turned_faces(axis, pivot, [0.1, 0.2, 0.3, 0.4, 0.5])
    normal, offset = faces.normal.copy(), faces.offset.copy()
    normal[4], offset[4] = [0, 0, 1], 0.6  # the top, in the last
    starts = starts_from_faces(replace(faces, normal=normal, offset=offset), 6, FaceJointConfig())
    hinge = next(s.guess for s in starts if s.guess.kind == "revolute")
    np.testing.assert_allclose(hinge.joint.T_world_joint[:3, 2], axis, atol=1e-6)
    assert _off_line(hinge.joint.T_world_joint[:3, 3], pivot, axis) < 1e-6
    np.testing.assert_allclose(hinge.q, [0, 0.1, 0.2, 0.3, 0.4, 0.4], atol=1e-6)


def test_parallel_planes_are_no_hinge():
    faces = _turned_faces(np.array([0.0, 0, -1]), np.zeros(3), [0.0, 0.0])
    faces = replace(faces, offset=np.array([0.05, 0.1]), centre=np.eye(3)[[0, 0]] * [[0.05], [0.1]])
    (drawer,) = starts_from_faces(faces, 3, FaceJointConfig())
    assert drawer.guess.kind == "prismatic"
    np.testing.assert_allclose(drawer.guess.joint.T_world_joint[:3, 2], [1, 0, 0])
    np.testing.assert_allclose(drawer.guess.q, [0, 0.05, 0.1])
