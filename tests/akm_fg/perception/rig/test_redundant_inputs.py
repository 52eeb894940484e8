"""Inputs that contradict each other are named, and no kind is where the answer rests on them."""

from dataclasses import replace

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.errors import InsufficientData
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter
from akm_fg.perception.rig.depth_against_colour import DepthAgainstColourConfig, depth_lag
from akm_fg.perception.rig.gripper_place import place_doubts
from akm_fg.pipeline import fit_recording
from akm_fg.records import Recording

HANDLE = gtsam.Pose3(gtsam.Rot3(), np.array([0.06, 0.21, 0.35]))
OPENGL = gtsam.Pose3(gtsam.Rot3(np.diag([1.0, -1.0, -1.0])), np.zeros(3))


def held(clip, off=gtsam.Pose3(), turn_share: float = 1.0) -> Recording:  # noqa: B008  not changed
    """The clip with a gripper at the handle, off its place, turning with it or less."""
    poses = []
    for q in clip.states:
        T = clip.scene.motion(float(q)) * HANDLE
        R = gtsam.Rot3.Expmap(turn_share * gtsam.Rot3.Logmap(T.rotation()))
        poses.append(off * gtsam.Pose3(R, T.translation()))
    n = len(poses)
    return replace(clip.recording, T_world_gripper=tuple(poses), grasp_frames=(0, n - 1))


def with_camera(recording: Recording, change) -> Recording:
    frames = (replace(f, T_world_cam=change(f.T_world_cam)) for f in recording.frames)
    return replace(recording, frames=tuple(frames))


def with_depth(recording: Recording, scale: float = 1.0, late: int = 0) -> Recording:
    last = len(recording.frames) - 1
    depths = [recording.frames[min(max(i - late, 0), last)].depth_m for i in range(last + 1)]
    pairs = zip(recording.frames, depths, strict=True)
    frames = (replace(f, depth_m=(scale * z).astype(np.float32)) for f, z in pairs)
    return replace(recording, frames=tuple(frames))


@pytest.fixture(scope="module")
def swung(make_clip):
    """A door that swings so fast that its edges pass whole pixels."""
    return make_clip(0.6, 15)


@pytest.mark.parametrize("name", ("door", "drawer"))
@pytest.mark.parametrize("turn_share", (1.0, 0.0))
def test_a_gripper_that_holds_the_part_is_not_doubted(name, turn_share, request) -> None:
    clip = request.getfixturevalue(name)
    posterior = fit_recording(held(clip, turn_share=turn_share)).posterior
    assert posterior.kind == clip.scene.joint
    assert not posterior.fit.warnings


MISTAKES = {
    "inverted": (lambda T: T.inverse(), "T_world_cam is likely inverted: it should"),
    "OpenGL": (lambda T: T * OPENGL, "T_world_cam is likely in OpenGL's axes"),
    "both": (lambda T: (T * OPENGL).inverse(), "inverted and in OpenGL's axes"),
    "millimetres": (
        lambda T: gtsam.Pose3(T.rotation(), 1e3 * T.translation()),
        "T_world_cam is likely in millimetres",
    ),
}


@pytest.mark.parametrize("name", ("door", "drawer"))
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_wrong_camera_pose_is_named(name, mistake: str, request) -> None:
    change, words = MISTAKES[mistake]
    recording = with_camera(held(request.getfixturevalue(name)), change)
    posterior = fit_recording(recording).posterior
    assert posterior.kind == "undecided"
    assert any(words in warning for warning in posterior.fit.warnings)


def test_a_gripper_in_millimetres_is_named(door) -> None:
    right = held(door)
    assert right.T_world_gripper is not None
    large = [gtsam.Pose3(T.rotation(), 1e3 * T.translation()) for T in right.T_world_gripper]
    wrong = replace(right, T_world_gripper=tuple(large))
    (doubt,) = place_doubts(wrong, DepthObjectSegmenter().segment(door.frames[0]))
    assert "T_world_gripper is likely in millimetres" in doubt.text


def test_a_gripper_a_metre_away_from_the_part_is_said(door) -> None:
    away = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 1.0, 0.0]))
    posterior = fit_recording(held(door, away)).posterior
    assert posterior.kind == "undecided"
    assert any("m from the object; expected" in w for w in posterior.fit.warnings)


def test_a_gripper_that_goes_another_way_is_said(door) -> None:
    sideways = (np.array([0.0, 0.015 * i, 0.0]) for i in range(15))
    poses = tuple(HANDLE * gtsam.Pose3(gtsam.Rot3(), t) for t in sideways)
    posterior = fit_recording(replace(held(door), T_world_gripper=poses)).posterior
    assert posterior.kind == "undecided"
    assert any("apart; expected a gripper that holds the part" in w for w in posterior.fit.warnings)


def test_a_gripper_that_turns_otherwise_is_said(drawer) -> None:
    turning = [
        gtsam.Pose3(gtsam.Rot3.Rz(0.04 * i), T.translation())
        for i, T in enumerate(held(drawer).T_world_gripper or ())
    ]
    recording = replace(held(drawer), T_world_gripper=tuple(turning))
    posterior = fit_recording(recording).posterior
    assert posterior.kind == "undecided"
    assert any("the gripper turns by 32 deg and the part by 0" in w for w in posterior.fit.warnings)


@pytest.mark.parametrize("scale", (0.001, 1000.0))
def test_a_wrong_unit_of_depth_is_named(door, scale: float) -> None:
    recording = with_depth(door.recording, scale)
    try:
        posterior = fit_recording(recording).posterior
    except InsufficientData as error:
        said = str(error)
    else:
        assert posterior.kind == "undecided"
        said = "; ".join(posterior.fit.warnings)
    assert "the unit of depth (depth_unit_m) is likely wrong" in said


@pytest.mark.parametrize("late", (-1, 0, 1, 2))
def test_the_lag_of_depth_is_found(swung, late: int) -> None:
    frames = with_depth(swung.recording, late=late).frames
    assert depth_lag(frames, DepthAgainstColourConfig()) == late


def test_depth_that_is_a_frame_late_is_named(swung, fit_of) -> None:
    posterior = fit_recording(with_depth(swung.recording, late=1)).posterior
    assert posterior.kind == "undecided"
    assert any(w.startswith("depth is 1 frame late") for w in posterior.fit.warnings)
    assert not fit_of(swung).posterior.fit.warnings


def test_a_seam_between_depth_and_colour_is_no_lag(swung) -> None:
    """Depth that is too wide by three pixels on all sides, as windows of stereo make it."""
    side = np.ones((7, 7), np.uint8)
    frames = [
        replace(f, depth_m=cv2.erode(np.nan_to_num(f.depth_m, nan=9.0), side)) for f in swung.frames
    ]
    assert not depth_lag(frames, DepthAgainstColourConfig())
