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

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.interfaces import NewQueries
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
from akm_fg.perception.tracking.dense_flow import DisFlow, Flow, flow_at
from akm_fg.perception.tracking.tracked_points import Snapshot, TrackedPoints, tracks_of
from akm_fg.records import BoolArray, FloatArray, PixelTracks, RgbdFrame


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
    fits: BoolArray  # (N,)


class FlowTracker:
    """A `PointTracker`; see the module's text for the method."""

    def __init__(self, config: FlowTrackerConfig | None = None) -> None:
        """Set the tuning."""
        self.config = config or FlowTrackerConfig()

    def track(
        self,
        frames: Sequence[RgbdFrame],
        queries_uv: FloatArray,
        query_frames: Sequence[int],
        new_queries: NewQueries | None = None,
    ) -> PixelTracks:
        """Follow pixels (N, 2), each from its frame of `query_frames` (N,) to the end.

        Raises:
            ValueError: queries outside the images or frames.
        """
        uv0 = np.asarray(queries_uv, dtype=np.float64).reshape(-1, 2)
        start = np.asarray(query_frames, dtype=int).reshape(-1)
        _check(frames, uv0, start)
        state, snapshots = TrackedPoints.empty(len(uv0), self.config.patch), list[Snapshot]()
        flow, noise = DisFlow(), self._gradient_noise(frames)
        before: _Image | None = None
        first = 0 if new_queries is not None else int(start.min(initial=len(frames)))
        for t in range(first, len(frames)):
            image = self._prepared(frames[t])
            if before is not None and state.alive.size:
                forth, back = flow.both(before.gray, image.gray)
                self._advance(state, before, image, forth, back, noise)
            self._begin(state, np.flatnonzero(start == t), uv0, image, noise)
            if new_queries is not None:
                more = new_queries(t, state.uv[state.alive])
                uv0, start = np.concatenate([uv0, more]), np.append(start, np.full(len(more), t))
                state = state.joined(TrackedPoints.empty(len(more), self.config.patch))
                self._begin(state, np.arange(len(uv0) - len(more), len(uv0)), uv0, image, noise)
            snapshots.append(state.snapshot(t))
            before = image
        c = self.config
        return tracks_of(snapshots, len(frames), len(uv0), c.floor_sigma_px, c.edge_bend_rad)

    def _gradient_noise(self, frames: Sequence[RgbdFrame]) -> float:
        """Of the images, from the first two; none from a single one."""
        if len(frames) < 2:
            return 0.0
        a, b = (smooth(frame.rgb, self.config.patch) for frame in frames[:2])
        return gradient_noise(a, b)

    def _prepared(self, frame: RgbdFrame) -> _Image:
        gray = np.asarray(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        return _Image(frame, gray, smooth(frame.rgb, self.config.patch))

    def _begin(
        self, s: TrackedPoints, new: NDArray[np.int_], uv0: FloatArray, image: _Image, noise: float
    ) -> None:
        """Start points (indices) at their queries."""
        if not new.size:
            return
        s.uv[new], s.shape[new] = uv0[new], np.eye(2)
        s.cov[new], s.anchor_cov[new] = 0.0, 0.0
        s.depth_m[new] = _depth_around(image.frame, uv0[new], self.config)[0]
        s.alive[new], s.begun[new], s.missed[new] = True, True, 0
        s.templates.put(new, cut_templates(image.smoothed, uv0[new], self.config.patch, noise))

    def _advance(
        self, s: TrackedPoints, before: _Image, image: _Image, forth: Flow, back: Flow, noise: float
    ) -> None:
        """Carry all points that are not given up from the last frame to this one."""
        c = self.config
        tried = np.flatnonzero(s.begun & (s.missed <= c.max_coast))
        if not tried.size:
            return
        was_seen = s.alive[tried]
        step = np.where(was_seen[:, None], flow_at(forth, s.uv[tried]), 0.0)
        predicted = s.uv[tried] + step
        gap = np.linalg.norm(step + flow_at(back, predicted), axis=1)
        gap = np.where(was_seen, gap, 0.0)
        step_cov = self._step_cov(s, tried, step, gap)
        prior = s.cov[tried] + step_cov
        least = np.where(was_seen, c.min_correlation, c.sure_correlation)
        found = self._matched(s, tried, predicted, s.shape[tried], prior, least, image)
        anew = np.flatnonzero(~found.fits & was_seen & (gap < c.max_return_px))
        if anew.size:
            self._anchor_anew(s, tried[anew], before, noise)
            flat = np.tile(np.eye(2), (anew.size, 1, 1))
            again = self._matched(
                s, tried[anew], predicted[anew], flat, step_cov[anew], least[anew], image
            )
            for name in ("uv", "shape", "cov", "fits"):
                getattr(found, name)[anew] = getattr(again, name)
        self._accept(s, tried, found, image.frame)

    def _step_cov(
        self, s: TrackedPoints, tried: NDArray[np.int_], step: FloatArray, gap: FloatArray
    ) -> FloatArray:
        """Covariance (N, 2, 2) of the flow's step: larger where the patch leaves it open.

        Along an edge flow errs the same way step after step: there standard deviations add up.
        Points that were not seen in the last frame may have gone any way along theirs.
        """
        c = self.config
        length = np.linalg.norm(step, axis=1)
        slipped = np.sqrt(np.linalg.eigvalsh(s.cov[tried])[:, 1])
        slip = c.slip_share * length
        slip2 = np.maximum(slip * (slip + 2 * slipped), c.flow_sigma_px**2)
        slip2 = np.where(s.alive[tried], slip2, c.max_slip_px**2)
        open_cov = np.linalg.inv(
            place_information(s.templates, tried, s.shape[tried]) + np.eye(2) / slip2[:, None, None]
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
        c = self.config
        m = match(image.smoothed, s.templates, index, predicted, shape, prior, c.patch)
        shift = np.linalg.norm(m.uv - predicted, axis=1)
        fits = (m.correlation > least_correlation) & (shift < c.max_shift_px)
        return _Found(m.uv, m.shape, m.cov_px2, fits)

    def _anchor_anew(
        self, s: TrackedPoints, index: NDArray[np.int_], before: _Image, noise: float
    ) -> None:
        """Take the patches of the last frame as the points' templates.

        They tell no more of the place than the patches before them: what has come in since, as
        the hand or a shadow, is not on the surface.
        """
        told = place_information(s.templates, index, s.shape[index])
        new = cut_templates(before.smoothed, s.uv[index], self.config.patch, noise)
        s.templates.put(index, replace(new, information=no_more_than(new.information, told)))
        s.anchor_cov[index] += s.cov[index]
        s.cov[index] = 0.0

    def _accept(
        self,
        s: TrackedPoints,
        tried: NDArray[np.int_],
        found: _Found,
        frame: RgbdFrame,
    ) -> None:
        """Keep what was found and can be true; the others are missed in this frame."""
        c = self.config
        depth_m, known = _depth_around(frame, found.uv, c)
        limit = np.where(s.alive[tried], c.max_depth_jump_m, c.max_moved_back_m)
        jumped = np.abs(depth_m - s.depth_m[tried]) > limit
        variance = np.linalg.eigvalsh(found.cov + s.anchor_cov[tried])
        sure = (variance[:, 0] < c.max_sigma_px**2) & (variance[:, 1] < c.max_slip_px**2)
        good = found.fits & (known >= c.min_known) & ~jumped & _inside(frame, found.uv) & sure
        kept = tried[good]
        s.uv[kept], s.shape[kept], s.cov[kept] = (
            found.uv[good],
            found.shape[good],
            found.cov[good],
        )
        s.depth_m[kept] = np.where(np.isfinite(depth_m[good]), depth_m[good], s.depth_m[kept])
        s.alive[tried] = good
        s.missed[tried] = np.where(good, 0, s.missed[tried] + 1)


def _check(frames: Sequence[RgbdFrame], uv: FloatArray, start: NDArray) -> None:
    if len(start) != len(uv):
        raise ValueError(f"{len(uv)} queries, but {len(start)} query frames")
    if len(uv) == 0:
        return
    if start.min() < 0 or start.max() >= len(frames):
        raise ValueError(f"query frames {start.min()}..{start.max()}, frames 0..{len(frames) - 1}")
    if not _inside(frames[0], uv).all():
        raise ValueError("a query lies outside the image, or is not finite")


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
    known = np.isfinite(z)
    some = known.any(axis=1)
    median = np.full(len(uv), np.nan)
    if some.any():
        median[some] = np.nanmedian(z[some], axis=1)
    return median, np.asarray(known.mean(axis=1))
