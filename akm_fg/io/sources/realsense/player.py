"""Plays a recording in a process of its own: librealsense may end it on a broken file.

    python -m akm_fg.io.sources.realsense.player FILE

Standard input: one JSON object, stamps in seconds of the pictures wanted for each side, or null.
Standard output: one JSON line with cameras and unit; then for each picture a JSON line and, where
it is wanted, its pixels. What librealsense itself prints goes to standard error.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np

from akm_fg.io.sources.realsense.library import provide_libusb

HELD = 8  # pictures that wait to be taken; the player waits then
PATIENCE_S = 10.0  # without a picture, before a recording is given up
LOOK_S = 0.1
Picture = tuple[str, float, np.ndarray | None]  # side, stamp, image where it is wanted


class Recording:
    """An opened recording; `pictures` plays it from its beginning, once."""

    def __init__(self, path: str) -> None:
        import pyrealsense2 as rs

        device = rs.context().load_device(path)
        self._playback = device.as_playback()
        self._playback.set_real_time(False)
        self.profiles: dict[str, Any] = {}
        self.sensors: dict[str, Any] = {}
        kinds = {rs.stream.color: "colour", rs.stream.depth: "depth"}
        for sensor in device.query_sensors():
            for profile in sensor.get_stream_profiles():
                side = kinds.get(profile.stream_type())
                if side is not None and side not in self.profiles:
                    self.profiles[side] = profile.as_video_stream_profile()
                    self.sensors[side] = sensor

    def described(self) -> dict[str, Any]:
        """Cameras, where they lie, and the unit of depth."""
        import pyrealsense2 as rs

        found: dict[str, Any] = {"sides": {}}
        for side, profile in self.profiles.items():
            i = profile.get_intrinsics()
            found["sides"][side] = {
                "size": [i.width, i.height],
                "focal": [i.fx, i.fy, i.ppx, i.ppy],
                "model": str(i.model),
                "coefficients": list(i.coeffs),
                "format": str(profile.format()).removeprefix("format."),
            }
        if len(self.profiles) == 2:
            T = self.profiles["depth"].get_extrinsics_to(self.profiles["colour"])
            found["rotation"], found["translation"] = list(T.rotation), list(T.translation)
            found["unit_m"] = float(self.sensors["depth"].get_option(rs.option.depth_units))
        return found

    def pictures(self, wanted: Callable[[str, float], bool]) -> Iterator[Picture]:
        """Every picture, none dropped: the player waits for whoever takes them."""
        waiting: queue.Queue[Picture] = queue.Queue(HELD)
        closed = threading.Event()

        def take(frame: Any) -> None:
            side = "depth" if frame.is_depth_frame() else "colour"
            stamp_s = 1e-3 * frame.timestamp
            image = np.array(frame.get_data()) if wanted(side, stamp_s) else None
            while not closed.is_set():
                with suppress(queue.Full):
                    waiting.put((side, stamp_s, image), timeout=LOOK_S)
                    return

        sensors = {id(sensor): sensor for sensor in self.sensors.values()}
        self._playback.pause()  # until all sensors listen
        for key, sensor in sensors.items():
            sensor.open([p for side, p in self.profiles.items() if id(self.sensors[side]) == key])
            sensor.start(take)
        self._playback.resume()
        yield from self._taken(waiting)
        closed.set()
        for sensor in sensors.values():
            sensor.stop()
            sensor.close()

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


def play(path: str, asked: dict[str, list[float]] | None, out: BinaryIO) -> None:
    """Write all that is asked for."""
    recording = Recording(path)
    described = recording.described()
    out.write(json.dumps(described).encode() + b"\n")
    if set(described["sides"]) != {"colour", "depth"}:
        return
    stamps = {side: set(found) for side, found in (asked or {}).items()}
    for side, stamp_s, image in recording.pictures(lambda s, at: at in stamps.get(s, ())):
        head = {"side": side, "stamp_s": stamp_s, "bytes": 0 if image is None else image.nbytes}
        out.write(json.dumps(head).encode() + b"\n")
        if image is not None:
            out.write(image.tobytes())
        out.flush()
    out.write(b"{}\n")
    out.flush()


def main() -> int:
    """Of the process."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    asked = json.loads(sys.stdin.readline())
    provide_libusb()
    try:
        play(sys.argv[1], asked, out)
    except BrokenPipeError:
        pass  # whoever asked has all that was wanted
    except (RuntimeError, ValueError) as e:
        out.write(json.dumps({"error": " ".join(str(e).split())[:100]}).encode() + b"\n")
        out.flush()
    os._exit(0)  # threads of librealsense may still run


if __name__ == "__main__":
    sys.exit(main())
