"""Writes recordings frame by frame; what was recorded stays readable whenever it ends.

Images are written first and ``recording.json`` is replaced after them, each in one step, so an
interrupt leaves at most one image that the description does not list (the reader allows it).
"""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import OutputError
from akm_fg.io.png import replace_file, write_png
from akm_fg.io.recording_reader import SCHEMA, frame_file, truth_as_json
from akm_fg.records import BoolArray, JointTruth, Recording, RgbdFrame

DEPTH_UNIT_M = 1e-4
"""Default unit of stored depth. 16 bits then reach 6.55 m, beyond what a stereo camera of 95 mm
baseline measures to 5 cm, and the rounding (0.03 mm rms) is below a thirtieth of its noise.
RealSense's own unit is 1 mm."""

RAW_MAX = np.iinfo(np.uint16).max


def depth_to_raw(depth_m: NDArray[np.float32], depth_unit_m: float) -> NDArray[np.uint16]:
    """Depth (H, W) in whole units; 0 where unknown, not positive, or beyond 16 bits."""
    units = np.rint(depth_m.astype(np.float64) / depth_unit_m)
    known = np.isfinite(units) & (units > 0) & (units <= RAW_MAX)
    return np.where(known, units, 0).astype(np.uint16)


class RecordingWriter:
    """Adds frames to a new recording folder.

        with RecordingWriter(folder) as writer:
            writer.add(camera.capture(), T_world_gripper=arm.T_world_gripper())

    The first frame sets the camera and its pose, and whether there are masks and gripper poses;
    the others must agree.
    """

    def __init__(self, folder: Path, depth_unit_m: float = DEPTH_UNIT_M) -> None:
        """Make the folder.

        Raises:
            ValueError: `depth_unit_m` is not a positive number.
            OutputError: the folder cannot be made, or already holds something.
        """
        if not (np.isfinite(depth_unit_m) and depth_unit_m > 0):
            raise ValueError(f"depth_unit_m is {depth_unit_m}, must be a positive number of metres")
        self._folder = Path(folder)
        self._depth_unit_m = float(depth_unit_m)
        self._first: RgbdFrame | None = None
        self._stamps_s: list[float] = []
        self._grips: list[gtsam.Pose3] = []
        self._n_masks = 0
        self._grasp_frames: tuple[int, int] | None = None
        self._truth: JointTruth | None = None
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if any(self._folder.iterdir()):
                raise OutputError(f"{self._folder}: is not empty; a recording needs a new folder")
        except OSError as e:
            raise OutputError(f"{self._folder}: cannot be written ({e.strerror})") from e

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        for part in self._folder.glob("**/*.part"):
            part.unlink(missing_ok=True)

    def __len__(self) -> int:
        return len(self._stamps_s)

    def add(
        self,
        frame: RgbdFrame,
        object_mask: BoolArray | None = None,
        T_world_gripper: gtsam.Pose3 | None = None,
    ) -> None:
        """Write one frame; when it returns, the folder is a valid recording up to this frame.

        Raises:
            ValueError: the frame does not go with those before.
            OutputError: the disk refuses.
        """
        self._check(frame, object_mask, T_world_gripper)
        i = len(self._stamps_s)
        images: dict[str, NDArray[Any]] = {
            "rgb": frame.rgb,
            "depth": depth_to_raw(frame.depth_m, self._depth_unit_m),
        }
        if object_mask is not None:
            images["mask"] = object_mask.astype(np.uint8) * 255
        for channel, image in images.items():
            path = frame_file(self._folder, channel, i)
            self._make(path.parent)
            write_png(path, image)
        self._first = self._first or frame
        self._stamps_s.append(float(frame.stamp_s))
        self._n_masks += object_mask is not None
        if T_world_gripper is not None:
            self._grips.append(T_world_gripper)
        self._describe()

    def set_grasp_frames(self, first: int, last: int) -> None:
        """Say in which frames the gripper holds the part.

        Raises:
            ValueError: outside the frames written so far.
        """
        if not 0 <= first <= last < len(self._stamps_s):
            raise ValueError(f"grasp_frames ({first}, {last}) outside 0..{len(self) - 1}")
        self._grasp_frames = (int(first), int(last))
        self._describe()

    def set_truth(self, truth: JointTruth) -> None:
        """Add the true joint, one state a frame.

        Raises:
            ValueError: the number of states is not that of the frames written so far.
        """
        if truth.states.shape != (len(self._stamps_s),):
            raise ValueError(f"{truth.states.shape} true states, {len(self)} frames")
        self._truth = truth
        self._describe()

    def _make(self, folder: Path) -> None:
        try:
            folder.mkdir(exist_ok=True)
        except OSError as e:
            raise OutputError(f"{folder}: cannot be written ({e.strerror})") from e

    def _check(
        self, frame: RgbdFrame, object_mask: BoolArray | None, grip: gtsam.Pose3 | None
    ) -> None:
        if object_mask is not None and object_mask.shape != frame.depth_m.shape:
            raise ValueError(f"mask {object_mask.shape}, expected {frame.depth_m.shape}")
        if not np.isfinite(frame.stamp_s):
            raise ValueError(f"stamp_s is {frame.stamp_s}, must be finite")
        if self._first is None:
            return
        if frame.camera != self._first.camera:
            raise ValueError(f"camera {frame.camera}, but the first frame has {self._first.camera}")
        if not frame.T_world_cam.equals(self._first.T_world_cam, 1e-9):
            raise ValueError("T_world_cam differs from the first frame's; the camera is fixed")
        if frame.stamp_s <= self._stamps_s[-1]:
            raise ValueError(f"stamp_s {frame.stamp_s} after {self._stamps_s[-1]}, must grow")
        if (object_mask is not None) != (self._n_masks > 0):
            raise ValueError("either every frame has an object mask or none")
        if (grip is not None) != (len(self._grips) > 0):
            raise ValueError("either every frame has a gripper pose or none")

    def _describe(self) -> None:
        assert self._first is not None  # add() comes before everything that describes
        camera = self._first.camera
        names = ("width", "height", "fx", "fy", "cx", "cy")
        grips = [T.matrix().tolist() for T in self._grips] or None
        truth = self._truth
        if truth is not None and len(truth.states) != len(self._stamps_s):
            truth = None  # frames were added since: its states no longer match
        description = {
            "schema": SCHEMA,
            "camera": {name: getattr(camera, name) for name in names},
            "depth_unit_m": self._depth_unit_m,
            "T_world_cam": self._first.T_world_cam.matrix().tolist(),
            "stamps_s": self._stamps_s,
            "T_world_gripper": grips,
            "grasp_frames": None if self._grasp_frames is None else list(self._grasp_frames),
            "truth": None if truth is None else truth_as_json(truth),
        }
        text = json.dumps(description, allow_nan=False) + "\n"
        replace_file(self._folder / "recording.json", text.encode())


def write_recording(
    folder: Path,
    recording: Recording,
    truth: JointTruth | None = None,
    depth_unit_m: float = DEPTH_UNIT_M,
) -> None:
    """Write a whole recording to a new folder; exact up to the rounding of depth.

    Raises:
        ValueError: the frames differ in camera or do not grow in time.
        OutputError: the folder is not empty or cannot be written.
    """
    with RecordingWriter(folder, depth_unit_m) as writer:
        for i, frame in enumerate(recording.frames):
            mask = None if recording.object_masks is None else recording.object_masks[i]
            grips = recording.T_world_gripper
            writer.add(frame, mask, None if grips is None else grips[i])
        if recording.grasp_frames is not None:
            writer.set_grasp_frames(*recording.grasp_frames)
        if truth is not None:
            writer.set_truth(truth)
