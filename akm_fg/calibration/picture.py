"""Corners over one image, and the residuals of all views: where a camera model fails, it shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from akm_fg.calibration.records import HandEyeCalibration
from akm_fg.errors import OutputError
from akm_fg.io.recording_reader import colour_file
from akm_fg.io.sources.pictures import read_colour

ARROW_LENGTH_PX = 25.0  # in which a typical residual is drawn


def write_picture(path: Path, result: HandEyeCalibration, folder: Path) -> None:
    """Draw the view of median residual, and the residuals of all views, to a PNG.

    Raises:
        InputError: the image cannot be read any more.
        OutputError: the picture cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 5.2), layout="constrained")
    one, field, cloud = figure.subplots(1, 3, width_ratios=(1.3, 1.3, 1.0))
    _draw_view(one, result, folder)
    _draw_field(field, result)
    _draw_cloud(cloud, result)
    try:
        figure.savefig(path, dpi=110, format="png")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror})") from error


def _draw_view(axes: Any, result: HandEyeCalibration, folder: Path) -> None:
    view = sorted(result.views, key=lambda v: v.rms_px)[len(result.views) // 2]
    c = result.camera
    axes.imshow(read_colour(colour_file(folder, view.frame), c.width, c.height))
    axes.plot(*view.uv.T, "+", color="tab:red", markersize=7, label="found")
    projected = view.uv + view.error_px
    axes.plot(*projected.T, "o", mfc="none", color="tab:cyan", markersize=7, label="projected")
    axes.set_title(f"frame {view.frame}: {view.rms_px:.3f} px rms, the median view")
    axes.legend(loc="lower right")


def _draw_field(axes: Any, result: HandEyeCalibration) -> None:
    """Every residual where it is in the image: a lens that does not fit shows as a pattern."""
    uv = np.concatenate([view.uv for view in result.views])
    error = np.concatenate([view.error_px for view in result.views])
    scale = ARROW_LENGTH_PX / max(result.rms_px, 1e-6)
    axes.quiver(
        *uv.T, *error.T, angles="xy", scale_units="xy", scale=1.0 / scale, width=0.0018, color="0.2"
    )
    axes.set_xlim(0, result.camera.width)
    axes.set_ylim(result.camera.height, 0)
    axes.set_aspect("equal")
    axes.set_title(f"residuals of {len(result.views)} views, {scale:.0f} times enlarged")
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px")


def _draw_cloud(axes: Any, result: HandEyeCalibration) -> None:
    error = np.concatenate([view.error_px for view in result.views])
    axes.plot(*error.T, ".", markersize=3, color="0.2")
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    for factor in (1.0, 2.0):
        radius = factor * result.corner_scale_px
        axes.plot(radius * np.cos(angle), radius * np.sin(angle), color="tab:red", lw=1)
    axes.set_aspect("equal")
    axes.set_title(
        f"residuals; circles: noise scale, once and twice ({result.corner_scale_px:.3f} px)"
    )
    axes.set_xlabel("along u, px")
    axes.set_ylabel("along v, px")
