"""What a reader of a format hands on: two streams of pictures, and what the format says of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.io.conventions import Axes, Up
from akm_fg.io.sources.stamped_poses import StampedPoses
from akm_fg.records import FloatArray, PinholeCamera

RawDepth = NDArray[Any]  # (H, W) whole or floating units, 0 or not finite where unknown
Pair = tuple[int, int]  # number of a colour picture and of a depth picture
Images = Callable[[Sequence[Pair]], Iterator[tuple[NDArray[np.uint8], RawDepth]]]


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """What a person says of a source that it does not say itself; None: found out."""

    intrinsics: tuple[float, ...] | None = None  # fx fy cx cy [k1 k2 p1 p2 [k3]] of colour, px
    rate_hz: float | None = None  # of pictures without stamps
    registered: bool | None = None  # True: depth is at the colour's pixels
    colour_topic: str | None = None
    depth_topic: str | None = None
    pose_topic: str | None = None
    world: str | None = None  # frame of the tree of transforms that stands still
    gripper: str | None = None  # frame of the gripper in the tree of transforms
    start_s: float = 0.0  # after the first picture
    stop_s: float | None = None
    every: int = 1  # take one picture in so many


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera with its distortion, coefficients in OpenCV's order."""

    camera: PinholeCamera
    distortion: tuple[float, ...] = ()  # k1 k2 p1 p2 k3 ..., or k1 k2 k3 k4 of a fisheye
    fisheye: bool = False

    @property
    def bends(self) -> bool:
        """Whether there is any distortion."""
        return any(self.distortion)


@dataclass(frozen=True, slots=True)
class Stream:
    """Pictures of one camera, in the order of their stamps."""

    name: str  # a folder, a topic: what a person calls it
    stamps_s: FloatArray  # (N,) not falling
    lens: Lens
    whole_units: bool = True  # of depth: it is counted in units, and kept exactly so


@dataclass(frozen=True, slots=True)
class Source:
    """An opened source. Pictures are decoded when they are asked for."""

    path: Path
    format: str  # "a TUM RGB-D folder"
    colour: Stream
    depth: Stream
    images: Images  # decoded, in the order of the pairs that are asked for; both numbers grow
    T_colour_depth: gtsam.Pose3 | None = None  # None: depth is at the colour's pixels
    unit_m: float | None = None  # metres a unit of depth; None: nothing says
    unit_from: str = ""
    poses: StampedPoses | None = None  # as written, of the colour camera
    poses_from: str = ""
    convention: Axes = "opencv"  # of the poses, as the format has it
    invert_pose: bool = False  # the format's poses are T_cam_world
    up: Up | None = None  # of the format's world
    grippers: StampedPoses | None = None  # T_world_gripper
    gripper_from: str = ""
    notes: tuple[str, ...] = ()  # what had to be guessed or was left out
