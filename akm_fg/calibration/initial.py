"""Where the graph starts: OpenCV's camera and hand-eye calibration."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import cv2
import gtsam
import numpy as np

from akm_fg.calibration.records import CalibrationConfig, CalibrationViews
from akm_fg.errors import AxisUnobservable
from akm_fg.records import BoolArray, FloatArray
from factors.measurements.board_view import project_corners

HAND_EYE_METHODS = (cv2.CALIB_HAND_EYE_PARK, cv2.CALIB_HAND_EYE_DANIILIDIS)
ROBOT_WORLD_METHODS = (
    cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
    cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI,
)


@dataclass(frozen=True, slots=True)
class Start:
    """First values of all variables but the robot's own poses."""

    intrinsics: FloatArray  # (9,) in the order of Cal3DS2
    T_cam_boards: tuple[gtsam.Pose3, ...]  # each view on its own
    T_mount_cam: gtsam.Pose3
    T_holder_board: gtsam.Pose3


@dataclass(frozen=True, slots=True)
class ViewsAlone:
    """What the images say without the robot."""

    intrinsics: FloatArray  # (9,) in the order of Cal3DS2
    T_cam_boards: tuple[gtsam.Pose3, ...]

    @property
    def fx(self) -> float:
        """Focal length, pixels."""
        return float(self.intrinsics[0])

    def rays(self, uv: FloatArray) -> FloatArray:
        """(N, 2) where the rays of pixels (N, 2) meet z = 1, distortion removed."""
        fx, fy, _, cx, cy, *lens = self.intrinsics.tolist()
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        points = cv2.undistortPoints(uv.reshape(-1, 1, 2), matrix, np.array(lens))
        return np.asarray(points, dtype=np.float64).reshape(-1, 2)

    def chosen(self, kept: BoolArray) -> ViewsAlone:
        """Of some views, (V,)."""
        some = tuple(T for T, keep in zip(self.T_cam_boards, kept, strict=True) if keep)
        return ViewsAlone(self.intrinsics, some)


def reported_mount_holder(data: CalibrationViews, config: CalibrationConfig) -> list[gtsam.Pose3]:
    """T_mount_holder of each view as the robot reports it."""
    poses = [view.T_world_gripper for view in data.views]
    return poses if config.camera_place == "fixed" else [T.inverse() for T in poses]


def find_start(data: CalibrationViews, config: CalibrationConfig, alone: ViewsAlone) -> Start:
    """The hand-eye solution that projects best, beside what the images say alone.

    Raises:
        AxisUnobservable: none of OpenCV's methods finds a camera pose.
    """
    best = _best(data, config, alone)
    if best is None:
        raise AxisUnobservable(
            f"{data.name}: the camera's pose is open: no hand-eye solution; expected gripper "
            "poses that turn about two or more axes"
        )
    return Start(alone.intrinsics, alone.T_cam_boards, best[1], best[2])


def median_error_px(data: CalibrationViews, config: CalibrationConfig, alone: ViewsAlone) -> float:
    """Of all corners, by the best of OpenCV's solutions; infinite where there is none."""
    best = _best(data, config, alone)
    return float("inf") if best is None else best[0]


def _best(
    data: CalibrationViews, config: CalibrationConfig, alone: ViewsAlone
) -> tuple[float, gtsam.Pose3, gtsam.Pose3] | None:
    """Median error in pixels, T_mount_cam and T_holder_board of the solution that projects best."""
    intrinsics, T_cam_boards = alone.intrinsics, list(alone.T_cam_boards)
    reported = reported_mount_holder(data, config)
    best: tuple[float, gtsam.Pose3, gtsam.Pose3] | None = None
    for T_mount_cam in _hand_eye_candidates(reported, T_cam_boards):
        T_holder_board = _mean_pose(
            [T.inverse() * T_mount_cam * b for T, b in zip(reported, T_cam_boards, strict=True)]
        )
        off = _median_error(data, intrinsics, T_mount_cam, reported, T_holder_board)
        if best is None or off < best[0]:
            best = (off, T_mount_cam, T_holder_board)
    return best


def views_alone(data: CalibrationViews, config: CalibrationConfig) -> ViewsAlone:
    """Intrinsics and each view's board pose, by OpenCV.

    Raises:
        AxisUnobservable: the views leave the intrinsics open.
    """
    try:
        return _views_alone(data, config)
    except cv2.error as error:
        raise AxisUnobservable(
            f"{data.name}: the views leave the intrinsics open (OpenCV: {error.err}); expected "
            "the board at several distances and tilts"
        ) from error


def _views_alone(data: CalibrationViews, config: CalibrationConfig) -> ViewsAlone:
    c = data.camera
    matrix: FloatArray = np.array([[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]])
    points = [p.astype(np.float32) for p in data.p_boards]
    pixels = [view.uv.astype(np.float32) for view in data.views]
    lens: FloatArray = np.zeros(5)
    if not config.fixed_intrinsics:
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
        if not config.distortion:
            flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_ZERO_TANGENT_DIST
        size = (c.width, c.height)
        solved = cv2.calibrateCamera(points, pixels, size, matrix, lens, flags=flags)
        matrix, lens = (np.asarray(x, dtype=np.float64) for x in solved[1:3])
    poses = []
    for p_board, uv in zip(data.p_boards, pixels, strict=True):
        _, rvec, tvec = cv2.solvePnP(p_board, uv, matrix, lens, flags=cv2.SOLVEPNP_IPPE)
        rvec, tvec = cv2.solvePnPRefineLM(p_board, uv, matrix, lens, rvec, tvec)
        poses.append(gtsam.Pose3(gtsam.Rot3.Expmap(rvec.ravel()), tvec.ravel()))
    k1, k2, p1, p2 = lens.ravel()[:4]
    skew = 0.0
    intrinsics = np.array(
        [matrix[0, 0], matrix[1, 1], skew, matrix[0, 2], matrix[1, 2], k1, k2, p1, p2]
    )
    return ViewsAlone(intrinsics, tuple(poses))


def _hand_eye_candidates(
    reported: list[gtsam.Pose3], T_cam_boards: list[gtsam.Pose3]
) -> list[gtsam.Pose3]:
    """T_mount_cam by several methods: each has data on which it fails."""
    R_cb = [T.rotation().matrix() for T in T_cam_boards]
    t_cb = [T.translation() for T in T_cam_boards]
    R_mh = [T.rotation().matrix() for T in reported]
    t_mh = [T.translation() for T in reported]
    R_hm = [R.T for R in R_mh]
    t_hm = [-R.T @ t for R, t in zip(R_mh, t_mh, strict=True)]
    found = []
    for method in HAND_EYE_METHODS:
        with contextlib.suppress(cv2.error):  # it found no rotation; another method may
            R, t = cv2.calibrateHandEye(R_hm, t_hm, R_cb, t_cb, method=method)
            found.append((R, t.ravel()))
    for method in ROBOT_WORLD_METHODS:
        with contextlib.suppress(cv2.error):
            _, _, R, t = cv2.calibrateRobotWorldHandEye(R_cb, t_cb, R_mh, t_mh, method=method)
            found.append((R.T, -R.T @ t.ravel()))
    return [
        gtsam.Pose3(gtsam.Rot3.ClosestTo(R), t)
        for R, t in found
        if np.isfinite(R).all() and np.isfinite(t).all()
    ]


def _mean_pose(poses: list[gtsam.Pose3]) -> gtsam.Pose3:
    """The chordal mean of the rotations and the median of the places."""
    R = np.mean([T.rotation().matrix() for T in poses], axis=0)
    t = np.median([T.translation() for T in poses], axis=0)
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(R), t)


def _median_error(
    data: CalibrationViews,
    intrinsics: FloatArray,
    T_mount_cam: gtsam.Pose3,
    reported: list[gtsam.Pose3],
    T_holder_board: gtsam.Pose3,
) -> float:
    """Median distance, pixels, between where corners were found and where they should be."""
    off = []
    for view, p_board, T in zip(data.views, data.p_boards, reported, strict=True):
        T_cam_board = (T_mount_cam.inverse() * T * T_holder_board).matrix()
        uv, _, _ = project_corners(intrinsics, p_board @ T_cam_board[:3, :3].T + T_cam_board[:3, 3])
        off.append(np.linalg.norm(uv - view.uv, axis=1))
    return float(np.median(np.concatenate(off)))
