"""A point tracker without weights: dense flow predicts, the first frame's patch corrects.

From frame to frame, DIS optical flow (Kroeger et al., "Fast optical flow using dense inverse
search", 2016) carries each point on; its covariance grows by that of the flow, which is judged
by going forward and back, and by the texture: along a straight edge flow is a guess, off by a
share of the step. Then the patch of the query frame is matched at the predicted place
under affine change (`affine_match`), which takes the accumulated drift out again, in the
directions in which the patch has gradients. Where that patch no longer fits, a patch of the last
good frame takes its place and the drift up to there stays in the point's covariance.

A point is lost where the robot covers it (no depth all around), where its depth jumps, where
neither patch fits, where flow forth and back disagree, or where its standard deviation has
grown too large in both directions: plain surfaces. A point that was covered is looked for at its
old place for some frames, which brings resting points back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.geometry.batches import eigenvalues, inverses, singular_values
from akm_fg.interfaces import SeenPixels
from akm_fg.perception.tracking.affine_match import (
    AffineMatchConfig,
    GrayImage,
    cut_templates,
    gradient_noise,
    match,
    no_more_than,
    place_information,
    smooth,
)
from akm_fg.perception.tracking.dense_flow import DenseFlow, DisFlow, Flow, flow_at
from akm_fg.perception.tracking.tracked_points import TrackedPoints
from akm_fg.records import BoolArray, FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class FlowTrackerConfig:
    """When a point counts as found."""

    patch: AffineMatchConfig = field(default_factory=AffineMatchConfig)
    flow_sigma_px: float = 0.2  # DIS (fast preset) at rest
    flow_share: float = 0.2  # of a step, on top: on textured, smoothly moving surfaces
    slip_share: float = 1.0  # of the way, how far flow may be off along an edge, where it guesses
    max_return_px: float = 2.0  # forth and back again must meet, unless the patch itself fits
    min_correlation: float = 0.8  # of the patch; 0.7 lets the robot's shadow through
    sure_correlation: float = 0.9  # to accept a point again that was lost
    max_shift_px: float = 4.0  # from the prediction: more is another, similar place
    max_stretch: float = 5.0  # of a patch, or its inverse: turned by 78 deg; an edge fits any
    max_sigma_px: float = 1.5  # in the better direction, 3 mm at 1.2 m: as large as depth noise
    max_slip_px: float = 5.0  # in the other: 1 cm at 1.2 m; edges are straight for so long
    floor_sigma_px: float = 0.06  # sampling and shading errors, which no patch statistic shows
    edge_bend_rad: float = 0.1  # how far an edge's direction is off, where a point has slipped
    max_coast: int = 10  # frames for which a covered point is looked for at its old place
    hole_radius_px: int = 4  # neighbourhood in which depth is looked for: holes are smaller
    min_known: float = 0.35  # of it must have depth, else the robot (or a hole) covers the point
    max_depth_jump_m: float = 0.12  # a frame: a part at 1 m/s seen at 8 Hz
    max_moved_back_m: float = 0.02  # a point found again at its old place must lie as deep


@dataclass(frozen=True, slots=True)
class _Image:
    """A frame, ready for matching and flow."""

    frame: RgbdFrame
    gray: NDArray[np.uint8]
    smoothed: GrayImage


@dataclass(frozen=True, slots=True)
class _Found:
    """Where points were found; rows as tried."""

    uv: FloatArray  # (N, 2)
    shape: FloatArray  # (N, 2, 2)
    cov: FloatArray  # (N, 2, 2) relative to the anchor
    lasting: FloatArray  # (N, 2, 2) of that, what the prediction brought
    fits: BoolArray  # (N,)


class FlowTracker:
    """A `PointTracker`; see the module's text for the method."""

    def __init__(
        self, config: FlowTrackerConfig | None = None, flow: Callable[[], DenseFlow] = DisFlow
    ) -> None:
        """Set the tuning, and what makes the dense flow of a stream."""
        self.config, self._flow = config or FlowTrackerConfig(), flow

    def begin(self) -> FlowSession:
        """Start on a new stream."""
        return FlowSession(self.config, self._flow())


class FlowSession:
    """A `TrackingSession`; memory is that of the points which are not given up."""

    def __init__(self, config: FlowTrackerConfig, flow: DenseFlow) -> None:
        """Nothing is followed yet."""
        self._config, self._flow = config, flow
        self._image: _Image | None = None  # the last frame
        self._points: TrackedPoints | None = None
        self._given = 0  # points so far
        self._noise: float | None = None  # of the gray gradient; two frames tell it

    def advance(self, frame: RgbdFrame) -> SeenPixels:
        """Carry all points on to the next frame."""
        before, self._image = self._image, self._prepared(frame)
        if before is not None and self._noise is None:
            self._noise = gradient_noise(before.smoothed, self._image.smoothed)
            if self._points is not None:  # cut from the first frame
                self._points.templates = self._points.templates.under_noise(
                    self._noise, self._config.patch
                )
        if before is None or self._points is None:
            return SeenPixels.none()
        if self._points.index.size:
            forth, back = self._flow.both(before.gray, self._image.gray)
            self._carry_on(self._points, before, self._image, forth, back)
            self._points = self._points.select(self._points.missed <= self._config.max_coast)
        return self._seen(np.flatnonzero(self._points.alive))

    def follow(self, uv: FloatArray) -> SeenPixels:
        """Cut templates at pixels (K, 2) of the last frame.

        Raises:
            ValueError: no frame yet, or a pixel outside the image.
        """
        image = self._image
        if image is None:
            raise ValueError("no frame yet; expected one to follow points in")
        uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
        if not _inside(image.frame, uv).all():
            raise ValueError("a query lies outside the image, or is not finite")
        if not len(uv):
            return SeenPixels.none()
        index = self._given + np.arange(len(uv))
        self._given += len(uv)
        depth_m = _depth_around(image.frame, uv, self._config)[0]
        templates = cut_templates(image.smoothed, uv, self._config.patch, self._noise or 0.0)
        new = TrackedPoints.at(index, uv, depth_m, templates)
        self._points = new if self._points is None else self._points.joined(new)
        rows = self._points.index.size
        return self._seen(np.arange(rows - len(uv), rows))

    def _seen(self, rows: NDArray[np.int_]) -> SeenPixels:
        """Points of the last frame, with what comes on top of their covariances.

        A floor in every direction; and, as the direction of an edge is known only so well, what
        has slipped along one may be off across it, too: for as long as it has slipped.
        """
        s, c = self._points, self._config
        assert s is not None
        cov, lasting = s.cov[rows] + s.anchor_cov[rows], s.lasting[rows]
        bent = c.edge_bend_rad**2 * eigenvalues(cov)[:, 1, None, None] * np.eye(2)
        floor = c.floor_sigma_px**2 * np.eye(2)
        return SeenPixels(s.index[rows], s.uv[rows], cov + bent + floor, lasting + bent)

    def _prepared(self, frame: RgbdFrame) -> _Image:
        gray = np.asarray(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        return _Image(frame, gray, smooth(frame.rgb, self._config.patch))

    def _carry_on(
        self, s: TrackedPoints, before: _Image, image: _Image, forth: Flow, back: Flow
    ) -> None:
        """Find all points again, from the last frame to this one."""
        c = self._config
        was_seen, every = s.alive, np.arange(s.index.size)
        step = np.where(was_seen[:, None], flow_at(forth, s.uv), 0.0)
        predicted = s.uv + step
        gap = np.linalg.norm(step + flow_at(back, predicted), axis=1)
        gap = np.where(was_seen, gap, 0.0)
        step_cov = self._step_cov(s, step, gap)
        least = np.where(was_seen, c.min_correlation, c.sure_correlation)
        found = self._matched(s, every, predicted, s.shape, s.cov + step_cov, least, image)
        anew = np.flatnonzero(~found.fits & was_seen & (gap < c.max_return_px))
        if anew.size:
            self._anchor_anew(s, anew, before)
            flat = np.tile(np.eye(2), (anew.size, 1, 1))
            again = self._matched(
                s, anew, predicted[anew], flat, step_cov[anew], least[anew], image
            )
            for name in ("uv", "shape", "cov", "lasting", "fits"):
                getattr(found, name)[anew] = getattr(again, name)
        self._accept(s, found, image.frame)

    def _step_cov(self, s: TrackedPoints, step: FloatArray, gap: FloatArray) -> FloatArray:
        """Covariance (N, 2, 2) of the flow's step: larger where the patch leaves it open.

        Along an edge flow errs the same way step after step: there standard deviations add up.
        Points that were not seen in the last frame may have gone any way along theirs.
        """
        c, every = self._config, np.arange(s.index.size)
        length = np.linalg.norm(step, axis=1)
        slipped = np.sqrt(eigenvalues(s.cov)[:, 1])
        slip = c.slip_share * length
        slip2 = np.maximum(slip * (slip + 2 * slipped), c.flow_sigma_px**2)
        slip2 = np.where(s.alive, slip2, c.max_slip_px**2)
        open_cov = inverses(
            place_information(s.templates, every, s.shape) + np.eye(2) / slip2[:, None, None]
        )
        flow2 = c.flow_sigma_px**2 + (c.flow_share * length) ** 2 + gap**2
        return np.asarray(open_cov + flow2[:, None, None] * np.eye(2))

    def _matched(
        self,
        s: TrackedPoints,
        index: NDArray[np.int_],
        predicted: FloatArray,
        shape: FloatArray,
        prior: FloatArray,
        least_correlation: FloatArray,
        image: _Image,
    ) -> _Found:
        """Points found by their templates."""
        c = self._config
        m = match(image.smoothed, s.templates, index, predicted, shape, prior, c.patch)
        shift = np.linalg.norm(m.uv - predicted, axis=1)
        stretch = singular_values(m.shape)
        fits = (m.correlation > least_correlation) & (shift < c.max_shift_px)
        fits &= (stretch[:, 1] > 1 / c.max_stretch) & (stretch[:, 0] < c.max_stretch)
        # Prediction and patch weigh by their informations: the error is the sum of C I e of both.
        lasting = m.cov_px2 @ inverses(prior) @ m.cov_px2
        return _Found(m.uv, m.shape, m.cov_px2, lasting, fits)

    def _anchor_anew(self, s: TrackedPoints, index: NDArray[np.int_], before: _Image) -> None:
        """Take the patches of the last frame as the points' templates.

        They tell no more of the place than the patches before them: what has come in since, as
        the hand or a shadow, is not on the surface.
        """
        told = place_information(s.templates, index, s.shape[index])
        new = cut_templates(before.smoothed, s.uv[index], self._config.patch, self._noise or 0.0)
        s.templates.put(index, replace(new, information=no_more_than(new.information, told)))
        s.anchor_cov[index] += s.cov[index]
        s.cov[index] = 0.0

    def _accept(self, s: TrackedPoints, found: _Found, frame: RgbdFrame) -> None:
        """Keep what was found and can be true; the others are missed in this frame."""
        c = self._config
        depth_m, known = _depth_around(frame, found.uv, c)
        limit = np.where(s.alive, c.max_depth_jump_m, c.max_moved_back_m)
        jumped = np.abs(depth_m - s.depth_m) > limit
        variance = eigenvalues(found.cov + s.anchor_cov)
        sure = (variance[:, 0] < c.max_sigma_px**2) & (variance[:, 1] < c.max_slip_px**2)
        good = found.fits & (known >= c.min_known) & ~jumped & _inside(frame, found.uv) & sure
        s.uv[good], s.shape[good], s.cov[good] = found.uv[good], found.shape[good], found.cov[good]
        s.lasting[good] = found.lasting[good] + s.anchor_cov[good]
        s.depth_m[good] = np.where(np.isfinite(depth_m[good]), depth_m[good], s.depth_m[good])
        s.missed = np.where(good, 0, s.missed + 1)


def _inside(frame: RgbdFrame, uv: FloatArray) -> BoolArray:
    size = np.array([frame.camera.width, frame.camera.height])
    return np.asarray(((uv >= 0) & (uv <= size - 1)).all(axis=1))


def _depth_around(
    frame: RgbdFrame, uv: FloatArray, config: FlowTrackerConfig
) -> tuple[FloatArray, FloatArray]:
    """Median depth (N,) near pixels (N, 2), and the share of readings that are known (N,)."""
    r = config.hole_radius_px
    dv, du = (d.ravel() for d in np.mgrid[-r : r + 1, -r : r + 1])
    whole = np.rint(np.nan_to_num(uv, nan=-1e6)).astype(int)
    u = np.clip(whole[:, :1] + du, 0, frame.camera.width - 1)
    v = np.clip(whole[:, 1:] + dv, 0, frame.camera.height - 1)
    z = frame.depth_m[v, u].astype(np.float64)
    count = np.isfinite(z).sum(axis=1)
    ordered = np.sort(z, axis=1)  # unknown ones last
    middle = np.stack([(count - 1) // 2, count // 2], axis=1).clip(0)
    median = np.take_along_axis(ordered, middle, axis=1).mean(axis=1)  # NaN where none is known
    return median, count / z.shape[1]
