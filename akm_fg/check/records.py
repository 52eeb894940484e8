"""What a look at a recording finds."""

from __future__ import annotations

from dataclasses import dataclass

from akm_fg.records import BoolArray, FloatArray, PinholeCamera


@dataclass(frozen=True, slots=True)
class FloorSeen:
    """The floor, or a table top, in the first picture."""

    up_world: FloatArray  # (3,) unit, away from it
    height_m: float  # of the camera above it
    tilt_deg: float  # of the camera's axis below the horizon, by this floor
    roll_deg: float  # of the picture about the camera's axis
    off_up_deg: float  # between `up_world` and the world's up
    share: float  # of the pixels with depth


@dataclass(frozen=True, slots=True)
class Changes:
    """What of the first picture changes, by depth, over the frames that were compared."""

    still: BoolArray  # (H, W) as far as depth tells
    changed: BoolArray  # (H, W)
    first_frame: int | None  # in which something has changed

    @property
    def still_share(self) -> float:
        """Of the pixels that tell."""
        told = int(self.still.sum() + self.changed.sum())
        return float(self.still.sum()) / told if told else 0.0

    @property
    def changed_share(self) -> float:
        """Of the picture."""
        return float(self.changed.mean())


@dataclass(frozen=True, slots=True)
class RecordingCheck:
    """One recording, looked at; what cannot be told is None."""

    name: str
    frames: int
    compared: tuple[int, ...]  # frames, growing from 0
    seconds: float
    rate_hz: float | None  # of the median step
    longest_gap_s: float
    camera: PinholeCamera
    depth_share: float  # of the pixels, median of the frames
    depth_m: tuple[float, float, float] | None  # 5 %, 50 % and 95 % of what is seen
    noise_times: float | None  # of depth, over what is assumed
    brightness: float  # median grey level, 0 to 255
    object_mask: BoolArray | None  # (H, W) what is taken for the object
    object_share: float  # of the picture
    object_corners: int  # points on it that can be followed
    floor: FloorSeen | None
    floor_mask: BoolArray | None  # (H, W)
    changes: Changes
    camera_moves: bool  # as the poses say
    gripper_frames: tuple[int, int] | None  # in which it holds
    hints: tuple[str, ...]  # what will hinder a fit, the gravest first
