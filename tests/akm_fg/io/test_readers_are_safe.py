"""Readers and hostile files: refused by header, links not followed, nothing waited for."""

from __future__ import annotations

import json
import os
import resource
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

from akm_fg.errors import InputError, OutputError
from akm_fg.io import json_fields, png
from akm_fg.io.inputs import read_input
from akm_fg.io.png import END, SIGNATURE, read_depth_raw, read_rgb, replace_file, write_png

WIDTH, HEIGHT = 64, 48
PIXELS = zlib.compress(bytes((3 * WIDTH + 1) * HEIGHT))
BOMB = zlib.compress(bytes(2**26), 9)  # 64 MB in 64 kB


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _png(*chunks: bytes, width: int = WIDTH, height: int = HEIGHT) -> bytes:
    header = _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return SIGNATURE + header + b"".join(chunks) + END


BOMBS = {
    "pixels": _png(_chunk(b"IDAT", BOMB)),
    "profile": _png(_chunk(b"iCCP", b"a\0\0" + BOMB), _chunk(b"IDAT", PIXELS)),
    "text": _png(_chunk(b"zTXt", b"a\0\0" + BOMB), _chunk(b"IDAT", PIXELS)),
    "long text": _png(_chunk(b"iTXt", b"a\0\1\0\0\0" + BOMB), _chunk(b"IDAT", PIXELS)),
    "frames": _png(_chunk(b"acTL", struct.pack(">II", 2**31 - 1, 0)), _chunk(b"IDAT", PIXELS)),
    "size": _png(_chunk(b"IDAT", PIXELS), width=2**31 - 1, height=2**31 - 1),
}
MEASURE = """
import resource, sys
from pathlib import Path
from akm_fg.errors import InputError
from akm_fg.io.png import read_rgb
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    read_rgb(Path(sys.argv[1]), 64, 48)
except InputError as error:
    assert chr(10) not in str(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.parametrize("name", BOMBS)
def test_a_picture_that_inflates_to_more_than_it_shows_takes_no_memory(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(BOMBS[name])
    command = [sys.executable, "-c", MEASURE, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 20_000  # kB


def test_a_picture_larger_on_disk_than_its_pixels_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.png"
    path.write_bytes(_png(_chunk(b"IDAT", PIXELS)))
    os.truncate(path, 10 * png.FILE_OVERHEAD)  # a hole: takes no room
    with pytest.raises(InputError, match="holds 42 MB"):
        read_rgb(path, WIDTH, HEIGHT)


def test_pipes_and_devices_are_not_waited_for(tmp_path: Path) -> None:
    for name in ("a.log", "a.npz", "a.png"):
        os.mkfifo(tmp_path / name)
    for name in ("a.log", "a.npz"):
        with pytest.raises(InputError, match="is not a regular file"):
            read_input(tmp_path / name)
    with pytest.raises(InputError, match="is not a regular file"):
        read_depth_raw(tmp_path / "a.png", WIDTH, HEIGHT)
    folder = tmp_path / "recording"
    folder.mkdir()
    os.mkfifo(folder / "recording.json")
    with pytest.raises(InputError, match="is not a regular file"):
        read_input(folder)


def _recording(folder: Path, frames: int, width: int = WIDTH, height: int = HEIGHT) -> Path:
    described = {
        "schema": "akm-fg/recording/1",
        "depth_unit_m": 0.001,
        "camera": {"width": width, "height": height, "fx": 60, "fy": 60, "cx": 32, "cy": 24},
        "T_world_cam": np.eye(4).tolist(),
        "stamps_s": list(range(frames)),
    }
    for channel in ("rgb", "depth"):
        (folder / channel).mkdir(parents=True)
    (folder / "recording.json").write_text(json.dumps(described))
    return folder


def test_a_recording_that_claims_frames_it_does_not_have_is_refused(tmp_path: Path) -> None:
    folder = _recording(tmp_path / "a", 100_000)
    with pytest.raises(InputError, match="`stamps_s` lists 100000 frames, 100000 without rgb"):
        read_input(folder)


def test_a_recording_larger_than_memory_is_refused_before_an_image_is_read(
    tmp_path: Path,
) -> None:
    frames, side = 20_000, 2**13  # 10 TB
    folder = _recording(tmp_path / "a", frames, side, side)
    for channel in ("rgb", "depth"):
        first = folder / channel / "000000.png"
        first.write_bytes(b"")
        for i in range(1, frames):
            os.link(first, folder / channel / f"{i:06d}.png")
    with pytest.raises(InputError, match=r"20000 frames of 8192x8192 need 10737 GB.*--frames"):
        read_input(folder)


def test_a_description_of_gigabytes_is_not_read(tmp_path: Path) -> None:
    folder = _recording(tmp_path / "a", 2)
    os.truncate(folder / "recording.json", 10**10)
    with pytest.raises(InputError, match=r"recording\.json: holds 10000 MB"):
        read_input(folder)
    log = tmp_path / "a.log"
    log.write_text("1 2 3\n")
    os.truncate(log, 10**10)
    with pytest.raises(InputError, match=r"a\.log: holds 10000 MB"):
        read_input(log)
    assert json_fields.MAX_BYTES < 10**8


def test_a_link_where_a_part_is_written_is_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "a.png.part").symlink_to(victim)
    write_png(tmp_path / "a.png", np.zeros((4, 4), np.uint8))
    assert victim.read_text() == "precious"
    assert not (tmp_path / "a.png").is_symlink()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "victim"]


def test_a_write_that_fails_leaves_the_old_file_and_no_part(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(OutputError, match="File too large"):
            replace_file(path, bytes(5000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]
