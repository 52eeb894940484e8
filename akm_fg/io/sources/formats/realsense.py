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

from akm_fg.errors import InputError
from akm_fg.io.json_fields import RIGID_TOLERANCE
from akm_fg.io.sources.folder_pictures import said_lens
from akm_fg.io.sources.realsense.library import load_librealsense
from akm_fg.io.sources.realsense.playback import EXPECTED, SIDES, depth_of, play, rgb_of
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
        MissingDependency: `pyrealsense2` is not installed, or does not load.
    """
    load_librealsense(f"{path}: reading it", "realsense")
    stamps: dict[str, list[float]] = {side: [] for side in SIDES}
    with play(path) as played:
        described = played.described
        for side, stamp_s, _ in played.pictures():
            stamps[side].append(stamp_s)
    for side, found in stamps.items():
        if not found:
            raise InputError(path, f"holds no {side} pictures", EXPECTED)
    order = {side: np.unique(found) for side, found in stamps.items()}
    sides = described["sides"]
    lenses = {side: _lens(path, sides[side]) for side in SIDES}
    camera = lenses["colour"].camera
    colour = said_lens(options, (camera.width, camera.height)) or lenses["colour"]
    registered = bool(options.registered)
    return Source(
        path=path,
        format="RealSense recording",
        colour=Stream(f"colour ({sides['colour']['format']})", order["colour"], colour),
        depth=Stream("depth", order["depth"], colour if registered else lenses["depth"]),
        images=_images(path, order, sides),
        T_colour_depth=None if registered else _pose(path, described),
        unit_m=float(f"{described['unit_m']:.7g}"),  # of a float32
        unit_from="the recording's depth units",
    )


def _lens(path: Path, side: dict[str, Any]) -> Lens:
    """Its Brown-Conrady models, direct or inverse, are OpenCV's, as its own ROS driver has it."""
    try:
        camera = PinholeCamera(*side["size"], *side["focal"])
    except ValueError as e:
        raise InputError(path, str(e), EXPECTED) from e
    model, numbers = side["model"].lower(), tuple(float(c) for c in side["coefficients"])
    if not any(numbers) or "none" in model:
        return Lens(camera)
    if "brown" in model and np.isfinite(numbers).all():
        return Lens(camera, numbers)
    if "kannala" in model and np.isfinite(numbers).all():
        return Lens(camera, numbers[:4], fisheye=True)
    raise InputError(path, f"distortion {model!r} is not known", "Brown-Conrady or Kannala-Brandt")


def _pose(path: Path, described: dict[str, Any]) -> gtsam.Pose3:
    """T_colour_depth of a rotation column by column, and a translation in metres."""
    R = np.array(described["rotation"], dtype=np.float64).reshape(3, 3).T
    t = np.array(described["translation"], dtype=np.float64)
    if not np.abs(R.T @ R - np.eye(3)).max() < RIGID_TOLERANCE or not np.isfinite(t).all():
        raise InputError(path, "does not say where depth lies from colour", EXPECTED)
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(R), t)


def _images(path: Path, order: dict[str, FloatArray], sides: dict[str, Any]) -> Images:
    def images(pairs: Sequence[Pair]) -> Iterator[tuple[NDArray[np.uint8], RawDepth]]:
        keys = [(float(order["colour"][i]), float(order["depth"][j])) for i, j in pairs]
        asked = {"colour": [c for c, _ in keys], "depth": [d for _, d in keys]}
        held: dict[str, dict[float, Any]] = {side: {} for side in SIDES}
        rest = keys[::-1]
        with play(path, asked) as played:
            for side, stamp_s, pixels in played.pictures():
                if pixels:
                    held[side][stamp_s] = pixels
                while rest and rest[-1][0] in held["colour"] and rest[-1][1] in held["depth"]:
                    colour_s, depth_s = rest.pop()
                    name, size = sides["colour"]["format"], sides["colour"]["size"]
                    rgb = rgb_of(path, held["colour"].pop(colour_s), name, size)
                    raw = held["depth"].pop(depth_s)
                    yield rgb, depth_of(path, raw, sides["depth"]["size"])
                if not rest:
                    return
        problem = f"{len(rest)} pictures are missing when it is played again"
        raise InputError(path, problem, EXPECTED)

    return images
