"""Recordings of librealsense (`.bag`, and `.db3` since 2.58), played by `pyrealsense2`.

Depth has its own camera; where it lies from the colour camera is in the recording. There are no
camera poses: the world is the colour camera's own frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError, MissingDependency
from akm_fg.io.sources.folder_pictures import said_lens
from akm_fg.io.sources.realsense.playback import EXPECTED, SIDES, Played, play
from akm_fg.io.sources.source import Images, Lens, Pair, RawDepth, Source, SourceOptions, Stream
from akm_fg.records import FloatArray, PinholeCamera

NAME = "a RealSense recording (.bag, .db3 of librealsense)"
ENDINGS = (".bag", ".db3")
MARK = b"/file_version"  # a topic that librealsense alone writes, first of all
MARK_BYTES = 2**20  # it is found within


def recognises(path: Path) -> bool:
    """By the topic that librealsense begins with."""
    if path.suffix.lower() not in ENDINGS or not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return MARK in file.read(MARK_BYTES)
    except OSError:
        return False


def open_source(path: Path, options: SourceOptions) -> Source:
    """Play it once for its stamps and cameras.

    Raises:
        InputError: it is broken, or has not both streams.
        MissingDependency: `pyrealsense2` is not installed.
    """
    try:
        import pyrealsense2  # noqa: F401
    except ImportError as e:
        needs = "reading it needs pyrealsense2; install akm-fg[realsense]"
        raise MissingDependency(f"{path}: {needs}") from e
    stamps: dict[str, list[float]] = {side: [] for side in SIDES}
    with play(path) as played:
        _check(path, played)
        lenses = {side: _lens(path, played.intrinsics(side)) for side in SIDES}
        T_colour_depth = _pose(played.colour_from_depth())
        unit_m = float(f"{played.unit_m():.7g}")  # of a float32
        for side, stamp_s, _ in played.pictures(lambda side, stamp_s: False):
            stamps[side].append(stamp_s)
    for side, found in stamps.items():
        if not found:
            raise InputError(path, f"holds no {side} pictures", EXPECTED)
    order = {side: np.unique(found) for side, found in stamps.items()}
    camera = lenses["colour"].camera
    colour = said_lens(options, (camera.width, camera.height)) or lenses["colour"]
    registered = bool(options.registered)
    return Source(
        path=path,
        format="RealSense recording",
        colour=Stream(f"colour ({played.format('colour')})", order["colour"], colour),
        depth=Stream("depth", order["depth"], colour if registered else lenses["depth"]),
        images=_images(path, order),
        T_colour_depth=None if registered else T_colour_depth,
        unit_m=unit_m,
        unit_from="the recording's depth units",
    )


def _check(path: Path, played: Played) -> None:
    missing = [side for side in SIDES if side not in played.profiles]
    if missing:
        raise InputError(path, f"has no {' and no '.join(missing)} stream", EXPECTED)


def _lens(path: Path, intrinsics: Any) -> Lens:
    """Its Brown-Conrady models, direct or inverse, are OpenCV's, as its own ROS driver has it."""
    try:
        camera = PinholeCamera(
            intrinsics.width,
            intrinsics.height,
            intrinsics.fx,
            intrinsics.fy,
            intrinsics.ppx,
            intrinsics.ppy,
        )
    except ValueError as e:
        raise InputError(path, str(e), EXPECTED) from e
    model, numbers = str(intrinsics.model).lower(), tuple(float(c) for c in intrinsics.coeffs)
    if not any(numbers) or "none" in model:
        return Lens(camera)
    if "brown" in model:
        return Lens(camera, numbers)
    if "kannala" in model:
        return Lens(camera, numbers[:4], fisheye=True)
    raise InputError(path, f"distortion {model!r} is not known", "Brown-Conrady or Kannala-Brandt")


def _pose(extrinsics: Any) -> gtsam.Pose3:
    """Of a rotation column by column, and a translation in metres."""
    R = np.array(extrinsics.rotation, dtype=np.float64).reshape(3, 3).T
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(R), np.array(extrinsics.translation, dtype=np.float64))


def _images(path: Path, order: dict[str, FloatArray]) -> Images:
    def images(pairs: Sequence[Pair]) -> Iterator[tuple[NDArray[np.uint8], RawDepth]]:
        keys = [(float(order["colour"][i]), float(order["depth"][j])) for i, j in pairs]
        wanted = {"colour": {c for c, _ in keys}, "depth": {d for _, d in keys}}
        held: dict[str, dict[float, Any]] = {side: {} for side in SIDES}
        rest = keys[::-1]
        with play(path) as played:
            for side, stamp_s, image in played.pictures(lambda s, stamp: stamp in wanted[s]):
                if image is not None:
                    held[side][stamp_s] = image
                while rest and rest[-1][0] in held["colour"] and rest[-1][1] in held["depth"]:
                    colour_s, depth_s = rest.pop()
                    yield held["colour"].pop(colour_s), held["depth"].pop(depth_s)
                if not rest:
                    return
        raise InputError(
            path, f"{len(rest)} pictures are missing when it is played again", EXPECTED
        )

    return images
