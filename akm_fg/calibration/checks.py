"""Whether the views suffice, and whether they contradict what was stated.

Where all rotations of the robot share one axis a, moving the camera along a and the board along a
with it changes no image: R_i a is the same in all views (Tsai and Lenz, A new technique for fully
autonomous and efficient 3D robotics hand/eye calibration, 1989, sec. III).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from akm_fg.calibration.graph import GraphFit
from akm_fg.calibration.initial import Start, reported_mount_holder
from akm_fg.calibration.records import (
    CalibrationConfig,
    CalibrationViews,
    CheckConfig,
    LeftOut,
)
from akm_fg.errors import AxisUnobservable, InputError
from akm_fg.records import BoolArray, FloatArray, PinholeCamera

ROBOT_DOF = 6  # of a pose
LEAST_VIEWS = 3  # two motions; OpenCV's hand-eye methods need as many


def camera_name(config: CalibrationConfig) -> str:
    """What the camera's pose is called."""
    return "T_world_cam" if config.camera_place == "fixed" else "T_gripper_cam"


def require_views(data: CalibrationViews) -> None:
    """Refuse fewer views than three.

    Raises:
        InputError: too few.
    """
    n = len(data.views)
    if n < LEAST_VIEWS:
        where = f"the board is seen in {n} of {n + len(data.skipped)} images"
        expected = f"{LEAST_VIEWS} at the very least, 20 or more in different poses"
        raise InputError(data.name, where, expected)


def require_turns(data: CalibrationViews, config: CalibrationConfig) -> tuple[str, ...]:
    """Refuse poses that turn about fewer than two axes; a warning where they hardly do.

    Raises:
        AxisUnobservable: the camera's place is open along a line, or everywhere.
    """
    R = np.array([T.rotation().matrix() for T in reported_mount_holder(data, config)])
    off = R - R.mean(axis=0)
    square, directions = np.linalg.eigh(np.einsum("nji,njk->ik", off, off) / len(R))
    # A turn by a small angle moves R a by that angle in the two directions across its axis.
    spread = np.sqrt(np.maximum(square, 0.0))
    name, advice = camera_name(config), "expected gripper poses that turn by 20 deg or more about "
    if spread[2] < config.checks.least_turn_rad:
        raise AxisUnobservable(
            f"{data.name}: the translation of {name} is open in every direction: the gripper "
            f"never turns (by {np.rad2deg(spread[2]):.2f} deg); {advice}two axes"
        )
    along = R.mean(axis=0) @ directions[:, 0]
    along = along / np.linalg.norm(along) * np.sign(along[np.abs(along).argmax()])
    way = _direction(along)
    frame = name.split("_")[1]
    if spread[0] < config.checks.least_turn_rad:
        raise AxisUnobservable(
            f"{data.name}: the translation of {name} along {way} in {frame} axes is open: every "
            f"pose of the gripper turns about that axis alone; {advice}a second axis"
        )
    if spread[0] < config.checks.weak_turn_rad:
        return (
            f"the gripper turns almost about {way} in {frame} axes alone: {name} is weakest "
            "along it",
        )
    return ()


def require_square(data: CalibrationViews, config: CalibrationConfig, start: Start) -> None:
    """Refuse a board whose squares are not as large as the robot's motion says.

    Images alone cannot tell the size of the board. With rotations known, the scale s of the
    board poses' translations is linear beside both unknown translations:
    s t_cam_board = R_cam_mount (R_mount_holder t_holder_board + t_mount_holder) + t_cam_mount.

    Raises:
        InputError: `square_m` is wrong.
    """
    R_cam_mount = start.T_mount_cam.rotation().matrix().T
    rows, right = [], []
    for T, T_cam_board in zip(reported_mount_holder(data, config), start.T_cam_boards, strict=True):
        turned = R_cam_mount @ T.rotation().matrix()
        rows.append(np.column_stack([T_cam_board.translation(), -turned, -np.eye(3)]))
        right.append(R_cam_mount @ T.translation())
    scale, sd = _first_of_solution(np.vstack(rows), np.concatenate(right))
    checks = config.checks
    if abs(scale - 1.0) > max(checks.square_tolerance, checks.square_sds * sd):
        said, found = 1e3 * data.board.square_m, 1e3 * scale * data.board.square_m
        raise InputError(
            data.name,
            f"`square_m` says {said:.4g} mm, but by the robot's motion it is {found:.4g} mm",
            "the side of a square as printed, and robot poses that belong to the images",
        )


def strays(data: CalibrationViews, config: CalibrationConfig, fit: GraphFit) -> BoolArray:
    """(V,) views that do not fit: a robot pose, or corners, far worse than those of the others.

    Never more than the worse half, and of these the worst alone where the others may follow them.
    """
    checks, n = config.checks, len(data.views)
    misfit = np.einsum("vi,vij,vj->v", fit.robot_errors, fit.robot_information, fit.robot_errors)
    usual = max(1.0, float(np.median(misfit)) / float(stats.chi2.ppf(0.5, ROBOT_DOF)))
    limit = usual * float(stats.chi2.ppf(1.0 - checks.stray_chance / n, ROBOT_DOF))
    off_px = np.array([typical_px(e) for e in fit.errors_px])
    limit_px = checks.stray_px * float(np.median(off_px))
    worse = np.maximum(misfit / limit, (off_px / max(limit_px, 1e-9)) ** 2)
    return np.asarray((worse > 1.0) & (worse >= 0.25 * worse.max()))


def typical_px(errors: FloatArray) -> float:
    """Median length of errors (N, 2): a few corners gone astray are no view that does not fit."""
    return float(np.median(np.linalg.norm(errors, axis=1)))


def stray_words(views: Sequence[LeftOut]) -> tuple[str, ...]:
    """What is to be said of them."""
    if not views:
        return ()
    frames = ", ".join(str(view.frame) for view in views)
    return (f"frames {frames} do not fit the others (robot pose or corners), left out",)


def require_small(data: CalibrationViews, config: CalibrationConfig, fit: GraphFit) -> None:
    """Refuse a fit whose corners are far from where they were found.

    Raises:
        InputError: they are.
    """
    off_px, limit_px = typical_px(np.concatenate(fit.errors_px)), limit_off_px(data.camera, config)
    if off_px > limit_px:
        raise InputError(
            data.name,
            f"half of the corners are off by {off_px:.1f} px or more; the limit is {limit_px:.1f}",
            "sharp images of the board that is described, and robot poses that belong to them",
        )


def limit_off_px(camera: PinholeCamera, config: CalibrationConfig) -> float:
    """Of the median corner, for the size of the pictures."""
    return config.checks.largest_off_px * camera.width / 640.0


def _first_of_solution(A: FloatArray, b: FloatArray) -> tuple[float, float]:
    """First unknown of A x = b by least squares, and its standard deviation by the residuals."""
    x = np.linalg.lstsq(A, b, rcond=None)[0]
    left = max(len(b) - x.size, 1)
    variance = float(((A @ x - b) ** 2).sum()) / left * np.linalg.pinv(A.T @ A)[0, 0]
    return float(x[0]), float(np.sqrt(variance))


def _direction(way: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in np.round(way, 2) + 0.0) + ")"  # no minus zero


def doubts(data: CalibrationViews, config: CalibrationConfig, fit: GraphFit) -> tuple[str, ...]:
    """What a person should know about a result."""
    found = []
    if data.skipped:
        frames = ", ".join(map(str, data.skipped[:10])) + (
            ", ..." if len(data.skipped) > 10 else ""
        )
        found.append(f"frames without the board, left out: {frames}")
    if fit.robot_misfit > stats.chi2.ppf(1.0 - config.checks.misfit_chance, fit.robot_misfit_dof):
        worse = float(np.sqrt(fit.robot_misfit / fit.robot_misfit_dof))
        found.append(
            f"robot and images disagree {worse:.1f} times more than the arm's stated "
            f"{1e3 * config.robot_sd_m:.3g} mm and {np.rad2deg(config.robot_sd_rad):.3g} deg "
            "allow: the covariances are too small; state what the arm really repeats to, or "
            "estimate the distortion"
        )
    found += _weak_camera(camera_name(config), fit.cam_cov, config.checks)
    return tuple(found)


def _weak_camera(name: str, cov: FloatArray, checks: CheckConfig) -> list[str]:
    found = []
    for part, block, limit, factor, unit in (
        ("rotation", cov[:3, :3], checks.weak_cam_rad, 180.0 / np.pi, "deg"),
        ("translation", cov[3:, 3:], checks.weak_cam_m, 1e3, "mm"),
    ):
        variances, directions = np.linalg.eigh(block)
        sd = float(np.sqrt(variances[-1]))
        if sd > limit:
            way = _direction(directions[:, -1])
            kind = "about" if part == "rotation" else "along"
            found.append(
                f"{name}: its {part} {kind} {way} in camera axes is known to {factor * sd:.2g} "
                f"{unit} only (standard deviation)"
            )
    return found
