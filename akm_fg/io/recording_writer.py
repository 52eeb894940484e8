"""Writes recordings frame by frame; what was recorded stays readable whenever it ends.

Images are written first and ``recording.json`` is replaced after them, each in one step, so an
interrupt leaves at most one image that the description does not list (the reader allows it).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import OutputError
from akm_fg.io.json_fields import EXACT_TOLERANCE
from akm_fg.io.png import replace_file, write_png
from akm_fg.io.recording_depth import DEPTH_UNIT_M, depth_to_raw
from akm_fg.io.recording_reader import CALIBRATION_SDS, SCHEMA, frame_file, truth_as_json
from akm_fg.records import (
    BoolArray,
    CalibrationErrors,
    FloatArray,
    JointTruth,
    Recording,
    RgbdFrame,
)


@dataclass(frozen=True, slots=True)
class _Written:
    """What `recording.json` says of one frame."""

    stamp_s: float
    T_world_cam: FloatArray  # (4, 4)
    T_world_gripper: FloatArray | None  # (4, 4)
    has_mask: bool


class RecordingWriter:
    """Adds frames to a new recording folder.

        with RecordingWriter(folder) as writer:
            writer.add(camera.capture(), T_world_gripper=arm.T_world_gripper())

    The first frame sets the camera, and whether there are masks and gripper poses;
    the others must agree. Depth is rounded to whole units; everything else comes back as it is,
    and so does the depth of frames that are `as_stored`.
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
        self._written: list[_Written] = []
        self._grasp_frames: tuple[int, int] | None = None
        self._truth: JointTruth | None = None
        self._calibration: CalibrationErrors | None = None
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
        return len(self._written)

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
        i = len(self)
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
        self._first = self._first if self._written else frame
        grip = None if T_world_gripper is None else T_world_gripper.matrix()
        # One step, so that an interrupt finds either all of a frame or nothing.
        place = frame.T_world_cam.matrix()
        self._written.append(_Written(float(frame.stamp_s), place, grip, object_mask is not None))
        self._describe()

    def set_grasp_frames(self, first: int, last: int) -> None:
        """Say in which frames the gripper holds the part.

        Raises:
            ValueError: outside the frames written so far.
        """
        if not 0 <= first <= last < len(self):
            raise ValueError(f"grasp_frames ({first}, {last}) outside 0..{len(self) - 1}")
        self._grasp_frames = (int(first), int(last))
        self._describe()

    def set_calibration(self, errors: CalibrationErrors) -> None:
        """Say what is not known of the camera."""
        self._calibration = errors
        if self._first is not None:
            self._describe()

    def set_truth(self, truth: JointTruth) -> None:
        """Add the true joint, one state a frame.

        Raises:
            ValueError: the number of states is not that of the frames written so far.
        """
        if truth.states.shape != (len(self),):
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
        _check_pose("T_world_gripper", grip)
        _check_pose("T_world_cam", frame.T_world_cam)
        if self._first is None or not self._written:
            return
        last = self._written[-1]
        if frame.camera != self._first.camera:
            raise ValueError(f"camera {frame.camera}, but the first frame has {self._first.camera}")
        if frame.stamp_s <= last.stamp_s:
            raise ValueError(f"stamp_s {frame.stamp_s} after {last.stamp_s}, must grow")
        if (object_mask is not None) != last.has_mask:
            raise ValueError("either every frame has an object mask or none")
        if (grip is not None) != (last.T_world_gripper is not None):
            raise ValueError("either every frame has a gripper pose or none")

    def _describe(self) -> None:
        assert self._first is not None  # add() comes before everything that describes
        camera = self._first.camera
        names = ("width", "height", "fx", "fy", "cx", "cy")
        poses = [w.T_world_gripper for w in self._written]
        places = [w.T_world_cam for w in self._written]
        still = all(np.array_equal(place, places[0]) for place in places)
        grips = [T.tolist() for T in poses if T is not None] or None
        truth = self._truth
        if truth is not None and len(truth.states) != len(self):
            truth = None  # frames were added since: its states no longer match
        description = {
            "schema": SCHEMA,
            "camera": {name: getattr(camera, name) for name in names},
            "depth_unit_m": self._depth_unit_m,
            "T_world_cam": places[0].tolist() if still else [p.tolist() for p in places],
            "stamps_s": [w.stamp_s for w in self._written],
            "T_world_gripper": grips,
            "grasp_frames": None if self._grasp_frames is None else list(self._grasp_frames),
            "truth": None if truth is None else truth_as_json(truth),
        }
        if self._calibration is not None:
            description |= calibration_as_json(self._calibration)
        text = json.dumps(description, allow_nan=False) + "\n"
        replace_file(self._folder / "recording.json", text.encode())


def calibration_as_json(errors: CalibrationErrors) -> dict[str, Any]:
    """The fields of recording.json that say what is not known of the camera."""
    lens = errors.cov_intrinsics
    return {
        "cov_world_cam": errors.cov_world_cam.tolist(),
        "cov_intrinsics": None if lens is None else lens.tolist(),
        "calibration": {name: getattr(errors, name) for name in CALIBRATION_SDS},
    }


def _check_pose(name: str, pose: gtsam.Pose3 | None) -> None:
    """Refuse what a reader would have to mend: poses come back exactly as they were written."""
    if pose is None:
        return
    T = pose.matrix()
    defect = float(np.abs(T[:3, :3].T @ T[:3, :3] - np.eye(3)).max())
    if not (np.isfinite(T).all() and defect <= EXACT_TOLERANCE):
        raise ValueError(f"{name} is not a rigid transform (R^T R is off by {defect:.2g})")


def write_recording(
    folder: Path,
    recording: Recording,
    truth: JointTruth | None = None,
    depth_unit_m: float = DEPTH_UNIT_M,
) -> None:
    """Write a whole recording to a new folder; as `RecordingWriter`.

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
        if recording.calibration is not None:
            writer.set_calibration(recording.calibration)
        if truth is not None:
            writer.set_truth(truth)
