"""A point tracker without weights: dense flow predicts, the first frame's patch corrects.

From frame to frame, DIS optical flow (Kroeger et al., "Fast optical flow using dense inverse
search", 2016) carries each point on; its variance grows by that of the flow, which is judged
by going forward and back. Then the patch of the query frame is matched at the predicted place
under affine change (`affine_match`), which takes the accumulated drift out again. Where that
patch no longer fits, a patch of the last good frame takes its place and the drift up to there
stays in the point's variance.

A point is lost where the robot covers it (no depth all around), where its depth jumps, where
neither patch fits, where flow forth and back disagree, or where its standard deviation has
grown too large: plain surfaces. A point that was covered is looked for at its old place for
some frames, which brings resting points back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.affine_match import (
    AffineMatchConfig,
    GrayImage,
    Matches,
    Templates,
    cut_templates,
    match,
    smooth,
)
from akm_fg.records import BoolArray, FloatArray, PixelTracks, RgbdFrame


@dataclass(frozen=True, slots=True)
class FlowTrackerConfig:
    """When a point counts as found."""

    patch: AffineMatchConfig = field(default_factory=AffineMatchConfig)
    flow_sigma_px: float = 0.7  # DIS (fast preset) on textured, smoothly moving surfaces
    max_return_px: float = 2.0  # forth and back again must meet, unless the patch itself fits
    min_correlation: float = 0.8  # of the patch; 0.7 lets the robot's shadow through
    sure_correlation: float = 0.9  # to accept a point again that was lost
    max_shift_px: float = 4.0  # from the prediction: more is another, similar place
    max_sigma_px: float = 1.5  # 3 mm at 1.2 m: as large as the depth noise
    floor_sigma_px: float = 0.1  # sampling and shading errors, which no patch statistic shows
    match_scale: float = 1.0  # calibration of the patch's variance, see the tests
    max_coast: int = 10  # frames for which a covered point is looked for at its old place
    hole_radius_px: int = 4  # neighbourhood in which depth is looked for: holes are smaller
    min_known: float = 0.35  # of it must have depth, else the robot (or a hole) covers the point
    max_depth_jump_m: float = 0.12  # a frame: a part at 1 m/s seen at 8 Hz
    max_moved_back_m: float = 0.02  # a point found again at its old place must lie as deep


@dataclass(slots=True)
class _State:
    """All points at the current frame; rows are points."""

    uv: FloatArray  # (N, 2)
    shape: FloatArray  # (N, 2, 2) relative to the anchor
    drift: FloatArray  # (N,) variance of uv, px^2
    anchor_drift: FloatArray  # (N,) variance of the anchor relative to the query, px^2
    depth_m: FloatArray  # (N,) when last seen
    alive: BoolArray  # (N,) seen in the last frame
    missed: NDArray[np.int_]  # (N,) frames since it was last seen; too many: given up
    templates: Templates


class FlowTracker:
    """A `PointTracker`; see the module's text for the method."""

    def __init__(self, config: FlowTrackerConfig | None = None) -> None:
        """Set the tuning."""
        self.config = config or FlowTrackerConfig()

    def track(
        self, frames: Sequence[RgbdFrame], queries_uv: FloatArray, query_frames: Sequence[int]
    ) -> PixelTracks:
        """Follow pixels (N, 2), each from its frame of `query_frames` (N,) to the end.

        Raises:
            ValueError: queries outside the images or frames.
        """
        uv0 = np.asarray(queries_uv, dtype=np.float64).reshape(-1, 2)
        start = np.asarray(query_frames, dtype=int).reshape(-1)
        _check(frames, uv0, start)
        T, N = len(frames), len(uv0)
        uv, sigma_px = np.full((T, N, 2), np.nan), np.full((T, N), np.nan)
        state = _empty(N, self.config)
        flow = _DisFlow()
        before: tuple[GrayImage, NDArray[np.uint8]] | None = None
        for t in range(int(start.min(initial=T)), T):
            gray = np.asarray(cv2.cvtColor(frames[t].rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
            image = smooth(frames[t].rgb, self.config.patch)
            if before is not None:
                self._advance(state, frames[t], before[0], image, *flow.both(before[1], gray))
            self._begin(state, np.flatnonzero(start == t), uv0, frames[t], image)
            seen = state.alive
            uv[t, seen] = state.uv[seen]
            sigma_px[t, seen] = np.sqrt(state.drift[seen] + self.config.floor_sigma_px**2)
            before = (image, gray)
        return PixelTracks(uv, np.isfinite(sigma_px), sigma_px)

    def _begin(
        self, s: _State, new: NDArray, uv0: FloatArray, frame: RgbdFrame, image: GrayImage
    ) -> None:
        """Start points (indices) at their queries."""
        if not new.size:
            return
        s.uv[new], s.shape[new] = uv0[new], np.eye(2)
        s.drift[new], s.anchor_drift[new] = 0.0, 0.0
        s.depth_m[new] = _depth_around(frame, uv0[new], self.config)[0]
        s.alive[new], s.missed[new] = True, 0
        s.templates.put(new, cut_templates(image, uv0[new], self.config.patch))

    def _advance(
        self,
        s: _State,
        frame: RgbdFrame,
        old_image: GrayImage,
        image: GrayImage,
        forth: NDArray[np.float32],
        back: NDArray[np.float32],
    ) -> None:
        """Carry all points that are not given up from the last frame to this one."""
        c = self.config
        tried = np.flatnonzero(s.missed <= c.max_coast)
        if not tried.size:
            return
        was_seen = s.alive[tried]
        step = _at(forth, s.uv[tried])
        predicted = s.uv[tried] + np.where(was_seen[:, None], step, 0)
        gap = np.where(was_seen, np.linalg.norm(step + _at(back, predicted), axis=1), 0)
        returned = gap < c.max_return_px
        step_var = c.flow_sigma_px**2 + gap**2
        prior = np.sqrt(np.where(was_seen, s.drift[tried], 0) + step_var)
        m = match(image, s.templates, tried, predicted, s.shape[tried], prior, c.patch)
        shift = np.linalg.norm(m.uv - predicted, axis=1)
        fits = (m.correlation > np.where(was_seen, c.min_correlation, c.sure_correlation)) & (
            shift < c.max_shift_px
        )
        uv, shape = m.uv, m.shape
        drift = s.anchor_drift[tried] + c.match_scale * m.sigma_px**2

        anew = np.flatnonzero(~fits & was_seen & returned)
        if anew.size:
            i = tried[anew]
            n = self._anchor_anew(s, i, predicted[anew], step_var[anew], old_image, image)
            shift = np.linalg.norm(n.uv - predicted[anew], axis=1)
            fits[anew] = (n.correlation > c.min_correlation) & (shift < c.max_shift_px)
            uv[anew], shape[anew] = n.uv, n.shape
            drift[anew] = s.anchor_drift[i] + c.match_scale * n.sigma_px**2
        depth_m, known = _depth_around(frame, uv, c)
        limit = np.where(was_seen, c.max_depth_jump_m, c.max_moved_back_m)
        jumped = np.abs(depth_m - s.depth_m[tried]) > limit
        inside = _inside(frame, uv)
        good = fits & (known >= c.min_known) & ~jumped & inside & (drift < c.max_sigma_px**2)
        found = tried[good]
        s.uv[found], s.shape[found], s.drift[found] = uv[good], shape[good], drift[good]
        s.depth_m[found] = np.where(np.isfinite(depth_m[good]), depth_m[good], s.depth_m[found])
        s.alive[tried] = good
        s.missed[tried] = np.where(good, 0, s.missed[tried] + 1)

    def _anchor_anew(
        self,
        s: _State,
        index: NDArray,
        predicted: FloatArray,
        step_var: FloatArray,
        old_image: GrayImage,
        image: GrayImage,
    ) -> Matches:
        """Find points whose query patch no longer fits by their patch of the last frame."""
        patch = self.config.patch
        s.templates.put(index, cut_templates(old_image, s.uv[index], patch))
        s.anchor_drift[index] = s.drift[index]
        flat = np.tile(np.eye(2), (len(index), 1, 1))
        return match(image, s.templates, index, predicted, flat, np.sqrt(step_var), patch)


class _DisFlow:
    """Dense flow between two gray images, forth and back."""

    def __init__(self) -> None:
        self._dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)

    def both(
        self, a: NDArray[np.uint8], b: NDArray[np.uint8]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(H, W, 2) from a to b and from b to a."""
        empty: Any = None  # no start value; the stubs do not allow it
        forth, back = self._dis.calc(a, b, empty), self._dis.calc(b, a, empty)
        return np.asarray(forth, dtype=np.float32), np.asarray(back, dtype=np.float32)


def _empty(n: int, config: FlowTrackerConfig) -> _State:
    pixels = (2 * config.patch.radius_px + 1) ** 2
    return _State(
        uv=np.zeros((n, 2)),
        shape=np.tile(np.eye(2), (n, 1, 1)),
        drift=np.zeros(n),
        anchor_drift=np.zeros(n),
        depth_m=np.full(n, np.nan),
        alive=np.zeros(n, dtype=bool),
        missed=np.full(n, config.max_coast + 1),
        templates=Templates(
            np.zeros((n, pixels), np.float32),
            np.zeros((n, pixels, 6), np.float32),
            np.zeros((n, 6, 6)),
        ),
    )


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


def _at(flow: NDArray[np.float32], uv: FloatArray) -> FloatArray:
    """Flow (N, 2) at sub-pixel places (N, 2)."""
    u, v = (uv[:, i].astype(np.float32)[None] for i in (0, 1))
    values = cv2.remap(flow, u, v, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    return np.asarray(values[0], dtype=np.float64)


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
