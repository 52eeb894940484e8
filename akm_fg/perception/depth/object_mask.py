"""The object in a depth image: what is left when floor and walls are taken away.

Floor and walls are large planes with nothing behind them: everything else that is seen lies on the
camera's side. Any may be missing. A cabinet's own front is a large plane too: it is kept, because
floor, wall or another of its faces are seen behind it; where none is, because nothing but a handle
stands out from it and no front is as long as a wall. All is judged in the camera's axes, so that
the same image gives the same object whatever the world's axes are. A plane that faces the image's
upper edge may be a floor, from which little need stand out: what is up in the world is not asked
for.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import TracksLost
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.records import BoolArray, FloatArray, RgbdFrame


@dataclass(frozen=True, slots=True)
class DepthSegmenterConfig:
    """Planes and components."""

    stride_px: int = 4  # RANSAC sees every fourth pixel: 19,200 points of a VGA image
    samples: int = 1000  # planes tried; one with 15 % support is missed with probability 0.03
    seed: int = 0  # the same frame gives the same mask
    near_m: float = 0.008  # half thickness of a plane, before noise: boards are rarely flatter
    near_sigmas: float = 3.0  # of depth noise, on top
    floor_deg: float = 60.0  # of a floor's normal from the image's up: cameras tilt -30 to 60 deg
    min_support: float = 0.03  # of all points; a smaller plane is not a floor or a wall
    max_beyond: float = 0.01  # of all points: flying pixels behind a wall or under a floor
    min_relief: float = 0.02  # of all points that stand out from a wall: more than a handle does
    relief_m: float = 0.08  # how far they stand out at least: handles reach 4 to 6 cm
    front_m: float = 2.8  # no front is longer: a wall, however little of the picture stands out
    planes_tried: int = 4  # largest planes looked at: wall, other wall, front, side
    walls: int = 2  # taken away: corners of rooms; a floor seen by a camera on its side
    close_px: int = 5  # holes and cracks up to this width at 640 pixels are closed
    lost_px: int = 21  # and so are wider ones without depth: three of a camera's lost patches
    min_area: float = 0.002  # of the image; a smaller component is noise


@dataclass(frozen=True, slots=True)
class Floor:
    """The largest plane that faces the picture's upper edge, with nothing below it."""

    up_cam: FloatArray  # (3,) unit, away from it, camera axes
    height_m: float  # of the camera above it
    mask: BoolArray  # (H, W) pixels on it


@dataclass(frozen=True, slots=True)
class _Plane:
    """Points with normal . p_cam = offset; the normal points to the camera's side."""

    normal: FloatArray  # (3,)
    offset: float

    def height(self, p_cam: FloatArray) -> FloatArray:
        """Signed distances (...) of points (..., 3), positive on the camera's side."""
        return np.asarray(p_cam @ self.normal - self.offset)

    @property
    def distance_m(self) -> float:
        """Of the camera."""
        return -self.offset


class DepthObjectSegmenter:
    """An `ObjectSegmenter` that needs depth alone; T_world_cam is not looked at."""

    def __init__(
        self, config: DepthSegmenterConfig | None = None, noise: DepthNoiseModel | None = None
    ) -> None:
        """Tuning, and the noise the planes must allow for."""
        self.config = config or DepthSegmenterConfig()
        self.noise = noise or DepthNoiseModel()

    def segment(self, frame: RgbdFrame) -> BoolArray:
        """(H, W), True on the object.

        Raises:
            TracksLost: no depth, or nothing but floor and wall.
        """
        config = self.config
        p_cam, near_m = self._points(frame)
        left = np.isfinite(p_cam[..., 2])
        points, near = self._sample(p_cam, near_m)
        if len(points) < 3:
            raise TracksLost("no object found: the depth image is empty")
        for plane in _background(points, near, config):
            left &= plane.height(p_cam) > near_m
        mask = _largest_component(left, np.isnan(p_cam[..., 2]), config)
        if mask.mean() < config.min_area:
            raise TracksLost("no object found: nothing stands out from floor and wall")
        return mask

    def floor(self, frame: RgbdFrame) -> Floor | None:
        """What may be a floor in the picture, or a table; None where there is none."""
        config = self.config
        p_cam, near_m = self._points(frame)
        points, near = self._sample(p_cam, near_m)
        if len(points) < 3:
            return None
        rng, rest = np.random.default_rng(config.seed), np.ones(len(points), dtype=bool)
        planes = _large_planes(points, near, rest, True, rng, config)
        for plane in planes:
            if _is_behind_everything(plane, points, near, config):
                on = np.asarray(np.abs(plane.height(p_cam)) < near_m)  # NaN: False
                return Floor(plane.normal, plane.distance_m, on)
        return None

    def _points(self, frame: RgbdFrame) -> tuple[FloatArray, FloatArray]:
        """(H, W, 3) in the camera's axes, and how near to a plane each must be to be on it."""
        config, camera = self.config, frame.camera
        v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
        depth = frame.depth_m.astype(np.float64)
        p_cam = camera.back_project(np.stack([u, v], axis=-1), depth)
        near_m = config.near_m + config.near_sigmas * self.noise.sigma_m(depth, camera.fx)
        return p_cam, near_m

    def _sample(self, p_cam: FloatArray, near_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (N, 3) of every few pixels that have depth."""
        step = slice(None, None, self.config.stride_px)
        sample = np.isfinite(p_cam[step, step, 2])
        return p_cam[step, step][sample], near_m[step, step][sample]


def _background(points: FloatArray, near: FloatArray, config: DepthSegmenterConfig) -> list[_Plane]:
    """Floor and walls, as far as they are seen, of points (N, 3) in the camera's axes."""
    rng = np.random.default_rng(config.seed)
    found: list[_Plane] = []
    rest = np.ones(len(points), dtype=bool)
    for floor in (True, False):
        candidates = _large_planes(points, near, rest, floor, rng, config)
        behind = [p for p in candidates if _is_behind_everything(p, points, near, config)]
        behind.sort(key=lambda p: -p.distance_m)
        taken = 0
        for plane in behind:
            if taken < (1 if floor else config.walls) and (
                floor
                or _has_relief(plane, points, rest, config)
                or _length_m(points[rest & (np.abs(plane.height(points)) < near)]) > config.front_m
            ):
                found.append(plane)
                rest &= plane.height(points) > near
                taken += 1
    return found


def _large_planes(
    points: FloatArray,
    near: FloatArray,
    rest: BoolArray,
    floor: bool,
    rng: np.random.Generator,
    config: DepthSegmenterConfig,
) -> list[_Plane]:
    """The planes with most support, of floors or of walls, found one after the other."""
    left, planes = rest.copy(), []
    for _ in range(config.planes_tried):
        index = np.flatnonzero(left)
        if len(index) < config.min_support * len(points) or len(index) < 3:
            break
        plane = _ransac(points[index], near[index], floor, rng, config)
        if plane is None:
            break
        support = left & (np.abs(plane.height(points)) < near)
        if support.sum() < config.min_support * len(points):
            break
        planes.append(plane)
        left &= ~support
    return planes


def _ransac(
    points: FloatArray,
    near: FloatArray,
    floor: bool,
    rng: np.random.Generator,
    config: DepthSegmenterConfig,
) -> _Plane | None:
    """The best-supported plane that may be a floor, or that may be none, refined once."""
    corners = points[rng.integers(0, len(points), (config.samples, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    facing = np.where(np.einsum("si,si->s", normals, corners[:, 0]) < 0, 1.0, -1.0)
    upwards = -facing * normals[:, 1] > np.cos(np.deg2rad(config.floor_deg)) * length
    good = (length > 1e-9) & (upwards == floor)
    if not good.any():
        return None
    normals, corner = normals[good] / length[good, None], corners[good, 0]
    some = slice(None, None, max(1, len(points) // 2000))
    distance = np.abs(points[some] @ normals.T - np.einsum("si,si->s", normals, corner))
    best = int((distance < near[some, None]).sum(axis=0).argmax())
    plane = _facing(normals[best], corner[best])
    inliers = points[np.abs(plane.height(points)) < near]
    if len(inliers) < 3:
        return plane
    centre = inliers.mean(axis=0)
    normal = np.linalg.svd((inliers - centre).T @ (inliers - centre))[0][:, 2]
    return _facing(normal, centre)


def _facing(normal: FloatArray, point: FloatArray) -> _Plane:
    normal = -normal if normal @ point > 0 else normal
    return _Plane(normal, float(normal @ point))


def _is_behind_everything(
    plane: _Plane, points: FloatArray, near: FloatArray, config: DepthSegmenterConfig
) -> bool:
    """Whether (almost) no point lies beyond the plane."""
    beyond = (plane.height(points) < -2 * near).mean()
    return bool(beyond < config.max_beyond)


def _has_relief(
    plane: _Plane, points: FloatArray, rest: BoolArray, config: DepthSegmenterConfig
) -> bool:
    """Whether more than a handle stands out from the plane (what was taken already apart)."""
    out = rest & (plane.height(points) > config.relief_m)
    return bool(out.mean() > config.min_relief)


def _length_m(points: FloatArray) -> float:
    """How long the points (N, 3) of a plane reach, a few strays apart; 0 without any."""
    if len(points) < 3:
        return 0.0
    off = points - points.mean(axis=0)
    along = off @ np.linalg.svd(off.T @ off)[0][:, 0]
    low, high = np.quantile(along, (0.02, 0.98))
    return float(high - low)


def _largest_component(
    left: BoolArray, unknown: BoolArray, config: DepthSegmenterConfig
) -> BoolArray:
    """The largest connected region after closing cracks, with its holes filled."""
    crack, lost = (_disc(px, left.shape[1]) for px in (config.close_px, config.lost_px))
    opened = cv2.morphologyEx(left.astype(np.uint8), cv2.MORPH_OPEN, crack)
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, crack)
    bridged = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, lost)
    closed = np.where(unknown, bridged, closed)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    if count < 2:
        return np.zeros_like(left)
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    component = (labels == largest).astype(np.uint8)
    outlines, _ = cv2.findContours(component, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(component)
    cv2.drawContours(filled, outlines, -1, 1, cv2.FILLED)
    return np.asarray(filled > 0)


def _disc(width_px: int, columns: int) -> NDArray[np.uint8]:
    """A disc so many pixels wide at 640 pixels, in an image of so many columns."""
    width = max(3, round(width_px * columns / 640)) | 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width)), np.uint8)
