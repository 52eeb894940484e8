"""What the calibration is given and what it returns. Conventions: docs/conventions.md.

Two set-ups, one model (`factors.measurements.board_view`): `mount` carries the camera, `holder`
the board.

    camera "fixed":   mount = world,   holder = gripper  (eye-to-hand)
    camera "gripper": mount = gripper, holder = world    (eye-in-hand)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import FloatArray, PinholeCamera

CameraPlace = Literal["fixed", "gripper"]
DISTORTION = ("k1", "k2", "p1", "p2")
INTRINSICS = ("fx", "fy", "cx", "cy", *DISTORTION)  # of the covariance in a result


@dataclass(frozen=True, slots=True)
class BoardSpec:
    """A ChArUco board as printed.

    Board frame, as in OpenCV: origin in the upper left corner of the pattern, x right, y down, z
    into the board. Corners are counted along x first.
    """

    squares_x: int
    squares_y: int
    square_m: float
    marker_m: float
    dictionary: str  # OpenCV's name, such as DICT_4X4_50
    legacy_pattern: bool = False  # as printed by OpenCV before 4.6, with an even squares_y

    def __post_init__(self) -> None:
        if self.squares_x < 3 or self.squares_y < 3:
            raise ValueError(f"{self.squares_x} x {self.squares_y} squares, expected 3 or more")
        if not 0 < self.marker_m < self.square_m < np.inf:
            raise ValueError(
                f"marker_m {self.marker_m:g}, square_m {self.square_m:g}; "
                "expected 0 < marker_m < square_m"
            )

    def corners_m(self) -> FloatArray:
        """The inner corners (N, 3) in the board frame, metres, by their number."""
        x, y = np.meshgrid(np.arange(1, self.squares_x), np.arange(1, self.squares_y))
        xy = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)
        return np.asarray(self.square_m * xy)


@dataclass(frozen=True, slots=True)
class BoardView:
    """The corners found in one image."""

    frame: int  # of the recording
    corners: NDArray[np.intp]  # (N,) their numbers
    uv: FloatArray  # (N, 2) pixels
    T_world_gripper: gtsam.Pose3  # as the robot reports it


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A view that does not agree with the others."""

    frame: int
    off_px: float  # of its corners, from where the others have them


@dataclass(frozen=True, slots=True)
class CalibrationViews:
    """Everything a calibration works on."""

    name: str
    board: BoardSpec
    camera: PinholeCamera  # where intrinsics start, or what they are kept at
    views: tuple[BoardView, ...]
    skipped: tuple[int, ...] = ()  # frames in which the board was not found
    notes: tuple[str, ...] = ()  # what reading them had to guess

    @property
    def p_boards(self) -> list[FloatArray]:
        """For each view its corners (N, 3) in the board frame, metres."""
        corners_m = self.board.corners_m()
        return [corners_m[view.corners] for view in self.views]


@dataclass(frozen=True, slots=True)
class CheckConfig:
    """From where on views do not suffice, and results are doubted."""

    # Root mean square turn of the poses about the axis they turn about least.
    least_turn_rad: float = np.deg2rad(1.0)  # twenty times what an arm repeats to
    weak_turn_rad: float = np.deg2rad(8.0)
    # Relative; far above what board poses err by, below any misreading of the squares' size.
    square_tolerance: float = 0.03
    square_sds: float = 5.0  # and that many standard deviations: few views say little of it
    weak_cam_m: float = 2e-3  # standard deviations above which the camera's pose is called weak
    weak_cam_rad: float = np.deg2rad(0.2)
    # Of the picture's width, by which a view may be off before anything is fitted: 10 px of 640 are
    # 1 deg or 2 cm at a metre, more than any arm errs by.
    agreeing_share: float = 0.015
    apart_share: float = 0.1  # by which the median corner is off where nothing can be fitted
    stray_chance: float = 1e-4  # of leaving out a sound view of a set, once it is fitted
    stray_px: float = 5.0  # times the median view's errors
    largest_off_px: float = 3.0  # of the median corner, 640 px wide; more is no calibration
    misfit_chance: float = 1e-3  # of calling a sound arm worse than stated
    written_distortion_px: float = 0.5  # that a camera written into a recording may have had


@dataclass(frozen=True, slots=True)
class CalibrationConfig:
    """What is estimated, and what is known beforehand."""

    camera_place: CameraPlace = "fixed"
    fixed_intrinsics: bool = False  # keep the camera as it is given, without distortion
    distortion: bool = True  # estimate k1, k2, p1, p2; otherwise they are zero
    robot_sd_m: float = 1e-4  # of a reported pose; Franka's data sheet: repeatability 0.1 mm
    robot_sd_rad: float = np.deg2rad(0.05)
    dof: float = 6.0  # of the corners' Student-t noise, as of all observations here
    corner_scale_px: float | None = None  # of that noise; None: estimated from the residuals
    checks: CheckConfig = field(default_factory=CheckConfig)

    def __post_init__(self) -> None:
        for name in ("robot_sd_m", "robot_sd_rad", "dof"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}, expected a number above 0")
        if self.corner_scale_px is not None and not self.corner_scale_px > 0:
            raise ValueError(
                f"corner_scale_px is {self.corner_scale_px}, expected a number above 0"
            )


@dataclass(frozen=True, slots=True)
class ViewResidual:
    """How one view fits."""

    frame: int
    uv: FloatArray  # (N, 2) where corners were found
    error_px: FloatArray  # (N, 2) projected minus found
    robot_shift_m: float  # how far the reported pose of the gripper is from the estimated one
    robot_turn_rad: float

    @property
    def rms_px(self) -> float:
        """Root mean square of the errors' lengths."""
        return float(np.sqrt((self.error_px**2).sum(axis=1).mean()))


@dataclass(frozen=True, slots=True)
class HandEyeCalibration:
    """Camera, its place and the board's, as a Gaussian.

    True poses are T * Exp(xi), xi ~ N(0, cov) in GTSAM order (rotation first, radians, then
    translation, metres), increment on the right. Rows and columns of intrinsics that were held
    are zero.
    """

    name: str
    camera_place: CameraPlace
    camera: PinholeCamera
    distortion: FloatArray  # (4,) k1, k2, p1, p2 as in OpenCV
    intrinsics_cov: FloatArray  # (8, 8) in the order of INTRINSICS
    T_mount_cam: gtsam.Pose3  # T_world_cam, or T_gripper_cam of a camera in the gripper
    T_mount_cam_cov: FloatArray  # (6, 6)
    T_holder_board: gtsam.Pose3  # T_gripper_board, or T_world_board
    T_holder_board_cov: FloatArray  # (6, 6)
    corner_scale_px: float  # scale of the corners' Student-t noise, each coordinate
    views: tuple[ViewResidual, ...]
    skipped: tuple[int, ...]
    left_out: tuple[LeftOut, ...]
    warnings: tuple[str, ...]

    @property
    def rms_px(self) -> float:
        """Root mean square of all corners' errors."""
        lengths2 = np.concatenate([(view.error_px**2).sum(axis=1) for view in self.views])
        return float(np.sqrt(lengths2.mean()))
