"""Bags as they come: compressed, two cameras, transforms that move, poses by topic, a gripper."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from akm_fg.errors import InputError
from akm_fg.io.sources.registry import open_prepared, read_source
from akm_fg.io.sources.source import SourceOptions
from akm_fg.records import PinholeCamera, Recording

pytest.importorskip("rosbags")
COLOUR, DEPTH, WORLD, HAND = "colour_optical", "depth_optical", "odom", "hand"
T_COLOUR_DEPTH = gtsam.Pose3(gtsam.Rot3.Ypr(0.02, -0.01, 0.015), np.array([-0.05, 0.004, 0.01]))


@pytest.fixture(scope="module")
def few(mm_door: Recording) -> Recording:
    return replace(mm_door, frames=mm_door.frames[:4])


def pictures(make, frame, depth=None):
    """Colour and registered depth of one frame, by the names that cameras use."""
    s = frame.stamp_s
    raw = np.nan_to_num(np.rint(1e3 * frame.depth_m.astype(float))).astype(np.uint16)
    yield "/cam/rgb/image_raw", s, make.image(s, COLOUR, frame.rgb, "rgb8")
    yield "/cam/rgb/camera_info", s, make.info(s, COLOUR, frame.camera)
    yield "/cam/depth_registered/image", s, make.image(s, COLOUR, raw, "16UC1")


@pytest.mark.parametrize("version", ["ros1", "ros2", "mcap"])
@pytest.mark.parametrize("encode", ["jpg", "png"])
def test_compressed_pictures(
    version: str, encode: str, write: dict, tmp_path: Path, few: Recording
) -> None:
    ending = ".bag" if version == "ros1" else ""
    path = write["bag"](tmp_path / f"a{ending}", version, write["entries"](few, encode))
    for frame, true in zip(read_source(path).frames, few.frames, strict=True):
        np.testing.assert_array_equal(frame.depth_m, true.depth_m)
        off = np.abs(frame.rgb.astype(int) - true.rgb)
        assert off.mean() < 2 if encode == "jpg" else off.max() == 0


def test_depth_in_metres_and_colour_in_bgr(write: dict, tmp_path: Path, few: Recording) -> None:
    def entries(make):
        for frame in few.frames:
            for topic, s, message in pictures(make, frame):
                if "depth" in topic:
                    message = make.image(s, COLOUR, frame.depth_m, "32FC1")
                if "image_raw" in topic:
                    bgr = np.ascontiguousarray(frame.rgb[..., ::-1])
                    message = make.image(s, COLOUR, bgr, "bgr8")
                yield topic, s, message

    prepared = open_prepared(write["bag"](tmp_path / "a", "ros2", entries))
    assert prepared.understood.depth_unit_m == 1.0 and prepared.depth_unit_m == 1e-4
    for (frame, _), true in zip(prepared.frames(), few.frames, strict=True):
        np.testing.assert_array_equal(frame.rgb, true.rgb)
        np.testing.assert_allclose(frame.depth_m, true.depth_m, rtol=1e-6)


def test_the_pose_of_a_moving_camera_is_between_its_transforms(
    write: dict, tmp_path: Path, walk: Recording
) -> None:
    """The base moves evenly; transforms come at other times than the pictures."""
    T_base_colour = gtsam.Pose3(gtsam.Rot3.RzRyRx(-1.5, 0.1, -1.6), np.array([0.1, 0.0, 0.4]))
    start = walk.frames[0].T_world_cam * T_base_colour.inverse()
    step = np.array([0.0, 0.0, 0.1, 0.3, 0.0, 0.0])
    frames = [
        replace(f, T_world_cam=start.retract(step * f.stamp_s) * T_base_colour, stamp_s=f.stamp_s)
        for f in walk.frames
    ]

    def entries(make):
        static = make.transform(0.0, "base", COLOUR, T_base_colour)
        yield "/tf_static", 0.0, make.tf(static)
        for s in np.arange(-0.05, 0.5, 0.04):
            T = start.retract(step * s)
            yield "/tf", max(s, 0.0), make.tf(make.transform(s + 5.0, WORLD, "base", T))
        for f in frames:
            yield from pictures(make, replace(f, stamp_s=f.stamp_s + 5.0))

    prepared = open_prepared(write["bag"](tmp_path / "a", "ros2", entries))
    for got, want in zip(prepared.places, frames, strict=True):
        np.testing.assert_allclose(got.matrix(), want.T_world_cam.matrix(), atol=1e-5)
    assert "tf from 'odom'" in prepared.understood.poses
    assert prepared.understood.moves[0] > 0.05


@pytest.mark.parametrize("kind", ["PoseStamped", "Odometry"])
def test_poses_by_topic(kind: str, write: dict, tmp_path: Path, few: Recording) -> None:
    T_base_colour = gtsam.Pose3(gtsam.Rot3.RzRyRx(-1.5, 0.1, -1.6), np.array([0.1, 0.0, 0.4]))

    def pose(make, T):
        p, q = T.translation(), T.rotation().toQuaternion()
        point = make.make("geometry_msgs/msg/Point", x=p[0], y=p[1], z=p[2])
        turn = make.make("geometry_msgs/msg/Quaternion", x=q.x(), y=q.y(), z=q.z(), w=q.w())
        return make.make("geometry_msgs/msg/Pose", position=point, orientation=turn)

    def entries(make):
        if kind == "Odometry":
            yield "/tf_static", 9.0, make.tf(make.transform(9.0, "base", COLOUR, T_base_colour))
        for frame in few.frames:
            yield from pictures(make, frame)
            s, header = frame.stamp_s, make.header(frame.stamp_s, WORLD)
            if kind == "PoseStamped":
                name, fields = "geometry_msgs/msg/PoseStamped", {}
                told = pose(make, frame.T_world_cam)
            else:
                name, six = "nav_msgs/msg/Odometry", np.zeros(36)
                T = frame.T_world_cam * T_base_colour.inverse()
                told = make.make(
                    "geometry_msgs/msg/PoseWithCovariance", pose=pose(make, T), covariance=six
                )
                zero = make.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
                still = make.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
                fields = {
                    "child_frame_id": "base",
                    "twist": make.make(
                        "geometry_msgs/msg/TwistWithCovariance", twist=still, covariance=six
                    ),
                }
            yield "/slam/pose", s, make.make(name, header=header, pose=told, **fields)

    path = write["bag"](tmp_path / "a", "ros2", entries)
    options = SourceOptions(pose_topic="/slam/pose")
    prepared = open_prepared(path, options)
    np.testing.assert_allclose(
        prepared.places[0].matrix(), few.frames[0].T_world_cam.matrix(), atol=1e-8
    )
    assert prepared.understood.poses == "poses of /slam/pose"
    with pytest.raises(InputError, match=r"no topic of poses '/other'; expected one of /slam"):
        open_prepared(path, SourceOptions(pose_topic="/other"))


def test_the_gripper_s_pose_and_the_world_are_frames_of_the_tree(
    write: dict, tmp_path: Path, few: Recording
) -> None:
    T_world_room = gtsam.Pose3(gtsam.Rot3.Rz(0.3), np.array([1.0, 2.0, 0.0]))
    hands = [gtsam.Pose3(gtsam.Rot3.Rx(0.1 * i), np.array([0.4, 0.1 * i, 0.5])) for i in range(4)]

    def entries(make):
        place = make.transform(9.0, "room", COLOUR, few.frames[0].T_world_cam)
        room = make.transform(9.0, "earth", "room", T_world_room)
        yield "/tf_static", 9.0, make.tf(place, room)
        for frame, T in zip(few.frames, hands, strict=True):
            s = frame.stamp_s
            yield "/tf", s, make.tf(make.transform(s, "room", HAND, T))
            yield from pictures(make, frame)

    path = write["bag"](tmp_path / "a.bag", "ros1", entries)
    recording = read_source(path, SourceOptions(gripper=HAND, world="room"))
    for got, want in zip(recording.T_world_gripper, hands, strict=True):
        np.testing.assert_allclose(got.matrix(), want.matrix(), atol=1e-9)
    rooted = read_source(path, SourceOptions(gripper=HAND))
    np.testing.assert_allclose(
        rooted.T_world_gripper[1].matrix(), (T_world_room * hands[1]).matrix(), atol=1e-9
    )
    with pytest.raises(InputError, match="no transforms from 'moon'"):
        read_source(path, SourceOptions(world="moon"))
    with pytest.raises(InputError, match="no transforms from the world to 'foot'"):
        read_source(path, SourceOptions(gripper="foot"))


def test_depth_of_another_camera_rate_and_distortion(
    write: dict, tmp_path: Path, few: Recording, render_view
) -> None:
    """Depth of half the size, from beside, at twice the rate, late by some milliseconds."""
    camera = PinholeCamera(200, 150, 190.0, 190.0, 99.5, 74.5)
    T_world_depth = few.frames[0].T_world_cam * T_COLOUR_DEPTH
    depth_m = render_view(camera, T_world_depth)
    raw = np.nan_to_num(np.rint(1e3 * depth_m), posinf=0).astype(np.uint16)

    def entries(make):
        yield (
            "/tf_static",
            9.0,
            make.tf(
                make.transform(9.0, WORLD, COLOUR, few.frames[0].T_world_cam),
                make.transform(9.0, COLOUR, DEPTH, T_COLOUR_DEPTH),
            ),
        )
        for frame in few.frames:
            for topic, s, message in pictures(make, frame):
                if "depth" not in topic:
                    yield topic, s, message
            for late in (0.008, 0.058):
                s = frame.stamp_s + late
                yield "/cam/depth/image_rect_raw", s, make.image(s, DEPTH, raw, "16UC1")
                yield "/cam/depth/camera_info", s, make.info(s, DEPTH, camera)

    prepared = open_prepared(write["bag"](tmp_path / "a", "ros2", entries))
    understood = prepared.understood
    assert understood.frames == 4 and understood.aligned and understood.reduction == 1
    np.testing.assert_allclose(understood.apart_ms, [8.0, 8.0], atol=0.1)
    frame, _ = next(iter(prepared.frames()))
    true = render_view(few.frames[0].camera, few.frames[0].T_world_cam)  # the door is closed
    both = np.isfinite(frame.depth_m) & np.isfinite(true)
    away = np.abs(frame.depth_m - true)[both]
    assert both.mean() > 0.8
    assert np.median(away) < 6e-4 and (away > 0.05).mean() < 0.02


def test_of_several_cameras_one_is_taken_and_said(
    write: dict, tmp_path: Path, few: Recording
) -> None:
    def entries(make):
        for frame in few.frames:
            for topic, s, message in pictures(make, frame):
                yield topic, s, message
                yield topic.replace("/cam/rgb", "/cam/left"), s, message

    path = write["bag"](tmp_path / "a", "ros2", entries)
    prepared = open_prepared(path)
    assert prepared.source.colour.name == "/cam/rgb/image_raw"
    assert "not from /cam/left/image_raw (--colour-topic)" in prepared.understood.notes[0]
    said = SourceOptions(colour_topic="/cam/left/image_raw")
    assert open_prepared(path, said).source.colour.name == "/cam/left/image_raw"
    with pytest.raises(InputError, match="has no depth topic '/cam/rgb/image_raw'"):
        open_prepared(path, SourceOptions(depth_topic="/cam/rgb/image_raw"))
