"""A recording played by a process of its own, and taken from it."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError

SIDES = ("colour", "depth")
EXPECTED = "a whole RealSense recording with depth and colour"
PLAYER = "akm_fg.io.sources.realsense.player"
PATIENCE_S = 60.0  # sound files of gigabytes answer within seconds on a machine that is not busy
COLOURS = {  # of librealsense's formats: channels, and how OpenCV makes RGB of it
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "y8": (1, cv2.COLOR_GRAY2RGB),
}
Picture = tuple[str, float, bytes]  # side, stamp, pixels (empty where they are not wanted)
Asked = dict[str, list[float]] | None


class Played:
    """What the player says: cameras at once, then pictures as they come."""

    def __init__(self, path: Path, process: subprocess.Popen[bytes], patience_s: float) -> None:
        assert process.stdout is not None
        self._path, self._process, self._out = path, process, process.stdout
        self._patience_s, self._silent = patience_s, False
        self.described = self._line()
        sides = self.described.get("sides", {})
        missing = [side for side in SIDES if side not in sides]
        if missing:
            raise InputError(path, f"has no {' and no '.join(missing)} stream", EXPECTED)

    def pictures(self) -> Iterator[Picture]:
        """In the order in which they were recorded.

        Raises:
            InputError: the player ended before its end.
        """
        while head := self._line():
            with self._patience():
                pixels = self._out.read(head["bytes"])
            if len(pixels) != head["bytes"]:
                raise self._ended()
            yield head["side"], head["stamp_s"], pixels

    def _line(self) -> dict[str, Any]:
        with self._patience():
            line = self._out.readline()
        if not line.endswith(b"\n"):
            raise self._ended()
        found: dict[str, Any] = json.loads(line)
        if "error" in found:
            raise InputError(self._path, f"cannot be played ({found['error']})", EXPECTED)
        return found

    @contextmanager
    def _patience(self) -> Iterator[None]:
        """End the player if it says nothing for too long: broken files make it go round."""
        timer = threading.Timer(self._patience_s, self._give_up)
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _give_up(self) -> None:
        self._silent = True
        self._process.kill()

    def _ended(self) -> InputError:
        how = f"said nothing for {self._patience_s:g} s" if self._silent else "ended on it"
        return InputError(self._path, f"cannot be played (librealsense {how})", EXPECTED)


@contextmanager
def play(path: Path, asked: Asked = None, patience_s: float = PATIENCE_S) -> Iterator[Played]:
    """Play a recording from its beginning.

    Args:
        path: of the recording.
        asked: stamps of the pictures whose pixels are wanted, for each side.
        patience_s: without a word from librealsense, before a recording is given up.

    Raises:
        InputError: librealsense cannot play it.
    """
    command = [sys.executable, "-m", PLAYER, str(path.absolute())]
    root = Path(__file__).resolve().parents[4]  # where akm_fg is, installed or not
    pipe, silent = subprocess.PIPE, subprocess.DEVNULL
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=silent, cwd=root) as process:
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(asked).encode() + b"\n")
            process.stdin.flush()
            yield Played(path, process, patience_s)
        except BrokenPipeError as e:
            problem = "cannot be played (its player does not start)"
            raise InputError(path, problem, EXPECTED) from e
        finally:
            process.kill()


def rgb_of(path: Path, pixels: bytes, name: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    """RGB (H, W, 3) of a picture in one of librealsense's formats.

    Raises:
        InputError: a format that is not known, or pixels of another number.
    """
    if name not in COLOURS:
        raise InputError(path, f"colour is {name!r}", f"one of {', '.join(COLOURS)}")
    channels, how = COLOURS[name]
    image = _shaped(path, pixels, "u1", (size[1], size[0], channels))
    return np.asarray(image if how is None else cv2.cvtColor(image, how), dtype=np.uint8)


def depth_of(path: Path, pixels: bytes, size: tuple[int, int]) -> NDArray[np.uint16]:
    """Depth (H, W) in the recording's units.

    Raises:
        InputError: pixels of another number.
    """
    return _shaped(path, pixels, "<u2", (size[1], size[0]))


def _shaped(path: Path, pixels: bytes, dtype: str, shape: tuple[int, ...]) -> NDArray[Any]:
    if len(pixels) != int(np.prod(shape)) * np.dtype(dtype).itemsize:
        raise InputError(path, f"holds a picture of {len(pixels)} bytes", f"{shape} of {dtype}")
    return np.frombuffer(pixels, dtype).reshape(shape).copy()
