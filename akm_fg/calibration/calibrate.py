"""Views of a board and robot poses to a calibrated camera: checks, OpenCV's start, one graph."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from akm_fg.calibration.checks import (
    LEAST_VIEWS,
    doubts,
    require_small,
    require_square,
    require_turns,
    require_views,
    stray_words,
    strays,
    typical_px,
)
from akm_fg.calibration.consistency import agreeing_views
from akm_fg.calibration.graph import BOARD, CAM, GraphFit, solve
from akm_fg.calibration.initial import Start, ViewsAlone, find_start, views_alone
from akm_fg.calibration.records import (
    INTRINSICS,
    CalibrationConfig,
    CalibrationViews,
    HandEyeCalibration,
    LeftOut,
    ViewResidual,
)
from akm_fg.records import BoolArray, PinholeCamera
from factors.measurements.board_view import INTRINSICS as CAL3DS2

STRAY_ROUNDS = 4  # in each of which views may be left out


def calibrate(
    data: CalibrationViews, config: CalibrationConfig | None = None
) -> HandEyeCalibration:
    """Estimate intrinsics, the camera's pose and the board's, with their covariances.

    Raises:
        InputError: too few views, or a board that is not as large as it says.
        AxisUnobservable: the poses leave a direction of a variable open.
    """
    config = config or CalibrationConfig()
    require_views(data)
    warnings = require_turns(data, config)
    alone = views_alone(data, config)
    kept, left_out, told = agreeing_views(data, config, alone)
    data, alone = _chosen(data, kept), alone.chosen(kept)
    start = find_start(data, config, alone)
    require_square(data, config, start)
    data, fit, strays = _without_strays(data, config, alone, start)
    require_small(data, config, fit)
    order = [CAL3DS2.index(name) for name in INTRINSICS]
    free = _free(config)
    numbers = np.where(free, fit.intrinsics[order], start.intrinsics[order])
    return HandEyeCalibration(
        name=data.name,
        camera_place=config.camera_place,
        camera=PinholeCamera(data.camera.width, data.camera.height, *numbers[:4].tolist()),
        distortion=numbers[4:],
        intrinsics_cov=fit.intrinsics_cov[np.ix_(order, order)] * np.outer(free, free),
        T_mount_cam=fit.values.atPose3(CAM),
        T_mount_cam_cov=fit.cam_cov,
        T_holder_board=fit.values.atPose3(BOARD),
        T_holder_board_cov=fit.board_cov,
        corner_scale_px=fit.scale_px,
        views=_residuals(data, fit),
        skipped=data.skipped,
        left_out=tuple(sorted((*left_out, *strays), key=lambda view: view.frame)),
        warnings=data.notes + warnings + told + stray_words(strays) + doubts(data, config, fit),
    )


def _chosen(data: CalibrationViews, kept: BoolArray) -> CalibrationViews:
    """Some of the views, (V,)."""
    views = tuple(view for view, keep in zip(data.views, kept, strict=True) if keep)
    return replace(data, views=views)


def _without_strays(
    data: CalibrationViews, config: CalibrationConfig, alone: ViewsAlone, start: Start
) -> tuple[CalibrationViews, GraphFit, tuple[LeftOut, ...]]:
    """The fit of what agrees with it; views that do not are left out, the worst first."""
    fit, out = solve(data, config, start), []
    for _ in range(STRAY_ROUNDS):
        bad = strays(data, config, fit)
        if not bad.any() or len(data.views) - int(bad.sum()) < LEAST_VIEWS:
            break
        off_px = [typical_px(e) for e in fit.errors_px]
        out += [LeftOut(data.views[i].frame, off_px[i]) for i in np.flatnonzero(bad)]
        data, alone = _chosen(data, ~bad), alone.chosen(~bad)
        fit = solve(data, config, find_start(data, config, alone))
    return data, fit, tuple(out)


def _free(config: CalibrationConfig) -> BoolArray:
    """(8,) which intrinsics are estimated; the graph holds the others to a millionth of a pixel."""
    count = 0 if config.fixed_intrinsics else len(INTRINSICS) if config.distortion else 4
    return np.arange(len(INTRINSICS)) < count


def _residuals(data: CalibrationViews, fit: GraphFit) -> tuple[ViewResidual, ...]:
    return tuple(
        ViewResidual(
            view.frame,
            view.uv,
            error,
            robot_shift_m=float(np.linalg.norm(robot[3:])),
            robot_turn_rad=float(np.linalg.norm(robot[:3])),
        )
        for view, error, robot in zip(data.views, fit.errors_px, fit.robot_errors, strict=True)
    )
