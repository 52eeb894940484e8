"""A video with a depth archive: NAME.mp4 beside NAME.npz, or a folder with one of each.

The archive holds `depth` (N, H, W) at the video's pixels, whole units or metres, and perhaps `K`
(3, 3) or `intrinsics` (4), `stamps_s` (N,), `depth_unit_m`, and `T_world_cam` (4, 4) or (N, 4, 4).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import AkmError, InputError, MissingDependency
from akm_fg.io.arrays.npz import load_arrays
from akm_fg.io.json_fields import RIGID_TOLERANCE
from akm_fg.io.png import MAX_PIXELS
from akm_fg.io.sources.folder_pictures import (
    INTRINSICS,
    described_camera,
    described_lens,
    lens_of,
    said_lens,
)
from akm_fg.io.sources.source import Images, Lens, Pair, RawDepth, Source, SourceOptions, Stream
from akm_fg.io.sources.stamped_poses import StampedPoses
from akm_fg.records import FloatArray

if TYPE_CHECKING:
    from av.container import InputContainer

NAME = "a video with a depth archive (NAME.mp4 and NAME.npz, or a folder of both)"
VIDEOS = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v")
ARCHIVE = "an .npz with `depth` (N, H, W) beside the video"
WANTED = ("depth", "k", "intrinsics", "stamps_s", "depth_unit_m", "t_world_cam")
MOST_NUMBERS = 2**30  # of depth: two gigabytes of 16 bits


def recognises(path: Path) -> bool:
    """A video file, or a folder with one and an archive."""
    if not path.is_dir():
        return path.suffix.lower() in VIDEOS
    endings = {file.suffix.lower() for file in path.iterdir()}
    return bool(endings & set(VIDEOS)) and ".npz" in endings


def open_source(path: Path, options: SourceOptions) -> Source:
    """Read the archive and the video's stamps.

    Raises:
        InputError: not one video and one archive that go together, or no intrinsics.
        MissingDependency: the library that reads video is not installed.
    """
    video, archive = _files(path)
    arrays = load_arrays(archive, WANTED, ARCHIVE, MOST_NUMBERS)
    depth = _depth(archive, arrays)
    size, video_s = _video_stamps(video)
    lens = said_lens(options, size) or _lens(path, archive, arrays, size)
    colour_s, depth_s, notes = _stamps(video, archive, arrays, (video_s, len(depth)), options)
    poses = _poses(archive, arrays, depth_s)
    whole = bool(np.issubdtype(depth.dtype, np.integer))
    unit_m = _unit(archive, arrays)
    depth_size = depth.shape[2], depth.shape[1]
    depth_lens = lens if depth_size == size else _of_size(archive, lens, depth_size)
    return Source(
        path=path,
        format="video with a depth archive",
        colour=Stream(video.name, colour_s, lens),
        depth=Stream(archive.name, depth_s, depth_lens, whole),
        images=_images(video, depth),
        unit_m=unit_m,
        unit_from="" if unit_m is None else "depth_unit_m of the archive",
        poses=poses,
        poses_from="" if poses is None else "T_world_cam of the archive",
        notes=notes,
    )


def _files(path: Path) -> tuple[Path, Path]:
    if not path.is_dir():
        archive = path.with_suffix(".npz")
        if not path.is_file() or not archive.exists():
            raise InputError(path, f"has no {archive.name} beside it", ARCHIVE)
        return path, archive
    found = sorted(path.iterdir())
    videos = [file for file in found if file.suffix.lower() in VIDEOS]
    archives = [file for file in found if file.suffix.lower() == ".npz"]
    if len(videos) != 1 or len(archives) != 1:
        problem = f"holds {len(videos)} videos and {len(archives)} archives"
        raise InputError(path, problem, "one video and one .npz")
    return videos[0], archives[0]


def _depth(archive: Path, arrays: dict[str, NDArray[Any]]) -> NDArray[Any]:
    if "depth" not in arrays:
        raise InputError(archive, "holds no `depth`", ARCHIVE)
    depth = arrays["depth"]
    if depth.ndim == 4 and depth.shape[3] == 1:
        depth = depth[..., 0]
    if depth.ndim != 3 or depth.dtype.kind not in "uif" or 0 in depth.shape:
        problem = f"`depth` has shape {depth.shape} and type {depth.dtype}"
        raise InputError(archive, problem, "numbers (N, H, W)")
    if depth.dtype.itemsize == 1:
        raise InputError(archive, "`depth` holds 8 bits, likely depth painted for the eye", ARCHIVE)
    return depth


@contextmanager
def _opened(video: Path) -> Iterator[InputContainer]:
    try:
        import av
    except ImportError as e:
        raise MissingDependency(f"{video}: reading it needs av; install akm-fg[io]") from e
    expected = "a whole video that FFmpeg decodes"
    try:
        with av.open(str(video), metadata_errors="ignore") as container:
            if not container.streams.video:
                raise InputError(video, "holds no pictures", expected)
            yield container
    except AkmError:
        raise
    except (av.FFmpegError, OSError, ValueError) as e:
        why = " ".join(str(e).split())[:80]
        raise InputError(video, f"cannot be decoded ({why})", expected) from e


def _video_stamps(video: Path) -> tuple[tuple[int, int], FloatArray]:
    """(width, height), and the time of each picture in the order in which they are shown."""
    with _opened(video) as container:
        stream = container.streams.video[0]
        size = int(stream.codec_context.width), int(stream.codec_context.height)
        if not 0 < size[0] * size[1] <= MAX_PIXELS:
            raise InputError(video, f"claims {size[0]}x{size[1]} pixels", f"1 to {MAX_PIXELS}")
        times = [
            float(packet.pts * packet.time_base)
            for packet in container.demux(stream)
            if packet.pts is not None and packet.size
        ]
    if not times:
        raise InputError(video, "holds no pictures", "a video that FFmpeg decodes")
    return size, np.sort(np.array(times))


def _stamps(
    video: Path,
    archive: Path,
    arrays: dict[str, NDArray[Any]],
    lengths: tuple[FloatArray, int],
    options: SourceOptions,
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Of colour and depth: by number where there are as many, by time where depth has stamps."""
    video_s, n = lengths
    stamps = arrays.get("stamps_s")
    if stamps is not None:
        stamps = stamps.astype(np.float64) if stamps.dtype.kind in "uif" else np.empty(0)
        if stamps.shape != (n,) or not np.isfinite(stamps).all() or (np.diff(stamps) <= 0).any():
            raise InputError(
                archive, "`stamps_s` is not one time a depth picture that grows", ARCHIVE
            )
    if len(video_s) == n:
        if stamps is not None:
            return stamps, stamps, ()
        if options.rate_hz is not None:
            video_s = np.arange(n) / options.rate_hz
        return video_s, video_s, ()
    if stamps is None:
        problem = f"`depth` holds {n} pictures, {video.name} {len(video_s)}"
        raise InputError(archive, problem, "as many, or `stamps_s` of the depth")
    began = video_s - video_s[0] + stamps[0]
    note = f"{video.name} and {archive.name} are taken to begin at the same time"
    return began, stamps, (note,)


def _lens(
    path: Path, archive: Path, arrays: dict[str, NDArray[Any]], size: tuple[int, int]
) -> Lens:
    K, four = arrays.get("k"), arrays.get("intrinsics")
    K = four if K is None and four is not None and four.shape == (3, 3) else K
    if K is not None:
        if K.shape != (3, 3) or K.dtype.kind not in "uif":
            raise InputError(archive, f"`K` has shape {K.shape}", "a matrix 3x3")
        return lens_of((K[0, 0], K[1, 1], K[0, 2], K[1, 2]), size, archive)
    if four is not None and four.dtype.kind in "uif" and four.ndim == 1:
        return lens_of(four.tolist(), size, archive)
    described = described_camera(path) if path.is_dir() else None
    if described is None:
        raise InputError(archive, "holds no `K` (3, 3)", f"one, or {INTRINSICS}")
    return described_lens(*described, size)


def _of_size(archive: Path, lens: Lens, size: tuple[int, int]) -> Lens:
    """The video's lens at depth's size, if it is the same picture made smaller or larger."""
    x, y = size[0] / lens.camera.width, size[1] / lens.camera.height
    if abs(x / y - 1) > 0.02:
        problem = f"`depth` is {size[0]}x{size[1]}, video {lens.camera.width}x{lens.camera.height}"
        raise InputError(archive, problem, "the same picture at another size")
    c = lens.camera
    numbers = c.fx * x, c.fy * y, (c.cx + 0.5) * x - 0.5, (c.cy + 0.5) * y - 0.5
    return lens_of((*numbers, *lens.distortion), size, archive)


def _unit(archive: Path, arrays: dict[str, NDArray[Any]]) -> float | None:
    unit = arrays.get("depth_unit_m")
    if unit is None:
        return None
    good = (
        unit.size == 1 and unit.dtype.kind in "uif" and np.isfinite(unit).all() and (unit > 0).all()
    )
    if not good:
        raise InputError(archive, "`depth_unit_m` is no length", "metres a unit, such as 0.001")
    return float(unit.reshape(-1)[0])


def _poses(
    archive: Path, arrays: dict[str, NDArray[Any]], stamps_s: FloatArray
) -> StampedPoses | None:
    found = arrays.get("t_world_cam")
    if found is None:
        return None
    expected = f"4x4, or {len(stamps_s)} of them"
    if (
        found.shape not in ((4, 4), (1, 4, 4), (len(stamps_s), 4, 4))
        or found.dtype.kind not in "uif"
    ):
        raise InputError(archive, f"`T_world_cam` has shape {found.shape}", expected)
    matrices = found.reshape(-1, 4, 4).astype(np.float64)
    R = matrices[:, :3, :3]
    off = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max()
    if not off < RIGID_TOLERANCE or (np.linalg.det(R) < 0).any():
        raise InputError(archive, "`T_world_cam` is no rigid transform", expected)
    poses = tuple(gtsam.Pose3(gtsam.Rot3.ClosestTo(m[:3, :3]), m[:3, 3]) for m in matrices)
    return StampedPoses(stamps_s[: len(poses)], poses)


def _images(video: Path, depth: NDArray[Any]) -> Images:
    def images(pairs: Sequence[Pair]) -> Iterator[tuple[NDArray[np.uint8], RawDepth]]:
        rest = list(pairs)[::-1]
        with _opened(video) as container:
            container.streams.video[0].thread_type = "AUTO"
            for number, frame in enumerate(container.decode(video=0)):
                if rest and number == rest[-1][0]:
                    rgb = np.asarray(frame.to_ndarray(format="rgb24"), dtype=np.uint8)
                    yield rgb, depth[rest.pop()[1]]
                if not rest:
                    return
        problem = f"holds fewer pictures than it lists, {len(rest)} are missing"
        raise InputError(video, problem, "a whole video")

    return images
