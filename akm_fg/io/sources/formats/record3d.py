"""Record3D's `.r3d`: a zip of rgbd/0.jpg, rgbd/0.depth (LZFSE, float32 metres) and `metadata`.

`metadata` is JSON: `w`, `h`, `K` column by column, `dw`, `dh`, `fps`, `poses` (qx qy qz qw
x y z) and `frameTimestamps`. Poses are ARKit's: T_world_cam in OpenGL's axes, the world's y up.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError, MissingDependency
from akm_fg.io.arrays.npz import BROKEN
from akm_fg.io.sources.folder_pictures import lens_of, said_lens
from akm_fg.io.sources.lzfse import inflated_size
from akm_fg.io.sources.pictures import LARGEST_FILE, colour_of, size_of
from akm_fg.io.sources.source import Images, Lens, Pair, RawDepth, Source, SourceOptions, Stream
from akm_fg.io.sources.stamped_poses import StampedPoses, pose_of
from akm_fg.records import FloatArray, PinholeCamera

NAME = "a Record3D recording (.r3d)"
EXPECTED = "a whole .r3d as Record3D exports it"
DEPTH_BYTES = 4
LOWEST_CONFIDENCE = 0  # of 0, 1, 2: depth that ARKit itself does not trust
FOCAL_DRIFT = 0.01  # relative, of the lens' focus, from which it is told


def recognises(path: Path) -> bool:
    """By its ending."""
    return path.suffix.lower() == ".r3d" and not path.is_dir()


def open_source(path: Path, options: SourceOptions) -> Source:
    """Read names and metadata.

    Raises:
        InputError: no archive, or one that is not Record3D's.
        MissingDependency: the library for its compression is not installed.
    """
    decompress = _decompressor(path)
    names = _names(path)
    metadata = _metadata(path)
    pictures = sorted(
        int(n[5:-4])
        for n in names
        if n.startswith("rgbd/") and n[5:].removesuffix(".jpg").isdigit()
    )
    if not pictures:
        raise InputError(path, "holds no rgbd/0.jpg", EXPECTED)
    missing = [n for n in pictures if f"rgbd/{n}.depth" not in names]
    if missing:
        raise InputError(path, f"holds rgbd/{missing[0]}.jpg without its .depth", EXPECTED)
    size = size_of(_member(path, f"rgbd/{pictures[0]}.jpg"), path / f"rgbd/{pictures[0]}.jpg")
    lens = said_lens(options, size) or _lens(path, metadata, size)
    depth_size = _depth_size(path, metadata, pictures[0], lens.camera)
    stamps_s, notes = _stamps(path, metadata, len(pictures), options)
    poses = _poses(path, metadata, stamps_s)
    stream = Stream("rgbd/*.jpg", stamps_s, lens)
    return Source(
        path=path,
        format="Record3D recording",
        colour=stream,
        depth=Stream("rgbd/*.depth", stamps_s, _scaled(lens, depth_size), whole_units=False),
        images=_images(path, pictures, depth_size, names, decompress),
        unit_m=1.0,
        unit_from="the format's m",
        poses=poses,
        poses_from="" if poses is None else "ARKit's poses",
        convention="opengl",
        up="y",
        notes=(*notes, *_focus(metadata)),
    )


def _decompressor(path: Path) -> Any:
    try:
        import liblzfse
    except ImportError as e:
        raise MissingDependency(f"{path}: reading it needs pyliblzfse; install akm-fg[io]") from e
    return liblzfse.decompress


def _names(path: Path) -> set[str]:
    try:
        if not path.is_file():
            raise InputError(path, "is not a regular file", EXPECTED)
        with zipfile.ZipFile(path) as archive:
            return set(archive.namelist())
    except BROKEN as e:
        raise InputError(path, "is not a zip archive, or is truncated", EXPECTED) from e


def _member(path: Path, name: str, largest: int = LARGEST_FILE) -> bytes:
    """The bytes of one member, which is not larger than it can be."""
    try:
        with zipfile.ZipFile(path) as archive:
            info = archive.getinfo(name)
            if info.file_size > largest:
                problem = f"`{name}` claims {info.file_size / 1e6:.0f} MB"
                raise InputError(path, problem, f"{largest / 1e6:.0f} MB at most")
            return archive.read(info)
    except BROKEN as e:
        raise InputError(path, f"is damaged (`{name}` cannot be read)", EXPECTED) from e


def _metadata(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(_member(path, "metadata", 2**26).decode("utf-8"))
    except (ValueError, RecursionError) as e:
        raise InputError(path, "`metadata` is not JSON", EXPECTED) from e
    if not isinstance(found, dict):
        raise InputError(path, "`metadata` is no JSON object", EXPECTED)
    return found


def _numbers(path: Path, metadata: dict[str, Any], name: str, width: int | None) -> FloatArray:
    """A list of numbers, or of rows of `width` numbers."""
    try:
        found = np.array(metadata[name], dtype=np.float64)
    except (KeyError, TypeError, ValueError, OverflowError) as e:
        raise InputError(path, f"`metadata` holds no numbers as `{name}`", EXPECTED) from e
    shape = found.shape[1:] if found.ndim else (None,)
    if shape != (() if width is None else (width,)):
        raise InputError(path, f"`{name}` of `metadata` has shape {found.shape}", EXPECTED)
    return found


def _lens(path: Path, metadata: dict[str, Any], size: tuple[int, int]) -> Lens:
    K = _numbers(path, metadata, "K", None)
    if K.shape != (9,):
        raise InputError(path, f"`K` of `metadata` has {K.size} numbers", "9, column by column")
    said = metadata.get("w", size[0]), metadata.get("h", size[1])
    if said != size:
        problem = f"pictures are {size[0]}x{size[1]}, `metadata` says {said[0]}x{said[1]}"[:120]
        raise InputError(path, problem, EXPECTED)
    return lens_of((K[0], K[4], K[6], K[7]), size, path)


def _depth_size(
    path: Path, metadata: dict[str, Any], first: int, camera: PinholeCamera
) -> tuple[int, int]:
    """(width, height): as said, or by the number of pixels and the shape of the colour."""
    width, height = metadata.get("dw"), metadata.get("dh")
    pixels = inflated_size(_member(path, f"rgbd/{first}.depth"), path) // DEPTH_BYTES
    if not (isinstance(width, int) and isinstance(height, int)):
        width = round((pixels * camera.width / camera.height) ** 0.5)
        height = pixels // max(width, 1)
    if not (width > 0 and height > 0 and width * height == pixels):
        problem = f"rgbd/{first}.depth holds {pixels} pixels, `metadata` says {width}x{height}"
        raise InputError(path, problem[:120], EXPECTED)
    return width, height


def _scaled(lens: Lens, size: tuple[int, int]) -> Lens:
    """The same lens in a picture of another size; pixel centres at integers."""
    camera, (width, height) = lens.camera, size
    x, y = width / camera.width, height / camera.height
    cx, cy = (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5
    scaled = PinholeCamera(width, height, camera.fx * x, camera.fy * y, cx, cy)
    return Lens(scaled, lens.distortion, lens.fisheye)


def _stamps(
    path: Path, metadata: dict[str, Any], n: int, options: SourceOptions
) -> tuple[FloatArray, tuple[str, ...]]:
    if metadata.get("frameTimestamps"):
        stamps_s = _numbers(path, metadata, "frameTimestamps", None)
        if len(stamps_s) >= n and np.isfinite(stamps_s).all() and (np.diff(stamps_s) > 0).all():
            return stamps_s[:n], ()
        problem = f"`frameTimestamps` holds {len(stamps_s)} of {n} frames, or does not grow"
        raise InputError(path, problem, EXPECTED)
    rate_hz = options.rate_hz or metadata.get("fps")
    if isinstance(rate_hz, (int, float)) and 0 < rate_hz < 1e6:
        return np.arange(n) / float(rate_hz), ()
    return np.arange(n) / 30.0, ("pictures without stamps: 30 Hz taken (--rate)",)


def _poses(path: Path, metadata: dict[str, Any], stamps_s: FloatArray) -> StampedPoses | None:
    if not metadata.get("poses"):
        return None
    rows = _numbers(path, metadata, "poses", 7)
    if len(rows) < len(stamps_s):
        raise InputError(path, f"`poses` holds {len(rows)} of {len(stamps_s)} frames", EXPECTED)
    poses = [pose_of(row[4:], row[:4]) for row in rows[: len(stamps_s)]]
    known = [(s, pose) for s, pose in zip(stamps_s, poses, strict=True) if pose is not None]
    if not known:
        raise InputError(path, "`poses` of `metadata` holds no rotation", EXPECTED)
    return StampedPoses.ordered(np.array([s for s, _ in known]), [pose for _, pose in known])


def _focus(metadata: dict[str, Any]) -> tuple[str, ...]:
    """A note where the lens' focus moved; one camera is taken for all frames."""
    try:
        focal = np.array(metadata["perFrameIntrinsicCoeffs"], dtype=np.float64)[:, 0]
    except (KeyError, TypeError, ValueError, IndexError, OverflowError):
        return ()
    drift = float(np.ptp(focal) / focal.mean()) if len(focal) and focal.mean() > 0 else 0.0
    if not drift > FOCAL_DRIFT:
        return ()
    return (f"the focal length drifts by {100 * drift:.1f} %: one is taken for all frames",)


def _images(
    path: Path,
    pictures: Sequence[int],
    size: tuple[int, int],
    names: set[str],
    decompress: Any,
) -> Images:
    def inflated(name: str, dtype: str) -> NDArray[Any]:
        data = _member(path, name)
        want = size[0] * size[1] * np.dtype(dtype).itemsize
        holds = inflated_size(data, path / name)
        if holds != want:
            raise InputError(path / name, f"holds {holds} bytes", f"{want} of {size[0]}x{size[1]}")
        try:
            raw = decompress(data)
        except Exception as e:  # the library's own error is no public class
            raise InputError(path / name, "is damaged", "depth compressed by LZFSE") from e
        return np.frombuffer(raw, dtype).reshape(size[::-1])

    def images(pairs: Sequence[Pair]) -> Iterator[tuple[NDArray[np.uint8], RawDepth]]:
        for i, j in pairs:
            name = f"rgbd/{pictures[i]}.jpg"
            depth = inflated(f"rgbd/{pictures[j]}.depth", "<f4").copy()
            conf = f"rgbd/{pictures[j]}.conf"
            if conf in names:
                depth[inflated(conf, "u1") == LOWEST_CONFIDENCE] = np.nan
            yield colour_of(_member(path, name), path / name), depth

    return images
