"""TUM RGB-D folders: rgb.txt, depth.txt and perhaps groundtruth.txt, rows that begin with a stamp.

https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats: depth in 1/5000 m, 0 unknown,
registered to colour; poses `stamp x y z qx qy qz qw` are T_world_cam in OpenCV's axes.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from akm_fg.errors import InputError
from akm_fg.io.sources.folder_pictures import (
    INTRINSICS,
    described_camera,
    described_lens,
    first_size,
    images_of,
    lens_of,
    said_lens,
)
from akm_fg.io.sources.pictures import file_text
from akm_fg.io.sources.source import Lens, Source, SourceOptions, Stream
from akm_fg.io.sources.stamped_poses import StampedPoses, read_tum_poses
from akm_fg.records import FloatArray

NAME = "a TUM RGB-D folder (rgb.txt, depth.txt)"
UNIT_M = 1 / 5000
POSES = "groundtruth.txt"
KNOWN_LENSES = {  # of the benchmark's own cameras, fx fy cx cy k1 k2 p1 p2 k3
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
ROW = "a row `stamp file` for each picture"


def recognises(path: Path) -> bool:
    """A folder with both lists."""
    return (path / "rgb.txt").is_file() and (path / "depth.txt").is_file()


def open_source(path: Path, options: SourceOptions) -> Source:
    """Read the lists and the poses.

    Raises:
        InputError: a list that is none, no intrinsics, or poses that are none.
    """
    rgb_s, rgb = _listed(path, "rgb.txt")
    depth_s, depth = _listed(path, "depth.txt")
    lens = _lens(path, options, first_size(rgb))
    width, height = first_size(depth)
    depth_lens = lens
    if (width, height) != (lens.camera.width, lens.camera.height):
        problem = f"is {width}x{height}, colour {lens.camera.width}x{lens.camera.height}"
        raise InputError(depth[0], problem, "depth at the colour's pixels, as in this format")
    poses = _poses(path)
    return Source(
        path=path,
        format="TUM RGB-D folder",
        colour=Stream("rgb.txt", rgb_s, lens),
        depth=Stream("depth.txt", depth_s, depth_lens),
        images=images_of(rgb, depth),
        unit_m=UNIT_M,
        unit_from="the format's 1/5000 m",
        poses=poses,
        poses_from="" if poses is None else f"poses of {POSES}",
    )


def _listed(folder: Path, name: str) -> tuple[FloatArray, list[Path]]:
    """Stamps (N,) in order, and the files that go with them."""
    path = folder / name
    rows: dict[float, Path] = {}
    for number, line in enumerate(file_text(path, ROW).splitlines(), 1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if not words:
            continue
        try:
            stamp_s = float(words[0])
        except ValueError as e:
            raise InputError(path, f"line {number}: {words[0][:40]!r} is no stamp", ROW) from e
        if len(words) != 2 or not np.isfinite(stamp_s):
            raise InputError(path, f"line {number}: {len(words)} columns", ROW)
        file = PurePosixPath(words[1].replace("\\", "/"))
        if file.is_absolute() or ".." in file.parts:
            raise InputError(path, f"line {number}: {str(file)[:60]!r}", "a file of this folder")
        rows.setdefault(stamp_s, folder / file)
    if not rows:
        raise InputError(path, "lists no picture", ROW)
    stamps = sorted(rows)
    return np.array(stamps), [rows[stamp_s] for stamp_s in stamps]


def _lens(folder: Path, options: SourceOptions, size: tuple[int, int]) -> Lens:
    """As said, as Open3D describes it in a file, or one of the benchmark's own cameras."""
    said = said_lens(options, size)
    if said is not None:
        return said
    described = described_camera(folder)
    if described is not None:
        return described_lens(*described, size)
    for name, numbers in KNOWN_LENSES.items():
        if name in folder.resolve().name and size == (640, 480):
            return lens_of(numbers, size, folder)
    problem = "does not say the camera's intrinsics (its name holds none of "
    problem += ", ".join(KNOWN_LENSES) + ")"
    raise InputError(folder, problem, f"{INTRINSICS}, or a camera.json as Open3D writes it")


def _poses(folder: Path) -> StampedPoses | None:
    path = folder / POSES
    if not path.exists():
        return None
    return read_tum_poses(path, file_text(path, "a row `stamp x y z qx qy qz qw`"))
