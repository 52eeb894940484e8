"""ROS 1 bags, ROS 2 bags and MCAP recordings, read by `rosbags` without ROS.

The camera is at the origin of its optical frame, x right, y down, z forward (REP 103); depth of
16 bits is in millimetres (REP 118).
"""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.io.sources.folder_pictures import INTRINSICS, said_lens
from akm_fg.io.sources.ros.bag import BagIndex, images_of_bag, read_index
from akm_fg.io.sources.ros.pictures import whole_units
from akm_fg.io.sources.ros.topics import PictureTopic, choose, lens_of_topic
from akm_fg.io.sources.source import Lens, Source, SourceOptions, Stream
from akm_fg.io.sources.stamped_poses import StampedPoses
from akm_fg.records import FloatArray

NAME = "a ROS 1 bag (.bag), ROS 2 bag (folder with metadata.yaml, .db3) or MCAP recording (.mcap)"
MAGIC = {".bag": b"#ROSBAG V", ".mcap": b"\x89MCAP", ".db3": b"SQLite format 3"}
METADATA = "metadata.yaml"


def recognises(path: Path) -> bool:
    """By ending, or by what a ROS 2 bag's folder holds."""
    if path.is_dir():
        return (path / METADATA).is_file()
    return path.suffix.lower() in MAGIC


def open_source(path: Path, options: SourceOptions) -> Source:
    """Read all but the pictures.

    Raises:
        InputError: broken, or without colour, depth or camera.
        MissingDependency: `rosbags` is not installed.
    """
    _check_magic(path)
    index = read_index(path)
    topics = [index.topics[name] for name in sorted(index.topics)]
    colour, colour_notes = choose(path, topics, False, options.colour_topic)
    depth, depth_notes = choose(path, topics, True, options.depth_topic)
    orders = [np.argsort(index.stamps_s[t.topic], kind="stable") for t in (colour, depth)]
    stamps = [
        np.array(index.stamps_s[t.topic])[o] for t, o in zip((colour, depth), orders, strict=True)
    ]
    images = images_of_bag(
        path, colour.topic, depth.topic, (orders[0].tolist(), orders[1].tolist())
    )
    (rgb, raw) = next(iter(images([(0, 0)])))
    lens, depth_lens = _lenses(path, index, options, (colour, depth), (_size(rgb), _size(raw)))
    T_colour_depth = _colour_from_depth(
        path, index, options, (colour, depth), (lens, depth_lens), float(stamps[0][0])
    )
    poses, poses_from = _poses(path, index, options, colour, stamps[0])
    grippers = _grippers(path, index, options, colour, stamps[0])
    whole = whole_units(depth.first)
    return Source(
        path=path,
        format="ROS bag" if path.suffix == ".bag" else "ROS 2 bag or MCAP",
        colour=Stream(colour.topic, stamps[0], lens),
        depth=Stream(depth.topic, stamps[1], depth_lens, whole),
        images=images,
        T_colour_depth=T_colour_depth,
        unit_m=1e-3 if whole else 1.0,
        unit_from="the encoding's " + ("mm" if whole else "m"),
        poses=poses,
        poses_from=poses_from,
        grippers=grippers,
        gripper_from=options.gripper or "",
        notes=(*colour_notes, *depth_notes),
    )


def _check_magic(path: Path) -> None:
    if path.is_dir():
        return
    try:
        if not path.is_file():
            raise InputError(path, "is not a regular file", NAME)
        with path.open("rb") as file:
            start = file.read(16)
    except OSError as e:
        raise InputError(path, f"cannot be read ({e.strerror})", NAME) from e
    if not start.startswith(MAGIC[path.suffix.lower()]):
        problem = "is empty" if not start else f"does not begin as a {path.suffix} file does"
        raise InputError(path, problem, NAME)


def _size(image: np.ndarray) -> tuple[int, int]:
    return int(image.shape[1]), int(image.shape[0])


def _lenses(
    path: Path,
    index: BagIndex,
    options: SourceOptions,
    topics: tuple[PictureTopic, PictureTopic],
    sizes: tuple[tuple[int, int], tuple[int, int]],
) -> tuple[Lens, Lens]:
    """Of colour and depth; depth that is at the colour's pixels has its lens."""
    colour = said_lens(options, sizes[0]) or lens_of_topic(path, topics[0], index.infos, sizes[0])
    if colour is None:
        sized = f"of {sizes[0][0]}x{sizes[0][1]} pixels beside {topics[0].topic}"
        held = ", ".join(sorted(index.infos)) or "none"
        raise InputError(path, f"has no CameraInfo {sized} (it holds {held})", INTRINSICS)
    if _registered(options, topics) and sizes[0] == sizes[1]:
        return colour, colour
    depth = lens_of_topic(path, topics[1], index.infos, sizes[1])
    if depth is not None:
        return colour, depth
    if sizes[0] == sizes[1] and topics[0].frame == topics[1].frame:
        return colour, colour
    problem = f"has no CameraInfo of {sizes[1][0]}x{sizes[1][1]} pixels beside {topics[1].topic}"
    raise InputError(
        path, problem, "one, or `akm-fg convert --registered` if depth is at the colour's pixels"
    )


def _registered(options: SourceOptions, topics: tuple[PictureTopic, PictureTopic]) -> bool:
    if options.registered is not None:
        return options.registered
    return topics[1].says_registered


def _colour_from_depth(
    path: Path,
    index: BagIndex,
    options: SourceOptions,
    topics: tuple[PictureTopic, PictureTopic],
    lenses: tuple[Lens, Lens],
    stamp_s: float,
) -> gtsam.Pose3 | None:
    """T_colour_depth; None where they look from one place."""
    colour, depth = topics
    if _registered(options, topics) or colour.frame == depth.frame:
        return None
    T = index.transforms.between(colour.frame, depth.frame, stamp_s)
    if T is None:
        problem = (
            f"no transform between colour's frame {colour.frame!r} and depth's {depth.frame!r}"
        )
        raise InputError(
            path,
            problem,
            "one in /tf_static, or `akm-fg convert --registered` if depth is at colour's pixels",
        )
    return T


def _poses(
    path: Path,
    index: BagIndex,
    options: SourceOptions,
    colour: PictureTopic,
    stamps_s: FloatArray,
) -> tuple[StampedPoses | None, str]:
    """The camera's, by the tree of transforms or a topic of poses."""
    if options.pose_topic is None:
        chain = index.transforms.chain(colour.frame)
        world = _world(path, index, options, chain)
        if world is not None:
            found = index.transforms.poses(colour.frame, world, stamps_s)
            if found is not None:
                return found, f"tf from {world!r} to {colour.frame!r}"
    names = sorted(index.poses)
    if options.pose_topic is None and len(names) != 1:
        return None, ""
    name = options.pose_topic or names[0]
    if name not in index.poses or not index.poses[name].poses:
        expected = f"one of {', '.join(names)}" if names else "a bag with poses"
        raise InputError(path, f"has no topic of poses {name!r}", expected)
    topic = index.poses[name]
    T_child_colour = index.transforms.between(topic.child, colour.frame, float(stamps_s[0]))
    poses = topic.poses if T_child_colour is None else [T * T_child_colour for T in topic.poses]
    return StampedPoses.ordered(np.array(topic.stamps_s), poses), f"poses of {name}"


def _world(path: Path, index: BagIndex, options: SourceOptions, chain: list[str]) -> str | None:
    """The frame that stands still: as said, else the root of the camera's tree."""
    if options.world is None:
        return chain[-1] if len(chain) > 1 else None
    if (
        index.transforms.between(options.world, chain[0], 0.0) is None
        and options.world not in chain
    ):
        known = ", ".join(chain)
        raise InputError(
            path, f"no transforms from {options.world!r} to {chain[0]!r}", f"one of {known}"
        )
    return options.world


def _grippers(
    path: Path,
    index: BagIndex,
    options: SourceOptions,
    colour: PictureTopic,
    stamps_s: FloatArray,
) -> StampedPoses | None:
    if options.gripper is None:
        return None
    chain = index.transforms.chain(options.gripper)
    world = _world(path, index, options, index.transforms.chain(colour.frame))
    found = None if world is None else index.transforms.poses(options.gripper, world, stamps_s)
    if found is None:
        problem = f"no transforms from the world to {options.gripper!r} (it hangs on {chain[-1]!r})"
        raise InputError(path, problem, "a gripper in the camera's tree of transforms")
    return found
