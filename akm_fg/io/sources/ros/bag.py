"""A bag read twice by `rosbags`: once for all but the pictures, then for the pictures asked for."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import AkmError, InputError, MissingDependency
from akm_fg.io.sources.ros.pictures import colour_image, depth_image
from akm_fg.io.sources.ros.topics import PictureTopic
from akm_fg.io.sources.ros.transforms import Transforms, frame_name, pose_of_message, seconds
from akm_fg.io.sources.source import Images, Pair, RawDepth

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

PICTURES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
)
EXPECTED = "a whole ROS 1 bag, ROS 2 bag or MCAP recording of ROS messages"


@dataclass(slots=True)
class PoseTopic:
    """Stamps and poses of one topic, and the frames they are between."""

    parent: str
    child: str
    stamps_s: list[float] = field(default_factory=list)
    poses: list[Any] = field(default_factory=list)


@dataclass(slots=True)
class BagIndex:
    """All that a bag says but its pictures."""

    topics: dict[str, PictureTopic] = field(default_factory=dict)
    stamps_s: dict[str, list[float]] = field(default_factory=dict)  # in the order of the bag
    infos: dict[str, Any] = field(default_factory=dict)
    transforms: Transforms = field(default_factory=Transforms)
    poses: dict[str, PoseTopic] = field(default_factory=dict)


@contextmanager
def opened(path: Path) -> Iterator[AnyReader]:
    """The bag's reader.

    Raises:
        MissingDependency: `rosbags` is not installed.
        InputError: the bag is broken.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as e:
        raise MissingDependency(f"{path}: reading it needs rosbags; install akm-fg[io]") from e
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
                yield reader
    except AkmError:
        raise
    except Exception as e:  # a broken bag fails anywhere in the library
        why = " ".join(f"{type(e).__name__}: {e}".split())[:120]
        raise InputError(path, f"cannot be read ({why})", EXPECTED) from e


def read_index(path: Path) -> BagIndex:
    """Everything but the pictures' own pixels.

    Raises:
        MissingDependency: `rosbags` is not installed.
        InputError: the bag is broken.
    """
    index = BagIndex()
    wanted = (*PICTURES, INFO, *TRANSFORMS, *POSES)
    with opened(path) as reader:
        connections = [c for c in reader.connections if c.msgtype in wanted]
        if not connections:
            held = ", ".join(sorted({c.msgtype for c in reader.connections})[:5]) or "nothing"
            raise InputError(path, f"holds no pictures, but {held}", "topics of sensor_msgs/Image")
        for connection, time_ns, data in reader.messages(connections=connections):
            message = reader.deserialize(data, connection.msgtype)
            _take(index, connection.topic, connection.msgtype, message, 1e-9 * time_ns)
    return index


def _take(index: BagIndex, topic: str, kind: str, message: Any, bag_s: float) -> None:
    """Note one message."""
    if kind in TRANSFORMS:
        for transform in message.transforms:
            index.transforms.add(transform, static=topic.endswith("tf_static"))
        return
    stamp_s = seconds(message.header.stamp) or bag_s
    if kind == INFO:
        index.infos.setdefault(topic, message)
    elif kind in PICTURES:
        stamps = index.stamps_s.setdefault(topic, [])
        stamps.append(stamp_s)
        first = index.topics[topic].first if topic in index.topics else message
        index.topics[topic] = PictureTopic(topic, first, len(stamps))
    else:
        pose = _pose_in(message)
        frames = (
            frame_name(message.header.frame_id),
            frame_name(getattr(message, "child_frame_id", "")),
        )
        entry = index.poses.setdefault(topic, PoseTopic(*frames))
        if pose is not None:
            entry.stamps_s.append(stamp_s)
            entry.poses.append(pose)


def _pose_in(message: Any) -> Any:
    """Of any of the kinds of message that hold one."""
    if hasattr(message, "transform"):
        return pose_of_message(message.transform)
    pose = message.pose
    return pose_of_message(pose.pose if hasattr(pose, "pose") else pose)


def images_of_bag(
    path: Path, colour: str, depth: str, order: tuple[Sequence[int], Sequence[int]]
) -> Images:
    """Decodes the pairs asked for, in one pass.

    Args:
        path: of the bag.
        colour: topic.
        depth: topic.
        order: of each topic, the places in the bag of its pictures in the order of their stamps.
    """
    decoders: tuple[Callable[[Any, Path], Any], ...] = (colour_image, depth_image)

    def images(pairs: Sequence[Pair]) -> Iterator[tuple[NDArray[np.uint8], RawDepth]]:
        places = [{order[side][pair[side]] for pair in pairs} for side in (0, 1)]
        held: tuple[dict[int, Any], dict[int, Any]] = ({}, {})
        seen, rest = [0, 0], list(pairs)[::-1]
        with opened(path) as reader:
            chosen = [c for c in reader.connections if c.topic in (colour, depth)]
            for connection, _, data in reader.messages(connections=chosen):
                side = 0 if connection.topic == colour else 1
                place, seen[side] = seen[side], seen[side] + 1
                if place not in places[side]:
                    continue
                message = reader.deserialize(data, connection.msgtype)
                held[side][place] = decoders[side](message, path / connection.topic.lstrip("/"))
                while rest and all(order[s][rest[-1][s]] in held[s] for s in (0, 1)):
                    pair = rest.pop()
                    yield held[0].pop(order[0][pair[0]]), held[1].pop(order[1][pair[1]])
                if not rest:
                    return

    return images
