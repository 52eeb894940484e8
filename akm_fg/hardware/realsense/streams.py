"""Colour and depth pictures of one RealSense device, as they come; knows `pyrealsense2`.

The device is what librealsense calls one: a camera on a cable, a recording that is played, or one
made of software.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import CameraFailed
from akm_fg.hardware.realsense.config import RealSenseConfig
from akm_fg.io.sources.realsense.library import load_librealsense
from akm_fg.io.sources.realsense.playback import COLOURS, rgb_of
from akm_fg.io.sources.source import Lens
from akm_fg.records import PinholeCamera

SIDES = ("colour", "depth")


@dataclass(frozen=True, slots=True)
class Pair:
    """A colour and a depth picture of about the same moment."""

    stamp_s: float  # of colour, by the camera's clock
    rgb: NDArray[np.uint8]  # (H, W, 3)
    depth_m: NDArray[np.float32]  # (h, w) of the depth camera; NaN where unknown


class RealSenseStreams:
    """A context manager: opens both streams, and closes them."""

    def __init__(
        self,
        colour_size: tuple[int, int],
        config: RealSenseConfig | None = None,
        device: Any = None,
    ) -> None:
        """Opens nothing yet.

        Args:
            colour_size: width and height of the colour pictures.
            config: rate and patience.
            device: librealsense's; without one, the first that is connected.

        Raises:
            MissingDependency: `pyrealsense2` is not installed, or does not load.
        """
        self._rs: Any = load_librealsense("a RealSense", "hardware")
        self.config, self._size, self._device = config or RealSenseConfig(), colour_size, device
        self._open: list[Any] = []
        self.name = "RealSense"

    def __enter__(self) -> RealSenseStreams:
        """Opens both streams.

        Raises:
            CameraFailed: no camera, not with these pictures, or it does not start.
        """
        try:
            self._start(self._device or self._first())
        except RuntimeError as error:
            self._stop()
            raise CameraFailed(f"{self.name} does not start ({_one_line(error)})") from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop()

    @property
    def depth_lens(self) -> Lens:
        """Of the depth pictures."""
        return _lens(self._profiles["depth"])

    @property
    def colour_camera(self) -> PinholeCamera:
        """Of the colour pictures, as the device itself has it."""
        return _lens(self._profiles["colour"]).camera

    @property
    def T_colour_depth(self) -> gtsam.Pose3:
        """Where the depth camera is, seen from the colour camera."""
        T = self._profiles["depth"].get_extrinsics_to(self._profiles["colour"])
        R = np.array(T.rotation, dtype=np.float64).reshape(3, 3).T  # column by column
        return gtsam.Pose3(gtsam.Rot3.ClosestTo(R), np.array(T.translation, dtype=np.float64))

    def next_pair(self) -> Pair:
        """A pair that was taken after this was called.

        Raises:
            CameraFailed: none comes.
        """
        c, began_s = self.config, time.monotonic()
        newest: dict[str, Any] = {}
        while True:
            frame = self._next(began_s)
            if time.monotonic() - began_s < c.latency_s:
                continue
            newest["depth" if frame.is_depth_frame() else "colour"] = frame
            if len(newest) < len(SIDES):
                continue
            colour, depth = newest["colour"], newest["depth"]
            if abs(colour.timestamp - depth.timestamp) <= 1e3 * c.pair_s:
                return Pair(1e-3 * colour.timestamp, self._rgb(colour), self._depth_m(depth))

    def _next(self, began_s: float) -> Any:
        left_s = began_s + self.config.patience_s - time.monotonic()
        try:
            return self._queue.wait_for_frame(max(int(1e3 * left_s), 1)).as_video_frame()
        except RuntimeError as error:
            waited = f"no picture of both streams within {self.config.patience_s:g} s"
            raise CameraFailed(f"{self.name}: {waited}; is its cable in?") from error

    def _rgb(self, frame: Any) -> NDArray[np.uint8]:
        name = str(frame.profile.format()).removeprefix("format.")
        pixels = np.ascontiguousarray(frame.get_data()).tobytes()
        return rgb_of(Path(self.name), pixels, name, (frame.width, frame.height))

    def _depth_m(self, frame: Any) -> NDArray[np.float32]:
        raw = np.array(frame.get_data())
        depth_m = raw.astype(np.float32) * np.float32(self._unit_m)
        depth_m[raw == 0] = np.nan
        return depth_m

    def _first(self) -> Any:
        devices = self._rs.context().query_devices()
        if len(devices) == 0:
            raise CameraFailed("no RealSense is connected to this computer")
        return devices[0]

    def _start(self, device: Any) -> None:
        rs = self._rs
        if device.supports(rs.camera_info.name):
            self.name = device.get_info(rs.camera_info.name)
        found = [(s, p) for s in device.query_sensors() for p in s.get_stream_profiles()]
        chosen = {"colour": self._colour(rs, found), "depth": self._depth(rs, found)}
        self._profiles = {side: profile for side, (_, profile) in chosen.items()}
        sensor = chosen["depth"][0]
        self._unit_m = float(f"{sensor.get_option(rs.option.depth_units):.7g}")  # of a float32
        self._queue = rs.frame_queue(self.config.queue)
        by_sensor: dict[int, tuple[Any, list[Any]]] = {}
        for sensor, profile in chosen.values():
            by_sensor.setdefault(id(sensor), (sensor, []))[1].append(profile)
        for sensor, profiles in by_sensor.values():
            sensor.open(profiles)
            self._open.append(sensor)
            sensor.start(self._queue)

    def _colour(self, rs: Any, found: Sequence[tuple[Any, Any]]) -> tuple[Any, Any]:
        formats = list(COLOURS)

        def rank(profile: Any) -> tuple[float, ...]:
            name = str(profile.format()).removeprefix("format.")
            return abs(profile.fps() - self.config.fps), formats.index(name)

        fits = [
            (s, p.as_video_stream_profile())
            for s, p in found
            if p.stream_type() == rs.stream.color
            and str(p.format()).removeprefix("format.") in formats
        ]
        fits = [(s, p) for s, p in fits if (p.width(), p.height()) == self._size]
        if not fits:
            size = "x".join(map(str, self._size))
            raise CameraFailed(f"{self.name} takes no colour pictures of {size}, as calibrated")
        return min(fits, key=lambda x: rank(x[1]))

    def _depth(self, rs: Any, found: Sequence[tuple[Any, Any]]) -> tuple[Any, Any]:
        sizes = [*self.config.depth_sizes, self._size]

        def rank(profile: Any) -> tuple[float, ...]:
            size = profile.width(), profile.height()
            wish = sizes.index(size) if size in sizes else len(sizes)
            return abs(profile.fps() - self.config.fps), wish

        fits = [
            (s, p.as_video_stream_profile())
            for s, p in found
            if p.stream_type() == rs.stream.depth and p.format() == rs.format.z16
        ]
        if not fits:
            raise CameraFailed(f"{self.name} takes no depth pictures")
        return min(fits, key=lambda x: rank(x[1]))

    def _stop(self) -> None:
        for sensor in self._open:
            try:
                sensor.stop()
                sensor.close()
            except RuntimeError:  # it is gone
                pass
        self._open = []


def _lens(profile: Any) -> Lens:
    """Brown-Conrady models, direct or inverse, are OpenCV's, as its own ROS driver has it."""
    i = profile.get_intrinsics()
    camera = PinholeCamera(i.width, i.height, i.fx, i.fy, i.ppx, i.ppy)
    numbers = tuple(float(c) for c in i.coeffs)
    return Lens(camera, numbers if any(numbers) else ())


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
