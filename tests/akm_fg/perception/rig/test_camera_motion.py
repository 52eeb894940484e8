"""A camera that moves is seen on what stands still, and no kind is named then."""

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest

from akm_fg.errors import InsufficientData
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter
from akm_fg.perception.rig.camera_motion import CameraMotionConfig, StillCamera
from akm_fg.pipeline import fit_recording
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import Recording
from tests.akm_fg.conftest import Cabinet

N = 12
OPENING = np.linspace(0, np.deg2rad(35), N)
CLOSED = np.zeros(N)
NUDGE_RAD = np.deg2rad(0.2)


def step(turn=(0.0, 0.0, 0.0), at: int = N // 2) -> list[gtsam.Pose3]:
    """Still, and then turned."""
    turned = gtsam.Pose3(gtsam.Rot3.Expmap(np.array(turn)), np.zeros(3))
    return [gtsam.Pose3()] * at + [turned] * (N - at)


def way(end, share=np.linspace(0, 1, N)) -> list[gtsam.Pose3]:  # noqa: B008  not changed
    """Along a line, at these shares of it."""
    return [gtsam.Pose3(gtsam.Rot3(), s * np.array(end)) for s in share]


def hand_held(seed: int) -> list[gtsam.Pose3]:
    """A hand's tremble of some centimetres and degrees."""
    walk = np.random.default_rng(seed).normal(scale=0.01, size=(N, 6)).cumsum(axis=0)
    return [gtsam.Pose3.Expmap(xi - walk[0]) for xi in walk]


SWAY = np.sin(np.arange(N) / 2)
MOVING = {
    "a tripod nudged sideways": (CLOSED, step((0.0, NUDGE_RAD, 0.0))),
    "a tripod nudged up": (OPENING, step((NUDGE_RAD, 0.0, 0.0))),
    "a tripod that sinks at the end": (OPENING, step((NUDGE_RAD, 0.0, 0.0), at=N - 3)),
    "a dolly forwards": (CLOSED, way((0.0, 0.0, 0.1))),
    "a dolly sideways": (CLOSED, way((0.1, 0.0, 0.0))),
    "sway sideways": (OPENING, way((0.003, 0.0, 0.0), SWAY)),
    "sway upwards": (OPENING, way((0.0, 0.003, 0.0), SWAY)),
    "a hand": (CLOSED, hand_held(0)),
    "another hand": (OPENING, hand_held(1)),
}


def watched(recording: Recording) -> StillCamera:
    first = recording.frames[0]
    return StillCamera(first, DepthObjectSegmenter().segment(first), DepthNoiseModel())


def without_colour(recording: Recording) -> Recording:
    frames = tuple(replace(f, rgb=np.zeros_like(f.rgb)) for f in recording.frames)
    return replace(recording, frames=frames)


@pytest.mark.parametrize("case", MOVING)
def test_a_camera_that_moves_is_named_and_no_kind_is(film, case: str) -> None:
    states, moved = MOVING[case]
    posterior = fit_recording(film(Cabinet(), states, moved, told=False)).posterior
    assert posterior.kind == "undecided"
    (warning,) = (w for w in posterior.fit.warnings if w.startswith("the camera moved"))
    assert "expected a camera that stands still" in warning
    if "nudged" in case:
        assert f"from frame {N // 2} on" in warning


def opened(joint: str) -> np.ndarray:
    """(N,) states of a cabinet that is opened."""
    return OPENING if joint == "revolute" else np.linspace(0, 0.2, N)


@pytest.fixture(scope="module")
def of_fixed_camera(film):
    """The answer before a camera that stands still: of_fixed_camera(joint)."""

    @cache
    def fit(joint: str) -> ArticulationPosterior:
        recording = film(Cabinet(joint), opened(joint), way((0.0, 0.0, 0.0)), told=False)
        return fit_recording(recording).posterior

    return fit


@pytest.mark.parametrize("joint", ("revolute", "prismatic"))
def test_a_camera_that_stands_still_is_not_doubted(of_fixed_camera, joint: str) -> None:
    posterior = of_fixed_camera(joint)
    assert posterior.kind == joint
    assert not posterior.fit.warnings


def test_an_arm_before_the_camera_is_no_motion_of_it(door_behind_robot) -> None:
    frames = dict(enumerate(door_behind_robot.frames))
    assert watched(door_behind_robot.recording).motion(frames) is None


def test_a_door_that_fills_the_picture_is_no_motion_of_the_camera(film) -> None:
    scene = Cabinet(eye=(0.7, 0.0, 0.4), target=(0.0, 0.0, 0.36))
    recording = film(scene, OPENING, way((0.0, 0.0, 0.0)), told=False)
    assert watched(recording).motion(dict(enumerate(recording.frames))) is None


@pytest.mark.parametrize("far_m", (0.0, 0.1))
def test_without_colours_depth_tells(film, far_m: float) -> None:
    recording = film(Cabinet(), OPENING, way((0.0, 0.0, far_m)), told=False)
    dark = without_colour(recording)
    motion = watched(dark).motion(dict(enumerate(dark.frames)))
    assert (motion is not None) == (far_m > 0)


def test_the_shift_is_measured(film) -> None:
    recording = film(Cabinet(), CLOSED, way((0.004, 0.0, 0.0)), told=False)
    found = watched(recording).shift(N - 1, recording.frames[-1])
    assert found is not None and found.moved
    assert 0.002 < found.off_m < 0.0045  # the wall is farther than the object


def test_poses_that_are_told_are_held_against_the_pictures(film) -> None:
    moved = way((0.05, 0.0, 0.02))
    told = film(Cabinet(), CLOSED, moved, told=True)
    assert watched(told).motion(dict(enumerate(told.frames))) is None
    late = [
        replace(f, T_world_cam=told.frames[max(i - 2, 0)].T_world_cam)
        for i, f in enumerate(told.frames)
    ]
    motion = watched(told).motion(dict(enumerate(late)))
    assert motion is not None
    assert "expected T_world_cam to be the camera's pose in every frame" in motion.doubt().text


def turning(seed: int) -> list[gtsam.Pose3]:
    """A way of 15 cm with a turn of 10 deg, or a hand's tremble."""
    share = np.linspace(0, 1, N)
    if seed == 0:
        return [
            gtsam.Pose3(gtsam.Rot3.Ry(-0.17 * s), np.array([0.15, 0.02, 0.1]) * s) for s in share
        ]
    return hand_held(seed)


@pytest.mark.parametrize("joint", ("revolute", "prismatic"))
@pytest.mark.parametrize("seed", (0, 1))
def test_a_moving_camera_whose_poses_are_told_gives_the_fixed_cameras_answer(
    film, of_fixed_camera, joint: str, seed: int
) -> None:
    states, fixed = opened(joint), of_fixed_camera(joint)
    moving = fit_recording(film(Cabinet(joint), states, turning(seed), told=True)).posterior
    assert moving.kind == fixed.kind == joint
    assert not moving.fit.warnings
    a, b = fixed.best.joint, moving.best.joint
    sd_rad = np.hypot(a.axis_sd_rad, b.axis_sd_rad)
    assert np.linalg.norm(a.axis - b.axis) < 3 * sd_rad and sd_rad < np.deg2rad(0.15)
    if a.pivot is not None:
        off_m = np.linalg.norm(np.cross(a.pivot - b.pivot, a.axis))
        assert off_m < 3 * np.hypot(a.pivot_sd_m, b.pivot_sd_m) < 0.003
    q, sd = moving.best.states.mean[-1], moving.best.states.sd[-1]
    assert abs(q - states[-1]) < 4 * sd


@pytest.mark.parametrize("joint", ("revolute", "prismatic"))
@pytest.mark.parametrize("seed", (0, 1, pytest.param(2, marks=pytest.mark.slow)))
def test_of_a_plain_part_before_a_moving_camera_nothing_is_claimed(
    film, joint: str, seed: int
) -> None:
    recording = film(Cabinet(joint, contrast=0.0), opened(joint), turning(seed), told=True)
    try:
        posterior = fit_recording(recording).posterior
    except InsufficientData:
        return
    assert posterior.kind == "undecided"
    assert any("before a camera that moves" in w for w in posterior.fit.warnings)


def test_of_frames_that_go_on_few_are_compared_that_were_not_before(
    door_behind_robot, monkeypatch
) -> None:
    compared = []
    by_corners = StillCamera._by_corners

    def counted(camera, frame):
        compared.append(frame.stamp_s)
        return by_corners(camera, frame)

    monkeypatch.setattr(StillCamera, "_by_corners", counted)
    config = CameraMotionConfig(frames=5)
    frames = door_behind_robot.frames
    first = frames[0]
    mask = DepthObjectSegmenter().segment(first)
    still = StillCamera(first, mask, DepthNoiseModel(), config)
    assert len(frames) >= 14
    still.motion(dict(enumerate(frames[:12])))
    assert len(compared) == 4
    still.motion(dict(enumerate(frames[:14])))
    assert len(compared) == 5, "the new end alone"
