"""Does the camera stand still, or go as it is said to? What should stand still tells it.

Corners of the first frame that lie off the object are looked for in later frames. Where the camera
stands still they stay in their pixels; else most of them go as one rigid motion of the camera has
it, p_t = Exp(xi) T_t_0 p_0 with the T_t_0 that is said and a xi that should be zero (tangent order
of GTSAM, increment on the left; fitted robustly to the pixels). Plain surroundings have no corners:
there the planes of the first frame must lie where later depth shows them.

A picture that holds nothing but the object cannot tell a camera that moves from an object that
does: it is doubted only where next to nothing in it stands still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import DepthPlanesConfig, PlaneSamples, depth_planes
from akm_fg.perception.depth.other_view import same_view, stands_still
from akm_fg.perception.tracking.lifting import local_depth
from akm_fg.perception.tracking.seeding import SeedingConfig, seed_points
from akm_fg.records import BoolArray, Doubt, FloatArray, RgbdFrame
from factors.joint import skew
from factors.student_t import weight

_MAD = 1.4826  # standard deviation of a Gaussian over its median absolute deviation


@dataclass(frozen=True, slots=True)
class CameraMotionConfig:
    """What counts as a camera that moved."""

    corners: SeedingConfig = field(default_factory=lambda: SeedingConfig(number=100))
    planes: DepthPlanesConfig = field(default_factory=DepthPlanesConfig)
    least_corners: int = 15  # found again; six numbers are fitted to twice as many
    margin_px: int = 12  # around the object, of a picture of 640: shadows and what opens
    window_px: int = 15  # of a corner that is looked for
    levels: int = 3  # of halved pictures, for hands that shake by 50 pixels
    return_px: float = 0.5  # forth and back again must meet
    floor_px: float = 0.1  # of one corner: shading that changes, JPEG
    least_px: float = 0.25  # mean shift of the picture; less is what shadows and exposure do
    least_m: float = 0.001  # and at the object: 3 mm of sway are to be seen
    sigmas: float = 4.0  # of the mean shift
    agreeing: float = 0.5  # of the corners, with one motion: what stands still is the majority
    agreeing_sigmas: float = 4.0
    agreeing_way: float = 0.25  # of the shift, or so much off: large motions are not linear
    still_share: float = 0.15  # of all corners, where there is nothing but the object
    frames: int = 12  # compared with the first, 8 ms each
    least_frames: int = 2  # off, where so many and more are compared: one may be blurred
    least_tracks: int = 20  # if it moves: outlines that slide are corners of plain parts too
    dof: float = 3.0  # of the Student-t weights: hands and shadows are common
    iterations: int = 10
    pixels: int = 3000  # of depth, where there are no corners
    independent: float = 200.0  # of them at most: depth errs in large patches
    depth_share: float = 0.001  # of the distance, by which depth as a whole wavers

    def few_tracks(self, frames: Sequence[RgbdFrame], tracks_used: int) -> list[Doubt]:
        """About an answer that rests on so many tracks."""
        if tracks_used >= self.least_tracks or stands_still(frames):
            return []
        few = f"only {tracks_used} points tell the motion before a camera that moves"
        expected = f"expected at least {self.least_tracks}, or a camera that stands still"
        return [Doubt(f"{few}; {expected}")]


@dataclass(frozen=True, slots=True)
class CameraShift:
    """How far what should stand still is from where it was."""

    off_m: float  # root mean square, at the object's distance
    moved: bool  # beyond noise and tolerance


@dataclass(frozen=True, slots=True)
class CameraMotion:
    """What some frames said against the first."""

    frame: int  # from which the camera was off
    off_m: float  # the most
    said: bool  # whether poses are said that differ from frame to frame

    def doubt(self) -> Doubt:
        """In words."""
        off = f"what stands still is off by up to {1e3 * self.off_m:.1f} mm from frame {self.frame}"
        if self.said:
            return Doubt(f"{off} on; expected T_world_cam to be the camera's pose in every frame")
        expected = "a camera that stands still, or T_world_cam for every frame (N x 4 x 4)"
        return Doubt(f"the camera moved: {off} on; expected {expected}")


@dataclass(frozen=True, slots=True)
class _Fit:
    """xi with its covariance, and what of the rows goes with it."""

    xi: FloatArray  # (6,)
    cov: FloatArray  # (6, 6)
    agreeing: float  # share of the rows


class StillCamera:
    """Compares frames with the first.

    Args:
        first: the frame.
        object_mask: (H, W) the object in it.
        noise: of the depth.
        config: tuning.
    """

    def __init__(
        self,
        first: RgbdFrame,
        object_mask: BoolArray,
        noise: DepthNoiseModel,
        config: CameraMotionConfig | None = None,
    ) -> None:
        self._config = c = config or CameraMotionConfig()
        self._first, self._noise = first, noise
        width = 2 * round(c.margin_px * first.camera.width / 640) + 1
        around = cv2.dilate(object_mask.astype(np.uint8), np.ones((width, width), np.uint8)) > 0
        self._background = np.asarray(~around & np.isfinite(first.depth_m))
        on_object = first.depth_m[object_mask & np.isfinite(first.depth_m)]
        self._object_m = float(np.median(on_object)) if on_object.size else 1.0
        self._gray = _gray(first)
        self._uv = self._corners(self._background)
        self._alone = len(self._uv) < c.least_corners and not self._plain_background()
        if self._alone:
            self._uv = self._corners(np.isfinite(first.depth_m))
        z = local_depth(first, self._uv, noise).depth_m
        self._uv, z = self._uv[np.isfinite(z)], z[np.isfinite(z)]
        self._p_cam = first.camera.back_project(self._uv, z)
        self._planes: tuple[FloatArray, PlaneSamples, float] | None = None
        self._known: dict[int, CameraShift | None] = {}

    def _corners(self, mask: BoolArray) -> FloatArray:
        return seed_points(self._first, mask, np.random.default_rng(0), self._config.corners)

    def _plain_background(self) -> bool:
        """Whether there is depth enough beside the object."""
        return bool(self._background.mean() > self._config.agreeing / 2)

    def shift(self, number: int, frame: RgbdFrame) -> CameraShift | None:
        """Of a frame of this number; None where too little is seen again to tell."""
        if number not in self._known:
            found = self._by_corners(frame)
            if found is None and not self._alone and self._plain_background():
                found = self._by_depth(frame)
            self._known[number] = found
        return self._known[number]

    def motion(self, frames: dict[int, RgbdFrame]) -> CameraMotion | None:
        """Of some frames by their numbers; None where the camera does what is said of it."""
        c, numbers = self._config, sorted(frames)
        picks = self._picked(np.array(numbers))
        told = {number: self.shift(number, frames[number]) for number in picks}
        known = {k: s for k, s in told.items() if s is not None}
        moved = [k for k, s in known.items() if s.moved]
        if len(moved) < (c.least_frames if len(known) > c.least_frames else 1):
            return None
        said = not stands_still(frames.values())
        return CameraMotion(moved[0], max(known[k].off_m for k in moved), said)

    def _picked(self, numbers: NDArray[np.int_]) -> list[int]:
        """Of frames (numbers, growing), those to compare: spread evenly, but for those known."""
        spread = np.linspace(0, numbers.size - 1, self._config.frames)[1:]
        reach = 0.5 * (numbers.size - 1) / max(self._config.frames - 1, 1)
        known = np.flatnonzero(np.isin(numbers[1:], list(self._known))) + 1
        picks = set()
        for place in spread:
            near = known[np.abs(known - place) <= reach]
            nearest = near[np.abs(near - place).argmin()] if near.size else round(place)
            picks.add(int(numbers[int(nearest)]))
        return sorted(picks - {int(numbers[0])})

    def _by_corners(self, frame: RgbdFrame) -> CameraShift | None:
        c, camera = self._config, self._first.camera
        if len(self._uv) < c.least_corners:
            return None
        said = frame.T_world_cam.inverse() * self._first.T_world_cam
        p_cam = self._p_cam @ said.rotation().matrix().T + said.translation()
        expected = camera.project(p_cam)
        uv, found = _found_again(self._gray, _gray(frame), self._uv, expected, c)
        if found.sum() < c.least_corners:
            return None
        p, e = p_cam[found], (uv - expected)[found]
        J = _pixel_rows(camera.fx, camera.fy, p)
        fit = _fitted(e, J, c.floor_px, c)
        if fit.agreeing < c.agreeing:
            return None
        off_px = float(np.sqrt(((J @ fit.xi) ** 2).sum(axis=1).mean()))
        per_px = self._object_m / camera.fx
        sd_px = float(np.sqrt(np.einsum("nij,jk,nik->n", J, fit.cov, J).mean()))
        beyond = off_px > max(c.least_px, c.least_m / per_px, c.sigmas * sd_px)
        if self._alone and beyond:
            still = np.linalg.norm(e, axis=1) < c.least_px + c.sigmas * c.floor_px
            beyond = bool(still.mean() < c.still_share)
        return CameraShift(off_px * per_px, bool(beyond))

    def _by_depth(self, frame: RgbdFrame) -> CameraShift | None:
        """By the planes of what is beside the object, where the camera is said to stand still."""
        c, first = self._config, self._first
        if not same_view(first, frame):
            return None
        uv, at, independent = self._surroundings()
        u, v = uv.astype(int).T
        z = frame.depth_m[v, u].astype(np.float64)
        T = first.T_world_cam
        p = (at.p_world - T.translation()) @ T.rotation().matrix()
        n = at.normal_world @ T.rotation().matrix()
        e = ((first.camera.back_project(uv, z) - p) * n).sum(axis=1)
        known = np.isfinite(e)
        if known.sum() < c.least_corners:
            return None
        p, n, e = p[known], n[known], e[known]
        J = np.concatenate([np.cross(p, n), n], axis=1)[:, None]
        floor_m = float(np.median(at.sigma_normal_m[known]))
        fit = _fitted(e[:, None], J, floor_m, c)
        if fit.agreeing < c.agreeing:
            return None
        way = J[:, 0] @ fit.xi
        sd_m = np.einsum("ni,ij,nj->n", J[:, 0], fit.cov, J[:, 0]).mean() * len(e)
        sd_m = np.sqrt(sd_m / min(len(e), independent))
        sd_m = float(np.hypot(sd_m, c.depth_share * np.median(p[:, 2])))
        off_m = float(np.sqrt((way**2).mean()))
        return CameraShift(off_m, off_m > max(c.least_m, c.sigmas * sd_m))

    def _surroundings(self) -> tuple[FloatArray, PlaneSamples, float]:
        """Pixels (N, 2) beside the object with planes, these, and how many err on their own."""
        if self._planes is None:
            shape = self._config.planes
            planes = depth_planes(self._first, self._noise, self._background, shape)
            v, u = np.nonzero(planes.valid)
            step = max(1, u.size // self._config.pixels)
            uv = np.stack([u, v], axis=-1)[::step].astype(np.float64)
            windows = u.size / (2 * shape.radius_px + 1) ** 2  # the first frame's own errors stay
            independent = max(1.0, min(windows, self._config.independent))
            self._planes = uv, planes.at(uv), independent
        return self._planes


def _gray(frame: RgbdFrame) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def _found_again(
    first: NDArray[np.uint8],
    later: NDArray[np.uint8],
    uv: FloatArray,
    expected: FloatArray,
    config: CameraMotionConfig,
) -> tuple[FloatArray, BoolArray]:
    """Where corners (N, 2) are in a later picture, and which were found (Lucas-Kanade)."""
    window, levels = (config.window_px, config.window_px), config.levels
    start = uv.astype(np.float32)
    there = np.nan_to_num(expected, nan=-1.0).astype(np.float32)
    flags = cv2.OPTFLOW_USE_INITIAL_FLOW
    forth, ok, _ = cv2.calcOpticalFlowPyrLK(
        first, later, start, there.copy(), winSize=window, maxLevel=levels, flags=flags
    )
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(
        later, first, forth, start.copy(), winSize=window, maxLevel=levels, flags=flags
    )
    found = (ok.ravel() > 0) & (ok_back.ravel() > 0)
    found &= np.linalg.norm(back - start, axis=1) < config.return_px
    return forth.astype(np.float64), np.asarray(found & np.isfinite(expected).all(axis=1))


def _pixel_rows(fx: float, fy: float, p_cam: FloatArray) -> FloatArray:
    """J_uv_xi (N, 2, 6) of points (N, 3) that move by Exp(xi) in the camera's axes."""
    x, y, z = p_cam.T
    J_uv_p = np.zeros((len(p_cam), 2, 3))
    J_uv_p[:, 0, 0], J_uv_p[:, 0, 2] = fx / z, -fx * x / z**2
    J_uv_p[:, 1, 1], J_uv_p[:, 1, 2] = fy / z, -fy * y / z**2
    return np.concatenate([-J_uv_p @ skew(p_cam), J_uv_p], axis=2)


def _fitted(e: FloatArray, J: FloatArray, floor: float, config: CameraMotionConfig) -> _Fit:
    """Xi of rows e (N, k) = J (N, k, 6) xi, with weights that outliers do not count in.

    A weak prior (half a radian, half a metre) stands for what the rows leave open.
    """
    k = e.shape[1]
    prior = np.eye(6) / 0.5**2
    xi, square = np.zeros(6), (e**2).sum(axis=1) / k
    scale, information = floor, prior
    for _ in range(config.iterations):
        scale = max(floor, _MAD * float(np.sqrt(np.median(square))))
        w = weight(square * k / scale**2, config.dof, k) / scale**2
        weighted = (w[:, None, None] * J).reshape(-1, 6).T
        information = weighted @ J.reshape(-1, 6) + prior
        xi = np.asarray(np.linalg.solve(information, weighted @ e.ravel()), dtype=np.float64)
        square = ((e - J @ xi) ** 2).sum(axis=1) / k
    way = float(np.sqrt(((J @ xi) ** 2).sum(axis=1).mean() / k))
    near = np.sqrt(square) < max(config.agreeing_sigmas * floor, config.agreeing_way * way)
    return _Fit(xi, np.asarray(np.linalg.inv(information), np.float64), float(near.mean()))
