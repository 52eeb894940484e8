"""A recording played as fast as its pictures are taken, none dropped."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import AkmError, InputError

SIDES = ("colour", "depth")
EXPECTED = "a whole RealSense recording with depth and colour"
HELD = 8  # pictures that wait to be taken; the player waits then
PATIENCE_S = 10.0  # without a picture, before a recording is given up
LOOK_S = 0.1
COLOURS = {  # of librealsense's formats: channels, and how OpenCV makes RGB of it
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "y8": (1, cv2.COLOR_GRAY2RGB),
}
Wanted = Callable[[str, float], bool]
Picture = tuple[str, float, NDArray[Any] | None]  # side, stamp, image where it is wanted


class Played:
    """An opened recording; `pictures` plays it from its beginning, once."""

    def __init__(self, path: Path, device: Any) -> None:
        import pyrealsense2 as rs

        self._path, self._playback = path, device.as_playback()
        self._playback.set_real_time(False)
        self.profiles: dict[str, Any] = {}
        self._sensors: dict[str, Any] = {}
        kinds = {rs.stream.color: "colour", rs.stream.depth: "depth"}
        for sensor in device.query_sensors():
            for profile in sensor.get_stream_profiles():
                side = kinds.get(profile.stream_type())
                if side is not None and side not in self.profiles:
                    self.profiles[side] = profile.as_video_stream_profile()
                    self._sensors[side] = sensor

    def intrinsics(self, side: str) -> Any:
        """Of one camera."""
        return self.profiles[side].get_intrinsics()

    def colour_from_depth(self) -> Any:
        """Extrinsics that take the depth camera's points to the colour camera's axes."""
        return self.profiles["depth"].get_extrinsics_to(self.profiles["colour"])

    def unit_m(self) -> float:
        """Metres a unit of depth."""
        import pyrealsense2 as rs

        return float(self._sensors["depth"].get_option(rs.option.depth_units))

    def format(self, side: str) -> str:
        """As librealsense calls it."""
        return str(self.profiles[side].format()).removeprefix("format.")

    def pictures(self, wanted: Wanted) -> Iterator[Picture]:
        """Every picture's side and stamp, with the image where it is wanted."""
        waiting: queue.Queue[Picture] = queue.Queue(HELD)
        closed = threading.Event()

        def take(frame: Any) -> None:
            """Called by the player, which waits for it."""
            side = "depth" if frame.is_depth_frame() else "colour"
            stamp_s = 1e-3 * frame.timestamp
            image = np.array(frame.get_data()) if wanted(side, stamp_s) else None
            while not closed.is_set():
                with suppress(queue.Full):
                    waiting.put((side, stamp_s, image), timeout=LOOK_S)
                    return

        self._playback.pause()  # until all sensors listen
        try:
            self._start(take)
            self._playback.resume()
            for side, stamp_s, image in self._taken(waiting):
                yield side, stamp_s, self._rgb(image) if side == "colour" else image
        finally:
            closed.set()
            self._stop()

    def _start(self, take: Callable[[Any], None]) -> None:
        for sensor in self._each_sensor():
            mine = [p for side, p in self.profiles.items() if self._sensors[side] is sensor]
            sensor.open(mine)
            sensor.start(take)

    def _stop(self) -> None:
        for sensor in self._each_sensor():
            with suppress(RuntimeError):
                sensor.stop()
                sensor.close()

    def _each_sensor(self) -> list[Any]:
        return list({id(sensor): sensor for sensor in self._sensors.values()}.values())

    def _taken(self, waiting: queue.Queue[Picture]) -> Iterator[Picture]:
        import pyrealsense2 as rs

        silent_s = 0.0
        while silent_s < PATIENCE_S:
            try:
                yield waiting.get(timeout=LOOK_S)
                silent_s = 0.0
            except queue.Empty:
                if self._playback.current_status() == rs.playback_status.stopped:
                    return
                silent_s += LOOK_S

    def _rgb(self, image: NDArray[Any] | None) -> NDArray[np.uint8] | None:
        if image is None:
            return None
        name = self.format("colour")
        if name not in COLOURS:
            raise InputError(self._path, f"colour is {name!r}", f"one of {', '.join(COLOURS)}")
        camera = self.intrinsics("colour")
        channels, how = COLOURS[name]
        shaped = image.view(np.uint8).reshape(camera.height, camera.width, channels)
        return np.asarray(shaped if how is None else cv2.cvtColor(shaped, how), dtype=np.uint8)


@contextmanager
def play(path: Path) -> Iterator[Played]:
    """Open a recording.

    Raises:
        InputError: librealsense cannot play it.
    """
    import pyrealsense2 as rs

    try:
        device = rs.context().load_device(str(path))
        yield Played(path, device)
    except AkmError:
        raise
    except (RuntimeError, ValueError) as e:
        why = " ".join(str(e).split())[:100]
        raise InputError(path, f"cannot be played ({why})", EXPECTED) from e
