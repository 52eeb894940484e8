"""Draws tracks and the joint axis with its uncertainty into a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.posterior import JointPosterior
from akm_fg.records import FloatArray, JointTruth, RgbdFrame
from akm_fg.report.axis_image import AxisInImage, axis_of_joint, project_axis
from akm_fg.report.summary import PartTracks
from factors.joint import JointKind

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

_SUBPIXEL_BITS = 4  # of OpenCV's fixed-point coordinates


@dataclass(frozen=True, slots=True)
class OverlayConfig:
    """Looks. Colours (RGB) are told apart by the colour blind too."""

    moving: Colour = (255, 128, 14)
    static: Colour = (40, 160, 255)
    rejected: Colour = (170, 170, 170)
    axis: Colour = (230, 0, 150)
    outline: Colour = (255, 255, 255)
    truth: Colour = (20, 20, 20)
    band_alpha: float = 0.35
    tail_frames: int = 10
    reach_m: float = 0.5  # of a hinge axis to either side of the pivot
    arrow_m: float = 0.25  # of a sliding direction
    min_width_px: int = 960  # smaller frames are enlarged by whole factors for fine lines
    dash_px: float = 12.0  # of the true axis, in the enlarged image
    thin_band_px: float = 4.0  # half width there below which the line hides its band
    visible_band_px: float = 12.0  # half width to which a thinner one is magnified
    jpeg_quality: int = 85


@dataclass(frozen=True, slots=True)
class _Canvas:
    """An enlarged image; takes coordinates of the original."""

    rgb: Image
    scale: int

    def fixed(self, uv: FloatArray) -> NDArray[np.int32]:
        """Fixed-point coordinates (..., 2) of pixels; pixel centres stay pixel centres."""
        placed = (uv + 0.5) * self.scale - 0.5
        return np.rint(placed * 2**_SUBPIXEL_BITS).astype(np.int32)

    def lines(self, uv: FloatArray, colour: Colour, width: int, closed: bool = False) -> None:
        """A polyline (S, 2)."""
        cv2.polylines(
            self.rgb, [self.fixed(uv)], closed, colour, width, cv2.LINE_AA, _SUBPIXEL_BITS
        )

    def disc(self, uv: FloatArray, colour: Colour, radius_px: float) -> None:
        """A filled circle; the radius in pixels of the enlarged image."""
        centre = tuple(int(x) for x in self.fixed(uv))
        radius = round(radius_px * 2**_SUBPIXEL_BITS)
        cv2.circle(self.rgb, centre, radius, colour, -1, cv2.LINE_AA, _SUBPIXEL_BITS)

    def fill(self, uv: FloatArray, colour: Colour, alpha: float) -> None:
        """A translucent polygon (S, 2)."""
        mask = np.zeros(self.rgb.shape[:2], np.uint8)
        cv2.fillPoly(mask, [self.fixed(uv)], 255, cv2.LINE_AA, _SUBPIXEL_BITS)
        x, y, width, height = cv2.boundingRect(mask)
        box = slice(y, y + height), slice(x, x + width)
        weight = alpha * mask[box][..., None] / 255.0
        blended = self.rgb[box] * (1 - weight) + np.array(colour) * weight
        self.rgb[box] = np.rint(blended).astype(np.uint8)


def enlargement(width_px: int, config: OverlayConfig) -> int:
    """Whole factor by which a frame of this width is enlarged before drawing."""
    return max(1, -(-config.min_width_px // width_px))


def region_name(kind: JointKind) -> str:
    """What the 95 % region of an axis looks like."""
    return "band" if kind.turns else "cone"


def draw_frame(
    frame: RgbdFrame,
    index: int,
    tracks: PartTracks | None,
    joint: JointPosterior | None,
    state: float = 0.0,
    truth: JointTruth | None = None,
    config: OverlayConfig | None = None,
    magnification: int = 1,
) -> Image:
    """One frame with everything that is known of it.

    Args:
        frame: the picture and its camera.
        index: of the frame in the tracks.
        tracks: dots where the points are now, tails where they were.
        joint: hinge axis with its 95 % band, or sliding direction with its 95 % cone.
        state: of the joint in this frame, metres or radians; NaN where unknown.
        truth: its axis, dashed.
        config: looks.
        magnification: of the axis' uncertainty where it is too small to be seen.

    Returns:
        RGB (k H, k W, 3), k the whole factor that reaches `min_width_px`.
    """
    config = config or OverlayConfig()
    canvas = _canvas_of(frame, config)
    drawn = None if joint is None else _drawn_axis(frame, joint, state, magnification, config)
    if joint is not None and drawn is not None:  # below the dots, which keep their colours
        _draw_region(canvas, *drawn, joint.kind, config)
    if tracks is not None and index < len(tracks.pixels.visible):
        _draw_tracks(canvas, index, tracks, config)
    if joint is not None and drawn is not None:
        _draw_line(canvas, *drawn, config)
        if truth is not None and truth.kind == joint.kind:
            _draw_truth(canvas, frame, joint, state, truth, config)
        if magnification != 1:
            _draw_words(canvas, f"95 % {region_name(joint.kind)} drawn {magnification} x as wide")
    return canvas.rgb


def _canvas_of(frame: RgbdFrame, config: OverlayConfig) -> _Canvas:
    scale = enlargement(frame.camera.width, config)
    size = (frame.camera.width * scale, frame.camera.height * scale)
    enlarged = cv2.resize(frame.rgb, size, interpolation=cv2.INTER_CUBIC)
    return _Canvas(np.array(enlarged, dtype=np.uint8), scale)


def _draw_tracks(canvas: _Canvas, index: int, tracks: PartTracks, config: OverlayConfig) -> None:
    rejected = ~(tracks.moving | tracks.static)
    layers = (
        (rejected, config.rejected),
        (tracks.static, config.static),
        (tracks.moving, config.moving),
    )
    first = max(0, index - config.tail_frames)
    uv = tracks.pixels.uv[first : index + 1]
    seen = tracks.pixels.visible[first : index + 1] & np.isfinite(uv).all(axis=2)
    for members, colour in layers:
        for i in np.flatnonzero(members & seen[-1]):
            tail = uv[seen[:, i], i]
            if len(tail) > 1:
                canvas.lines(tail, colour, 1)
        for i in np.flatnonzero(members & seen[-1]):
            canvas.disc(uv[-1, i], (0, 0, 0), 4.0)
            canvas.disc(uv[-1, i], colour, 3.0)


def _drawn_axis(
    frame: RgbdFrame,
    joint: JointPosterior,
    state: float,
    magnification: int,
    config: OverlayConfig,
) -> tuple[AxisInImage, FloatArray] | None:
    """The axis and its 95 % ellipse (n, 2); None where the camera does not see it."""
    joint = replace(joint, cov=joint.cov * magnification**2)
    reach = config.reach_m if joint.turns else config.arrow_m
    axis = axis_of_joint(joint, state, frame.camera, frame.T_world_cam, reach)
    if len(axis.uv) < 2:
        return None
    return axis, axis.ellipse(0.0 if joint.turns else reach)


def _draw_region(
    canvas: _Canvas, axis: AxisInImage, ellipse: FloatArray, kind: JointKind, config: OverlayConfig
) -> None:
    """The band of a hinge axis, the cone of a sliding direction."""
    if not kind.turns:
        cone = np.concatenate([axis.uv[:1], ellipse]).astype(np.float32)
        hull = np.asarray(cv2.convexHull(cone)[:, 0], dtype=np.float64)
        canvas.fill(hull, config.axis, config.band_alpha)
    elif np.isfinite(axis.normal).all():
        canvas.fill(axis.band(), config.axis, config.band_alpha)


def _draw_line(
    canvas: _Canvas, axis: AxisInImage, ellipse: FloatArray, config: OverlayConfig
) -> None:
    canvas.lines(axis.uv, config.outline, 5)
    canvas.lines(axis.uv, config.axis, 3)
    _draw_arrow_head(canvas, axis, config)
    canvas.lines(ellipse, config.outline, 2, closed=True)
    start = axis.uv[int(np.argmin(np.abs(axis.along_m)))]
    canvas.disc(start, config.outline, 6.0)
    canvas.disc(start, config.axis, 4.0)


def _draw_words(canvas: _Canvas, words: str) -> None:
    """In the lower left corner, dark on light."""
    font, size = cv2.FONT_HERSHEY_SIMPLEX, canvas.rgb.shape[1] / 1400
    (width, height), below = cv2.getTextSize(words, font, size, 1)
    bottom = canvas.rgb.shape[0]
    box = slice(bottom - height - below - 14, bottom), slice(0, width + 16)
    canvas.rgb[box] = canvas.rgb[box] // 5 + 204
    at = (8, bottom - below - 5)
    cv2.putText(canvas.rgb, words, at, font, size, (20, 20, 20), 1, cv2.LINE_AA)


def _draw_arrow_head(canvas: _Canvas, axis: AxisInImage, config: OverlayConfig) -> None:
    """At the end of the axis that the image shows."""
    height, width = canvas.rgb.shape[:2]
    margin = 12.0 / canvas.scale
    limit = np.array([width, height]) / canvas.scale - margin
    inside = ((axis.uv > margin) & (axis.uv < limit)).all(axis=1)
    tips = np.flatnonzero(inside & np.isfinite(axis.normal).all(axis=1))
    if not tips.size:
        return
    tip = axis.uv[tips[-1]]
    across = axis.normal[tips[-1]]
    forward = np.array([across[1], -across[0]])
    long, wide = 18.0 / canvas.scale, 8.0 / canvas.scale
    head = np.stack([tip + forward * 2 / canvas.scale, tip - long * forward + wide * across])
    head = np.concatenate([head, [tip - long * forward - wide * across]])
    canvas.fill(head, config.axis, 1.0)
    canvas.lines(head, config.outline, 1, closed=True)


def _draw_truth(
    canvas: _Canvas,
    frame: RgbdFrame,
    joint: JointPosterior,
    state: float,
    truth: JointTruth,
    config: OverlayConfig,
) -> None:
    """The true axis, dashed, opposite the estimate's drawn part."""
    sign = -1.0 if np.dot(joint.axis, truth.axis) < 0 else 1.0
    reach = config.reach_m if joint.turns else config.arrow_m
    T = np.eye(4)
    T[:3, 2] = sign * truth.axis
    T[:3, 3] = joint.T_world_joint[:3, 3]
    if truth.pivot is not None:
        T[:3, 3] = truth.pivot + np.dot(T[:3, 3] - truth.pivot, truth.axis) * truth.axis
    elif np.isfinite(state):
        T[:3, 3] += state * joint.axis
    start = -reach if joint.turns else 0.0
    along = np.linspace(start, reach, 101)
    line = project_axis(T, np.zeros((6, 6)), frame.camera, frame.T_world_cam, along).uv
    if len(line) < 2:
        return
    length_px = float(np.linalg.norm(line[-1] - line[0])) * canvas.scale
    n = max(2, 2 * round(length_px / (2 * config.dash_px)))
    line = np.linspace(line[0], line[-1], n)
    for i in range(0, len(line) - 1, 2):
        canvas.lines(line[i : i + 2], config.outline, 3)
        canvas.lines(line[i : i + 2], config.truth, 1)
