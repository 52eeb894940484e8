"""Open3D's and Redwood's folders: numbered pictures, a camera file, and a trajectory.

Pictures are in color/ (image/, rgb/) and depth/; the camera file holds `intrinsic_matrix`.
http://redwood-data.org/indoor/fileformat.html: depth in millimetres, registered to colour; `.log`
trajectories hold T_world_cam, a line of numbers and four rows a pose; file names may end in a
stamp in microseconds. Open3D's `.json` trajectories hold the inverse, column by column.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from akm_fg.errors import InputError
from akm_fg.io.json_fields import RIGID_TOLERANCE, load_json_object
from akm_fg.io.sources.folder_pictures import (
    INTRINSICS,
    described_camera,
    described_lens,
    first_size,
    images_of,
    said_lens,
)
from akm_fg.io.sources.pictures import file_text
from akm_fg.io.sources.source import Source, SourceOptions, Stream
from akm_fg.io.sources.stamped_poses import StampedPoses
from akm_fg.records import FloatArray

NAME = "an Open3D or Redwood folder (color/, depth/, a camera .json)"
COLOUR_FOLDERS = ("color", "image", "rgb", "colour")
OTHERS = ("recording.json", "rgb.txt", "depth.txt", "metadata.yaml")
PICTURES = (".png", ".jpg", ".jpeg")
USUAL_RATE_HZ = 30.0
TRAJECTORIES = ("*.log", "*trajectory*.json", "trajectory.json")
LOG = "a line of 3 numbers and 4 rows of 4, a pose"
STAMP_US = re.compile(r"\d+-(\d{6,})")


def recognises(path: Path) -> bool:
    """A folder with both folders of pictures, and no other format's description of them."""
    if not (path / "depth").is_dir() or any((path / name).exists() for name in OTHERS):
        return False
    return _colour_folder(path) is not None


def _colour_folder(path: Path) -> Path | None:
    return next((path / name for name in COLOUR_FOLDERS if (path / name).is_dir()), None)


def open_source(path: Path, options: SourceOptions) -> Source:
    """Read names, camera and trajectory.

    Raises:
        InputError: no pictures, no intrinsics, or a trajectory that is none.
    """
    folder = _colour_folder(path)
    assert folder is not None  # it was recognised
    colour, depth = _pictures(folder), _pictures(path / "depth")
    size, described = first_size(colour), described_camera(path)
    lens = said_lens(options, size)
    if lens is None and described is not None:
        lens = described_lens(*described, size)
    if lens is None:
        problem = "is missing, and so is a camera file (.json with `intrinsic_matrix`)"
        raise InputError(path / "recording.json", problem, f"one of them, or {INTRINSICS}")
    width, height = first_size(depth)
    if (width, height) != size:
        problem = f"is {width}x{height}, colour {size[0]}x{size[1]}"
        raise InputError(depth[0], problem, "depth at the colour's pixels, as in this format")
    values = {} if described is None else described[1]
    rgb_s, depth_s, notes = _stamps(colour, depth, values, options)
    poses, poses_from = _trajectory(path, rgb_s)
    scale = _number(values, "depth_scale")
    return Source(
        path=path,
        format="Open3D or Redwood folder",
        colour=Stream(f"{folder.name}/", rgb_s, lens),
        depth=Stream("depth/", depth_s, lens),
        images=images_of(colour, depth),
        unit_m=1e-3 if scale is None else 1 / scale,
        unit_from="the format's mm" if scale is None else "depth_scale of the camera file",
        poses=poses,
        poses_from=poses_from,
        notes=notes,
    )


def _pictures(folder: Path) -> list[Path]:
    """In the order of their numbers."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in PICTURES]
    if not found:
        raise InputError(folder, "holds no pictures", "numbered .png or .jpg files")
    return sorted(found, key=lambda p: (*map(int, re.findall(r"\d+", p.stem)), p.name))


def _number(values: dict[str, Any], name: str) -> float | None:
    value = values.get(name)
    good = isinstance(value, (int, float)) and np.isfinite(value) and value > 0
    return float(value) if good and value is not None else None


def _stamps(
    colour: list[Path], depth: list[Path], values: dict[str, Any], options: SourceOptions
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """From the names' microseconds, or by counting at a rate."""
    named = [_stamps_of_names(files) for files in (colour, depth)]
    if named[0] is not None and named[1] is not None and options.rate_hz is None:
        return named[0], named[1], ()
    if len(colour) != len(depth):
        problem = f"holds {len(colour)} colour and {len(depth)} depth pictures without stamps"
        raise InputError(colour[0].parent.parent, problem, "as many of one as of the other")
    told = options.rate_hz or _number(values, "fps")
    stamps_s = np.arange(len(colour)) / (told or USUAL_RATE_HZ)
    notes = () if told else (f"pictures without stamps: {USUAL_RATE_HZ:g} Hz taken (--rate)",)
    return stamps_s, stamps_s, notes


def _stamps_of_names(files: list[Path]) -> FloatArray | None:
    found = [STAMP_US.fullmatch(path.stem) for path in files]
    stamps_s = np.array([1e-6 * int(match[1]) for match in found if match is not None])
    return stamps_s if len(stamps_s) == len(files) and (np.diff(stamps_s) > 0).all() else None


def _trajectory(path: Path, stamps_s: FloatArray) -> tuple[StampedPoses | None, str]:
    """One pose a picture, by its number."""
    files = sorted({file for pattern in TRAJECTORIES for file in path.glob(pattern)})
    if not files:
        return None, ""
    if len(files) > 1:
        names = " and ".join(file.name for file in files)
        raise InputError(path, f"holds several trajectories, {names}"[:200], "one")
    file = files[0]
    matrices = _of_json(file) if file.suffix == ".json" else _of_log(file)
    if len(matrices) not in (1, len(stamps_s)):
        problem = f"holds {len(matrices)} poses of {len(stamps_s)} colour pictures"
        raise InputError(file, problem, "one a picture, or one of a camera that stands still")
    poses = tuple(_rigid(file, matrix) for matrix in matrices)
    return StampedPoses(stamps_s[: len(poses)], poses), f"poses of {file.name}"


def _of_log(path: Path) -> list[FloatArray]:
    rows = [line.split() for line in file_text(path, LOG).splitlines() if line.strip()]
    if not rows or len(rows) % 5:
        raise InputError(path, f"has {len(rows)} rows", LOG)
    matrices = []
    for first in range(0, len(rows), 5):
        try:
            matrix = np.array(rows[first + 1 : first + 5], dtype=np.float64)
        except ValueError as e:
            problem = f"pose {first // 5}: holds words or rows of other lengths"
            raise InputError(path, problem, LOG) from e
        if matrix.shape != (4, 4):
            raise InputError(path, f"pose {first // 5}: has shape {matrix.shape}", LOG)
        matrices.append(matrix)
    return matrices


def _of_json(path: Path) -> list[FloatArray]:
    expected = "a PinholeCameraTrajectory as Open3D writes it"
    listed = load_json_object(path, expected).get("parameters")
    try:
        found = np.array([entry["extrinsic"] for entry in listed or ()], dtype=np.float64)
    except (TypeError, KeyError, ValueError, OverflowError) as e:
        raise InputError(path, "`parameters` hold no `extrinsic` of 16 numbers", expected) from e
    if found.ndim != 2 or found.shape[1] != 16 or not np.isfinite(found).all():
        raise InputError(path, f"`extrinsic` has shape {found.shape[1:]}", expected)
    T_cam_world = found.reshape(-1, 4, 4).transpose(0, 2, 1)
    return [_rigid(path, matrix).inverse().matrix() for matrix in T_cam_world]


def _rigid(path: Path, matrix: FloatArray) -> gtsam.Pose3:
    R = matrix[:3, :3]
    bounded = np.isfinite(matrix).all() and np.abs(R).max() < 2.0  # products are finite then
    if not (bounded and np.abs(R.T @ R - np.eye(3)).max() < RIGID_TOLERANCE):
        raise InputError(path, "holds a matrix that is no rotation", "rigid transforms 4x4")
    if np.linalg.det(R) < 0:
        raise InputError(path, "holds a reflection (determinant -1)", "rigid transforms 4x4")
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(R), matrix[:3, 3])
