"""librealsense's own software device, fed with pictures at a camera's rate."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.records import PinholeCamera

Pictures = Callable[[int], tuple[NDArray[np.uint8], NDArray[np.uint16]]]
FPS, UNIT_M = 30, 0.001


class SoftwareRealSense:
    """Shows `pictures(n)`, colour and depth in millimetres, until it is left."""

    def __init__(
        self,
        pictures: Pictures,
        colour: PinholeCamera,
        depth: PinholeCamera,
        x_colour_depth_m: float = 0.0,
    ) -> None:
        import pyrealsense2 as rs

        self._rs, self._pictures = rs, pictures
        self.device = rs.software_device()
        self.fed_s: dict[int, float] = {}  # number of a picture -> when it was shown
        self._sensors: list[Any] = []
        self._profiles: list[Any] = []
        self._add("Stereo Module", rs.stream.depth, rs.format.z16, depth)
        self._sensors[0].add_read_only_option(rs.option.depth_units, UNIT_M)
        self._add("RGB Camera", rs.stream.color, rs.format.rgb8, colour)
        T = rs.extrinsics()
        T.rotation, T.translation = [1.0, 0, 0, 0, 1, 0, 0, 0, 1], [x_colour_depth_m, 0.0, 0.0]
        self._profiles[0].register_extrinsics_to(self._profiles[1], T)
        self._kept: list[Any] = []  # librealsense reads the pixels later
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._feed, daemon=True)

    def __enter__(self) -> SoftwareRealSense:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.fall_silent()

    def fall_silent(self) -> None:
        """No more pictures."""
        self._stop.set()
        self._thread.join()

    def recorded(self, path: Path, count: int) -> Path:
        """A recording of `count` pictures, by librealsense's own recorder."""
        rs = self._rs
        recorder, waiting = rs.recorder(str(path), self.device), rs.frame_queue(50)
        sensors = recorder.query_sensors()
        for sensor in sensors:
            sensor.open(sensor.get_stream_profiles()[0])
            sensor.start(waiting)
        for number in range(1, count + 1):
            self._show(number)
            time.sleep(1.0 / FPS)
        for sensor in sensors:
            sensor.stop()
            sensor.close()
        return path

    def _add(self, name: str, kind: Any, layout: Any, camera: PinholeCamera) -> None:
        rs = self._rs
        lens, stream = rs.intrinsics(), rs.video_stream()
        lens.width, lens.height, lens.fx, lens.fy = (
            camera.width,
            camera.height,
            camera.fx,
            camera.fy,
        )
        lens.ppx, lens.ppy = camera.cx, camera.cy
        lens.model, lens.coeffs = rs.distortion.none, [0.0] * 5
        stream.type, stream.index, stream.uid, stream.fmt = kind, 0, len(self._sensors), layout
        stream.width, stream.height, stream.fps = camera.width, camera.height, FPS
        stream.bpp, stream.intrinsics = 2 if kind == rs.stream.depth else 3, lens
        sensor = self.device.add_sensor(name)
        self._sensors.append(sensor)
        self._profiles.append(sensor.add_video_stream(stream))

    def _feed(self) -> None:
        number = 0
        while not self._stop.wait(1.0 / FPS):
            number += 1
            self._show(number)

    def _show(self, number: int) -> None:
        rgb, depth_mm = self._pictures(number)
        self.fed_s[number] = time.monotonic()
        for sensor, profile, image in zip(
            self._sensors, self._profiles, (depth_mm, rgb), strict=True
        ):
            picture, image = self._rs.software_video_frame(), np.ascontiguousarray(image)
            picture.pixels, picture.bpp = image, image.strides[1]
            picture.stride = image.strides[0]
            picture.timestamp, picture.frame_number = 1e3 * number / FPS, number
            picture.domain = self._rs.timestamp_domain.hardware_clock
            picture.profile = profile.as_video_stream_profile()
            if image.ndim == 2:
                picture.depth_units = UNIT_M
            sensor.on_video_frame(picture)
            self._kept += [picture, image]
