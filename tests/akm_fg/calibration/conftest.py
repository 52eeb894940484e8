"""Synthetic boards: corners and poses whose truth is known exactly."""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest

from akm_fg.calibration.records import BoardSpec, BoardView, CalibrationViews
from akm_fg.records import PinholeCamera

BOARD = BoardSpec(7, 5, 0.04, 0.03, "DICT_4X4_50")
CAMERA = PinholeCamera(640, 480, 605.0, 600.0, 322.0, 238.0)
NOMINAL = PinholeCamera(640, 480, 590.0, 590.0, 319.5, 239.5)
LENS = (-0.1, 0.05, 0.001, -0.002)


@dataclass(frozen=True)
class Truth:
    """What a calibration should find."""

    T_mount_cam: gtsam.Pose3
    T_holder_board: gtsam.Pose3
    camera: PinholeCamera
    distortion: np.ndarray


def _shown(rng: np.random.Generator, roll_only: bool) -> gtsam.Pose3:
    """T_cam_board: the board's middle anywhere in the image, 0.6 to 1.2 m ahead, tilted."""
    z, uv = rng.uniform(0.6, 1.2), rng.uniform([100, 100], [540, 380])
    middle = z * np.array([(uv[0] - 320) / 600, (uv[1] - 240) / 600, 1.0])
    about, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(0, 45))
    if roll_only:
        tilt = 0.0
    R = gtsam.Rot3.Expmap(tilt * np.array([np.cos(about), np.sin(about), 0.0]))
    centre = gtsam.Pose3(gtsam.Rot3(), -np.array([0.14, 0.1, 0.0]))
    return gtsam.Pose3(R * gtsam.Rot3.Rz(rng.uniform(-1, 1)), middle) * centre


def _build(
    seed: int = 0,
    views: int = 25,
    sd_px: float = 0.1,
    robot_sd: tuple[float, float] = (1e-4, np.deg2rad(0.05)),
    lens: tuple[float, ...] = LENS,
    camera_place: str = "fixed",
    roll_only: bool = False,
    dof: float | None = None,
) -> tuple[CalibrationViews, Truth]:
    """Views of a board; corner noise Gaussian, or Student-t of scale `sd_px` and `dof`.

    Reported poses are off by `robot_sd` (m, rad).
    """
    rng = np.random.default_rng(seed)
    T_mount_cam = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), rng.normal(size=3))
    T_holder_board = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), 0.1 * rng.normal(size=3))
    cal = gtsam.Cal3DS2(CAMERA.fx, CAMERA.fy, 0.0, CAMERA.cx, CAMERA.cy, *lens)
    corners, made = BOARD.corners_m(), []
    while len(made) < views:
        T_cam_board = _shown(rng, roll_only)
        seen = gtsam.PinholeCameraCal3DS2(gtsam.Pose3(), cal)  # GTSAM's own projection
        uv = np.array([seen.project(T_cam_board.transformFrom(p)) for p in corners])
        if (uv < 5).any() or (uv > [634, 474]).any():
            continue
        T_mount_holder = T_mount_cam * T_cam_board * T_holder_board.inverse()
        gripper = T_mount_holder if camera_place == "fixed" else T_mount_holder.inverse()
        off = gtsam.Rot3.Expmap(robot_sd[1] * rng.normal(size=3)), robot_sd[0] * rng.normal(size=3)
        tail = 1.0 if dof is None else np.sqrt(dof / rng.chisquare(dof, (len(uv), 1)))
        uv = uv + sd_px * tail * rng.normal(size=uv.shape)
        made.append(BoardView(len(made), np.arange(24), uv, gripper * gtsam.Pose3(*off)))
    data = CalibrationViews("synthetic", BOARD, NOMINAL, tuple(made))
    return data, Truth(T_mount_cam, T_holder_board, CAMERA, np.array(lens))


@pytest.fixture
def synthetic():
    """Factory: synthetic(seed=..., views=..., ...) -> (CalibrationViews, Truth)."""
    return _build


@pytest.fixture
def with_board():
    """with_board(data, squares_x=...): the same views, but the board is said to be another."""
    return lambda data, **said: replace(data, board=replace(data.board, **said))
