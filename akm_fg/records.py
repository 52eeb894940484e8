"""The records that pass between rooms. Conventions: docs/conventions.md.

Every record is frozen, says its shapes and frames, and is checked once, when it is made.
Unknown is NaN or ``None``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
KindName = Literal["rigid", "prismatic", "revolute", "helical"]


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """Intrinsics of an undistorted camera. Pixel centres at integers, u right, v down."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        _require(self.width > 0 and self.height > 0, f"image size {self.width}x{self.height}")
        numbers = (self.fx, self.fy, self.cx, self.cy)
        _require(bool(np.isfinite(numbers).all()), f"intrinsics {numbers} must be finite")
        _require(self.fx > 0 and self.fy > 0, f"focal lengths {self.fx}, {self.fy} must be > 0")

    def project(self, p_cam: FloatArray) -> FloatArray:
        """Pixels (..., 2) of points (..., 3) in the camera frame; NaN behind the camera."""
        z = np.where(p_cam[..., 2] > 0, p_cam[..., 2], np.nan)
        return np.stack(
            [self.fx * p_cam[..., 0] / z + self.cx, self.fy * p_cam[..., 1] / z + self.cy], axis=-1
        )

    def back_project(self, uv: FloatArray, depth_m: FloatArray) -> FloatArray:
        """Points (..., 3) in the camera frame of pixels (..., 2) with depth (...) along z."""
        x = (uv[..., 0] - self.cx) / self.fx * depth_m
        y = (uv[..., 1] - self.cy) / self.fy * depth_m
        return np.stack([x, y, depth_m], axis=-1)


@dataclass(frozen=True, slots=True)
class RgbdFrame:
    """One registered RGB-D image. Camera axes: x right, y down, z forward.

    The robot's own pixels, where they are known, carry no depth (NaN): what a frame measures
    is the scene.
    """

    stamp_s: float
    rgb: NDArray[np.uint8]  # (H, W, 3)
    depth_m: NDArray[np.float32]  # (H, W), along camera z; NaN where unknown
    camera: PinholeCamera
    T_world_cam: gtsam.Pose3

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        _require(self.rgb.shape == (*size, 3), f"rgb {self.rgb.shape}, expected {(*size, 3)}")
        _require(self.rgb.dtype == np.uint8, f"rgb is {self.rgb.dtype}, expected uint8")
        _require(self.depth_m.shape == size, f"depth {self.depth_m.shape}, expected {size}")


@dataclass(frozen=True, slots=True)
class Look:
    """One moment as a robot knows it: a frame, and where its gripper was."""

    frame: RgbdFrame
    T_world_gripper: gtsam.Pose3
    holding: bool  # something was between the closed fingers


def first_hold(looks: Sequence[Look]) -> tuple[int, int] | None:
    """First and last of the first stretch of looks in which the gripper holds."""
    held = [look.holding for look in looks]
    if True not in held:
        return None
    first = held.index(True)
    end = held.index(False, first) if False in held[first:] else len(held)
    return first, end - 1


@dataclass(frozen=True, slots=True)
class CalibrationErrors:
    """What is not known of a camera: Gaussian errors, the same in all frames of a recording.

    The true place is T_world_cam Exp(eta), eta ~ N(0, cov_world_cam), rotation first; true focal
    lengths are (1 + N(0, focal_sd^2)) times those given, and true fx, fy, cx, cy are besides
    N(0, cov_intrinsics) more; a true depth is (1 + N(0, scale^2)) times the one measured, plus
    N(0, bias^2).
    """

    cov_world_cam: FloatArray  # (6, 6) rad, m
    focal_sd: float = 0.0  # relative
    depth_scale_sd: float = 0.0  # relative
    depth_bias_sd_m: float = 0.0
    cov_intrinsics: FloatArray | None = None  # (4, 4) px^2, of fx, fy, cx, cy

    def __post_init__(self) -> None:
        _require_covariance("cov_world_cam", self.cov_world_cam, 6)
        if self.cov_intrinsics is not None:
            _require_covariance("cov_intrinsics", self.cov_intrinsics, 4)
        numbers = (self.focal_sd, self.depth_scale_sd, self.depth_bias_sd_m)
        good = bool(np.isfinite(numbers).all()) and min(numbers) >= 0
        _require(good, f"standard deviations {numbers} must be finite and no less than 0")


@dataclass(frozen=True, slots=True)
class CameraCorrection:
    """By how much a camera's world is off the robot's, as far as it is known.

    What the camera, by its calibration, puts at p is at T_world_seen p; a length l that it sees
    along a slid joint is (1 + length_share) l, give or take `length_share_sd`. Where a joint seems
    to be is known better than where it is: its covariance by the pictures alone is
    `cov_seen_joint`.
    """

    T_world_seen: gtsam.Pose3
    cov_seen_joint: FloatArray  # (6, 6), in the tangent of T_world_joint
    length_share: float = 0.0
    length_share_sd: float = 0.0

    def __post_init__(self) -> None:
        _require_covariance("cov_seen_joint", self.cov_seen_joint, 6)
        shares = (self.length_share, self.length_share_sd)
        good = bool(np.isfinite(shares).all()) and abs(shares[0]) < 1 and shares[1] >= 0
        _require(good, f"length {shares}, expected a share below 1 and its deviation")


def _require_covariance(name: str, cov: FloatArray, n: int) -> None:
    _require(cov.shape == (n, n), f"{name} {cov.shape}, expected {(n, n)}")
    _require(bool(np.isfinite(cov).all()), f"{name} must be finite")
    # Rounding on the way to text is relative to the variances, not to a small covariance.
    rounding = 1e-9 * float(np.abs(cov).max())
    _require(np.allclose(cov, cov.T, rtol=1e-6, atol=rounding), f"{name} must be symmetric")
    least, most = np.linalg.eigvalsh(cov)[[0, -1]]
    _require(least >= -1e-9 * max(float(most), 1e-300), f"{name} must be no less than 0")


@dataclass(frozen=True, slots=True)
class Recording:
    """What one camera saw while a part was moved. Holds no truth: see JointTruth.

    The camera stands still, or every frame knows where it was.
    """

    name: str
    frames: tuple[RgbdFrame, ...]
    object_masks: tuple[BoolArray, ...] | None = None  # (H, W) each, True on the object
    T_world_gripper: tuple[gtsam.Pose3, ...] | None = None  # one a frame
    grasp_frames: tuple[int, int] | None = None  # first and last frame in which the gripper holds
    calibration: CalibrationErrors | None = None  # None: as sure as the camera's allowance says
    notes: tuple[str, ...] = ()  # what reading it had to guess or leave out

    def __post_init__(self) -> None:
        n = len(self.frames)
        _require(n > 0, "a recording needs at least one frame")
        if self.object_masks is not None:
            _require(len(self.object_masks) == n, f"{len(self.object_masks)} masks, {n} frames")
        if self.T_world_gripper is not None:
            grips = len(self.T_world_gripper)
            _require(grips == n, f"{grips} gripper poses, {n} frames")
        if self.grasp_frames is not None:
            first, last = self.grasp_frames
            _require(0 <= first <= last < n, f"grasp_frames {self.grasp_frames} outside 0..{n - 1}")

    def __repr__(self) -> str:
        c = self.frames[0].camera
        return f"<Recording {self.name}: {len(self.frames)} frames of {c.width} x {c.height}>"


@dataclass(frozen=True, slots=True)
class JointTruth:
    """The true joint of a recording, from the simulator or a measurement. For scoring alone."""

    kind: KindName
    axis: FloatArray  # (3,) unit, world; the state grows along it (right-hand rule)
    pivot: FloatArray | None  # (3,) a point of the axis, world; None for prismatic
    states: FloatArray  # (T,) metres or radians; state 0 at the first frame is not required


@dataclass(frozen=True, slots=True)
class PixelTracks:
    """N pixels followed through T frames."""

    uv: FloatArray  # (T, N, 2), x right, y down, pixel centres at integers; NaN where lost
    visible: BoolArray  # (T, N)
    cov_px2: FloatArray  # (T, N, 2, 2) of uv: long along an edge, where a point may slip; or NaN

    def __post_init__(self) -> None:
        t, n = self.visible.shape
        _require(self.uv.shape == (t, n, 2), f"uv {self.uv.shape}, expected {(t, n, 2)}")
        cov = self.cov_px2.shape
        _require(cov == (t, n, 2, 2), f"cov_px2 {cov}, expected {(t, n, 2, 2)}")


@dataclass(frozen=True, slots=True)
class LastingErrors:
    """What is off alike in all frames that see a point: it does not show between two of them."""

    slip_world: FloatArray  # (T, N, 3) metres, by which a point may have slipped so far
    relief_world: FloatArray  # (T, N, 3) metres along the ray, by which it may lie elsewhere

    def select(self, tracks: NDArray[np.int_]) -> LastingErrors:
        """Of the tracks with these indices."""
        return LastingErrors(
            self.slip_world.take(tracks, axis=1), self.relief_world.take(tracks, axis=1)
        )

    def at(self, frames: NDArray[np.int_]) -> LastingErrors:
        """In the frames with these indices."""
        return LastingErrors(self.slip_world[frames], self.relief_world[frames])


@dataclass(frozen=True, slots=True)
class PointTracks:
    """N points followed through T frames in space, each observation with its covariance.

    `world` is the frame of the input: the robot's for recordings, the sensor's for logs.
    """

    p_world: FloatArray  # (T, N, 3) metres; NaN where lost
    cov_world: FloatArray  # (T, N, 3, 3) m^2; NaN where lost
    lasting: LastingErrors | None = None  # what is known of errors that last

    def __post_init__(self) -> None:
        _require(
            self.p_world.ndim == 3 and self.p_world.shape[2] == 3,
            f"points {self.p_world.shape}, expected (T, N, 3)",
        )
        want = (*self.p_world.shape, 3)
        _require(self.cov_world.shape == want, f"cov {self.cov_world.shape}, expected {want}")

    @property
    def observed(self) -> BoolArray:
        """(T, N), True where the point was seen."""
        finite = np.isfinite(self.p_world)
        return np.asarray(finite[..., 0] & finite[..., 1] & finite[..., 2])

    def select(self, tracks: NDArray) -> PointTracks:
        """The tracks with these indices (or where this (N,) mask is True)."""
        if tracks.dtype == bool:
            if tracks.all():
                return self
            tracks = np.flatnonzero(tracks)
        lasting = None if self.lasting is None else self.lasting.select(tracks)
        p_world, cov_world = (x.take(tracks, axis=1) for x in (self.p_world, self.cov_world))
        return PointTracks(p_world, cov_world, lasting)

    def at(self, frames: NDArray[np.int_]) -> PointTracks:
        """The frames with these indices."""
        lasting = None if self.lasting is None else self.lasting.at(frames)
        return PointTracks(self.p_world[frames], self.cov_world[frames], lasting)


@dataclass(frozen=True, slots=True)
class PoseTrack:
    """Poses of one part through T frames, with unknown noise level."""

    p_world: FloatArray  # (T, 3) metres
    R_world_part: FloatArray | None = None  # (T, 3, 3), None where only positions are known
    stamps_s: FloatArray | None = None  # (T,) from the first one, None where there are none
    notes: tuple[str, ...] = ()  # what reading them had to guess or leave out


@dataclass(frozen=True, slots=True)
class WayLimits:
    """How fast a way is gone along, from rest to rest, in units of the way: 1/s, 1/s^2, 1/s^3."""

    speed: float
    acceleration: float
    jerk: float

    def __post_init__(self) -> None:
        numbers = (self.speed, self.acceleration, self.jerk)
        good = bool(np.isfinite(numbers).all()) and min(numbers) > 0.0
        _require(good, f"limits {numbers}, expected three positive numbers")


@dataclass(frozen=True, slots=True)
class HandPath:
    """Gripper poses along a way, and how fast it may be gone: who follows it makes the time law."""

    way: FloatArray  # (N,) from 0, strictly growing: of what the poses follow, rad or m
    T_world_gripper: tuple[gtsam.Pose3, ...]  # N
    limits: WayLimits

    def __post_init__(self) -> None:
        n = len(self.T_world_gripper)
        _require(n > 0, "a path without a pose")
        _require(self.way.shape == (n,), f"way {self.way.shape}, expected {(n,)}")
        _require(float(self.way[0]) == 0.0, f"the way begins at {self.way[0]}, expected 0")
        _require(bool(np.all(np.diff(self.way) > 0)), "the way must grow strictly")


@dataclass(frozen=True, slots=True)
class RoundSummary:
    """One round of the closed loop: move, then look."""

    commanded: float | None  # state the hand was sent to; None where it only looked
    state_mean: float  # the belief after looking
    state_sd: float
    p_within_tolerance: float  # probability that |state - target| <= tolerance


@dataclass(frozen=True, slots=True)
class Doubt:
    """What speaks against an answer, or against an input that it did not rest on."""

    text: str  # one line: what is seen, the likely mistake, what is expected
    decides: bool = True  # the answer rests on it: no kind is named
