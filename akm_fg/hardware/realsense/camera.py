"""A RealSense behind `akm_fg.interfaces.Camera`: registered, undistorted, without the robot."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Any

from akm_fg.arm.depth_from_arm import DepthCorrection
from akm_fg.errors import CameraFailed
from akm_fg.hardware.mounted_camera import MountedCamera
from akm_fg.hardware.realsense.config import RealSenseConfig
from akm_fg.hardware.realsense.streams import RealSenseStreams
from akm_fg.io.sources.registration import Registration
from akm_fg.records import RgbdFrame

Mask = Callable[[RgbdFrame], RgbdFrame]  # the frame without the robot: `FrankaArm.masked`


class RealSenseCamera:
    """A context manager. What lies where is the calibration's word, not the camera's own."""

    def __init__(
        self,
        mounted: MountedCamera,
        without_robot: Mask | None = None,
        config: RealSenseConfig | None = None,
        device: Any = None,
    ) -> None:
        """Opens nothing yet.

        Args:
            mounted: where it stands, and its lens.
            without_robot: takes the robot out of a frame; None where it is out of view.
            config: rate and patience.
            device: librealsense's; without one, the first that is connected.

        Raises:
            MissingDependency: `pyrealsense2` is not installed.
        """
        self.mounted, self._without_robot = mounted, without_robot
        self._correction: DepthCorrection | None = None
        camera = mounted.lens.camera
        self._streams = RealSenseStreams((camera.width, camera.height), config, device)

    def __enter__(self) -> RealSenseCamera:
        """Opens the streams.

        Raises:
            CameraFailed: no camera, or not the one that was calibrated.
        """
        self._streams.__enter__()
        try:
            self._compare()
            self._registration = Registration(
                self.mounted.lens, self._streams.depth_lens, self._streams.T_colour_depth
            )
        except BaseException:
            self._streams.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._streams.__exit__(kind, error, trace)

    @property
    def name(self) -> str:
        """What the device calls itself."""
        return self._streams.name

    def capture(self) -> RgbdFrame:
        """The scene now: a picture that was taken after this was called.

        Raises:
            CameraFailed: none comes.
        """
        frame = self.measured()
        if self._correction is not None:
            frame = self._correction.corrected(frame)
        return frame if self._without_robot is None else self._without_robot(frame)

    def correct_depth(self, correction: DepthCorrection) -> None:
        """From now on, what is captured is corrected so."""
        self._correction = correction

    def measured(self) -> RgbdFrame:
        """As `capture`, with the robot in it and depth as the camera measures it.

        Raises:
            CameraFailed: none comes.
        """
        pair, registration = self._streams.next_pair(), self._registration
        return RgbdFrame(
            stamp_s=pair.stamp_s,
            rgb=registration.colour(pair.rgb),
            depth_m=registration.depth(pair.depth_m),
            camera=registration.camera,
            T_world_cam=self.mounted.T_world_cam,
        )

    def _compare(self) -> None:
        """The calibrated lens with the one that the device was made with.

        Raises:
            CameraFailed: they are those of different cameras.
        """
        own, calibrated = self._streams.colour_camera, self.mounted.lens.camera
        most = self._streams.config.lens_off
        off = max(abs(calibrated.fx / own.fx - 1.0), abs(calibrated.fy / own.fy - 1.0))
        if off > most:
            raise CameraFailed(
                f"{self.mounted.path} is not of this camera: its focal length is "
                f"{calibrated.fx:.0f} px, that of {self.name} {own.fx:.0f} px"
            )
