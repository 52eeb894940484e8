"""A door as recordings of many formats, each written by the format's own library."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import gtsam
import numpy as np
import pytest

from akm_fg.records import Recording

COLOUR_FRAME, DEPTH_FRAME = "camera_color_optical_frame", "camera_depth_optical_frame"


@pytest.fixture(scope="session")
def mm_door(door) -> Recording:
    """The rendered door, its depth in whole millimetres: what every format can hold exactly."""
    frames = []
    for frame in door.frames:
        depth_m = (np.rint(frame.depth_m.astype(np.float64) * 1e3) * 1e-3).astype(np.float32)
        frames.append(replace(frame, depth_m=depth_m, stamp_s=frame.stamp_s + 1000.0))
    return Recording("door", tuple(frames))


def millimetres(frame) -> np.ndarray:
    return np.nan_to_num(np.rint(frame.depth_m.astype(np.float64) * 1e3), nan=0).astype(np.uint16)


def intrinsics_json(camera) -> dict:
    K = [camera.fx, 0, 0, 0, camera.fy, 0, camera.cx, camera.cy, 1]
    return {"width": camera.width, "height": camera.height, "intrinsic_matrix": K}


def write_picture(path: Path, rgb: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR) if rgb.ndim == 3 else rgb
    path.write_bytes(encoded(path.suffix, image))


def encoded(ending: str, image: np.ndarray) -> bytes:
    settings = [cv2.IMWRITE_JPEG_QUALITY, 100] if ending == ".jpg" else []
    done, data = cv2.imencode(ending, image, settings)
    assert done
    return data.tobytes()


def write_tum(folder: Path, recording: Recording, ending: str = "png", unit: float = 5.0) -> Path:
    """As the benchmark's description has it: there is no library that writes it."""
    folder.mkdir(parents=True)
    rgb, depth, poses = [], [], []
    for frame in recording.frames:
        name = f"{frame.stamp_s:.6f}"
        write_picture(folder / "rgb" / f"{name}.{ending}", frame.rgb)
        write_picture(folder / "depth" / f"{name}.png", (millimetres(frame) * unit).astype("u2"))
        rgb.append(f"{name} rgb/{name}.{ending}")
        depth.append(f"{name} depth/{name}.png")
        p, q = frame.T_world_cam.translation(), frame.T_world_cam.rotation().toQuaternion()
        numbers = (*p, q.x(), q.y(), q.z(), q.w())
        poses.append(f"{name} " + " ".join(f"{x:.12f}" for x in numbers))
    head = "# a comment\n# timestamp filename\n"
    for name, rows in (("rgb", rgb), ("depth", depth), ("groundtruth", poses)):
        (folder / f"{name}.txt").write_text(head + "\n".join(rows) + "\n")
    camera = recording.frames[0].camera
    (folder / "camera.json").write_text(json.dumps(intrinsics_json(camera)))
    return folder


def write_redwood(folder: Path, recording: Recording, ending: str = "png") -> Path:
    """By Open3D."""
    import open3d as o3d

    (folder / "color").mkdir(parents=True)
    (folder / "depth").mkdir()
    c = recording.frames[0].camera
    intrinsic = o3d.camera.PinholeCameraIntrinsic(c.width, c.height, c.fx, c.fy, c.cx, c.cy)
    o3d.io.write_pinhole_camera_intrinsic(str(folder / "camera.json"), intrinsic)
    trajectory, places = o3d.camera.PinholeCameraTrajectory(), []
    for i, frame in enumerate(recording.frames):
        colour, depth = o3d.geometry.Image(frame.rgb), o3d.geometry.Image(millimetres(frame))
        o3d.io.write_image(str(folder / "color" / f"{i:06d}.{ending}"), colour)
        o3d.io.write_image(str(folder / "depth" / f"{i:06d}.png"), depth)
        place = o3d.camera.PinholeCameraParameters()
        place.intrinsic, place.extrinsic = intrinsic, frame.T_world_cam.inverse().matrix()
        places.append(place)
    trajectory.parameters = places
    o3d.io.write_pinhole_camera_trajectory(str(folder / "trajectory.log"), trajectory)
    return folder


class BagMessages:
    """Messages of one version of ROS."""

    def __init__(self, ros1: bool) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        name = "tf2_msgs/msg/TFMessage"
        if name not in self.store.types:
            text = "geometry_msgs/TransformStamped[] transforms\n"
            self.store.register(get_types_from_msg(text, name))

    def make(self, name: str, **fields):
        return self.store.types[name](**fields)

    def stamp(self, stamp_s: float):
        whole = int(np.floor(stamp_s))
        nano = round(1e9 * (stamp_s - whole))
        return self.make("builtin_interfaces/msg/Time", sec=whole, nanosec=nano)

    def header(self, stamp_s: float, frame: str):
        fields = {"stamp": self.stamp(stamp_s), "frame_id": frame}
        if self.ros1:
            fields["seq"] = 0
        return self.make("std_msgs/msg/Header", **fields)

    def image(self, stamp_s: float, frame: str, image: np.ndarray, encoding: str):
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(stamp_s, frame),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=image.strides[0],
            data=np.frombuffer(image.tobytes(), np.uint8),
        )

    def compressed(self, stamp_s: float, frame: str, data: bytes, how: str):
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(stamp_s, frame),
            format=how,
            data=np.frombuffer(data, np.uint8),
        )

    def info(self, stamp_s: float, frame: str, camera, distortion=()):
        K = [camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1]
        P = [camera.fx, 0, camera.cx, 0, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0]
        numbers = {"d": distortion or (0.0,) * 5, "k": K, "r": np.eye(3).ravel(), "p": P}
        names = {n.upper() if self.ros1 else n: np.array(v, float) for n, v in numbers.items()}
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False,
        )  # fmt: skip
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_s, frame),
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=roi,
            **names,
        )

    def transform(self, stamp_s: float, parent: str, child: str, T):
        p, q = T.translation(), T.rotation().toQuaternion()
        return self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp_s, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", x=p[0], y=p[1], z=p[2]),
                rotation=self.make(
                    "geometry_msgs/msg/Quaternion", x=q.x(), y=q.y(), z=q.z(), w=q.w()
                ),
            ),
        )

    def tf(self, *transforms):
        return self.make("tf2_msgs/msg/TFMessage", transforms=list(transforms))


def write_bag(path: Path, version: str, entries) -> Path:
    """entries: (topic, stamp_s, message) by `BagMessages(version == "ros1")`."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    messages = BagMessages(version == "ros1")
    if version == "ros1":
        writer = Writer1(path)
        raw = messages.store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if version == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
        raw = messages.store.serialize_cdr
    with writer:
        connections = {}
        for topic, stamp_s, message in entries(messages):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            writer.write(connections[topic], round(1e9 * (stamp_s + 1)), raw(message, kind))
    return path


def bag_entries(recording: Recording, encode: str = "raw"):
    """The recording as topics of a camera whose place is told by tf."""

    def entries(make: BagMessages):
        first = recording.frames[0]
        tf = make.transform(first.stamp_s, "world", COLOUR_FRAME, first.T_world_cam)
        yield "/tf_static", first.stamp_s, make.tf(tf)
        for frame in recording.frames:
            s = frame.stamp_s
            depth = millimetres(frame)
            base = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
            if encode == "raw":
                yield base[0], s, make.image(s, COLOUR_FRAME, frame.rgb, "rgb8")
                yield base[1], s, make.image(s, COLOUR_FRAME, depth, "16UC1")
            else:
                bgr = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR)
                data = encoded(f".{encode}", bgr)
                how = f"rgb8; {'jpeg' if encode == 'jpg' else 'png'} compressed bgr8"
                rgb = make.compressed(s, COLOUR_FRAME, data, how)
                yield f"{base[0]}/compressed", s, rgb
                data = bytes(12) + encoded(".png", depth)
                how = "16UC1; compressedDepth png"
                packed = make.compressed(s, COLOUR_FRAME, data, how)
                yield f"{base[1]}/compressedDepth", s, packed
            yield "/camera/color/camera_info", s, make.info(s, COLOUR_FRAME, frame.camera)

    return entries


def write_ros1(path: Path, recording: Recording) -> Path:
    return write_bag(path.with_suffix(".bag"), "ros1", bag_entries(recording))


def write_ros2(path: Path, recording: Recording) -> Path:
    return write_bag(path, "ros2", bag_entries(recording))


def write_mcap(path: Path, recording: Recording) -> Path:
    """The file alone, as it is handed around."""
    (file,) = write_bag(path, "mcap", bag_entries(recording, "png")).glob("*.mcap")
    return file


def write_video(folder: Path, recording: Recording, codec: str = "ffv1") -> Path:
    """By FFmpeg, without loss."""
    from fractions import Fraction

    import av

    folder.mkdir(parents=True)
    first = recording.frames[0]
    with av.open(str(folder / "colour.mkv"), "w") as container:
        stream = container.add_stream(codec, rate=10)
        stream.width, stream.height = first.camera.width, first.camera.height
        stream.pix_fmt = "bgr0" if codec == "ffv1" else "yuv420p"
        stream.time_base = Fraction(1, 10)
        for i, frame in enumerate(recording.frames):
            picture = av.VideoFrame.from_ndarray(frame.rgb, format="rgb24")
            picture.pts, picture.time_base = i, Fraction(1, 10)
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    c = first.camera
    np.savez_compressed(
        folder / "depth.npz",
        depth=np.stack([millimetres(frame) for frame in recording.frames]),
        K=np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1.0]]),
        T_world_cam=first.T_world_cam.matrix(),
    )
    return folder


def write_r3d(path: Path, recording: Recording, reduced: int = 1, quality: int = 100) -> Path:
    """As Record3D exports it: JPEG, depth in metres by LZFSE, ARKit's poses with y up."""
    import zipfile

    import liblzfse

    path, frames = path.with_suffix(".r3d"), recording.frames
    c, times = frames[0].camera, [frame.stamp_s for frame in frames]
    y_up = gtsam.Pose3(gtsam.Rot3(np.array([[0, 1.0, 0], [0, 0, 1.0], [1.0, 0, 0]])), np.zeros(3))
    gl = gtsam.Pose3(gtsam.Rot3(np.diag([1.0, -1.0, -1.0])), np.zeros(3))
    rows = []
    for frame in frames:
        T = y_up * frame.T_world_cam * gl
        q = T.rotation().toQuaternion()
        rows.append([q.x(), q.y(), q.z(), q.w(), *T.translation()])
    metadata = {
        "w": c.width, "h": c.height, "fps": 10, "poses": rows, "frameTimestamps": times,
        "K": [c.fx, 0, 0, 0, c.fy, 0, c.cx, c.cy, 1],
        "dw": c.width // reduced, "dh": c.height // reduced,
    }  # fmt: skip
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", json.dumps(metadata))
        for i, frame in enumerate(frames):
            image = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR)
            data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            archive.writestr(f"rgbd/{i}.jpg", data.tobytes())
            depth = frame.depth_m[reduced // 2 :: reduced, reduced // 2 :: reduced]
            archive.writestr(f"rgbd/{i}.depth", liblzfse.compress(depth.tobytes()))
            conf = np.full(depth.shape, 2, np.uint8)
            archive.writestr(f"rgbd/{i}.conf", liblzfse.compress(conf.tobytes()))
    return path


def write_realsense(path: Path, recording: Recording) -> Path:
    """By librealsense, from a device that is made of software."""
    import time

    import pyrealsense2 as rs

    device, path = rs.software_device(), path.with_suffix(".db3")
    c = recording.frames[0].camera
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy = c.width, c.height, c.fx, c.fy
    lens.ppx, lens.ppy, lens.model, lens.coeffs = c.cx, c.cy, rs.distortion.none, [0.0] * 5
    kinds = (
        ("Stereo", rs.stream.depth, rs.format.z16, 2),
        ("RGB", rs.stream.color, rs.format.rgb8, 3),
    )
    sensors, profiles = [], []
    for uid, (name, kind, layout, size) in enumerate(kinds):
        sensor, stream = device.add_sensor(name), rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fmt = kind, 0, uid, layout
        stream.width, stream.height, stream.fps, stream.bpp = c.width, c.height, 10, size
        stream.intrinsics = lens
        sensors.append(sensor)
        profiles.append(sensor.add_video_stream(stream))
    sensors[0].add_read_only_option(rs.option.depth_units, 0.001)
    same = rs.extrinsics()
    same.rotation, same.translation = [1.0, 0, 0, 0, 1, 0, 0, 0, 1], [0.0, 0, 0]
    profiles[0].register_extrinsics_to(profiles[1], same)
    recorder = rs.recorder(str(path), device)
    waiting = rs.frame_queue(50)
    for sensor in recorder.query_sensors():
        sensor.open(sensor.get_stream_profiles()[0])
        sensor.start(waiting)
    kept = []  # librealsense reads the pixels later
    for number, frame in enumerate(recording.frames, 1):
        images = millimetres(frame), np.ascontiguousarray(frame.rgb)
        for sensor, profile, (*_, size), image in zip(
            sensors, profiles, kinds, images, strict=True
        ):
            picture = rs.software_video_frame()
            picture.pixels, picture.stride, picture.bpp = image, size * c.width, size
            picture.timestamp, picture.frame_number = 1e3 * frame.stamp_s, number
            picture.domain = rs.timestamp_domain.hardware_clock
            picture.profile = profile.as_video_stream_profile()
            if size == 2:
                picture.depth_units = 0.001
            sensor.on_video_frame(picture)
            kept += [picture, image]
            time.sleep(0.02)  # the recorder writes in a thread of its own, and drops what is late
    for sensor in recorder.query_sensors():
        sensor.stop()
        sensor.close()
    del recorder
    return path


WRITERS = {
    "video": write_video,
    "realsense": write_realsense,
    "tum": write_tum,
    "redwood": write_redwood,
    "ros1": write_ros1,
    "ros2": write_ros2,
    "mcap": write_mcap,
}


NEEDS = {
    "redwood": "open3d",
    "ros1": "rosbags",
    "ros2": "rosbags",
    "mcap": "rosbags",
    "video": "av",
    "realsense": "pyrealsense2",
}


@pytest.fixture(scope="session", params=WRITERS)
def written(request, tmp_path_factory, mm_door):
    """Path and name of the door in each format."""
    pytest.importorskip(NEEDS.get(request.param, "numpy"))
    folder = tmp_path_factory.mktemp(request.param)
    return WRITERS[request.param](folder / "door", mm_door), request.param


@pytest.fixture(scope="session")
def write():
    """All that tests write with, by name."""
    return {
        **WRITERS,
        "bag": write_bag,
        "entries": bag_entries,
        "picture": write_picture,
        "r3d": write_r3d,
    }
