"""Colour and depth of different cameras or with distortion, brought to one pinhole camera.

The camera of the result is the colour's without its distortion; where the depth camera sees much
coarser, colour is reduced to its resolution, for depth that is made up between its pixels looks
like more measurements than there are. Depth is looked up along each ray: inverse depth, linear
in the image of a plane, between the four pixels around, and the nearest one's at edges.
"""

from __future__ import annotations

from typing import Any

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.io.sources.source import Lens
from akm_fg.records import FloatArray, PinholeCamera

COARSER = 1.9  # times, from which colour is reduced
EDGE_RATIO = 1.03  # of depths around a ray: beyond, they are two surfaces
ROUNDS = 6  # of looking along a ray; each is off by a fifth of the one before, or less
CONVERGED = 2e-3  # of the depth
NOTHING_M = 1e6  # where no depth was found
HIDDEN = 1.03  # times the depth that is seen there: behind it


class Registration:
    """Of one pair of cameras; holds the tables that all frames share."""

    def __init__(
        self, colour: Lens, depth: Lens, T_colour_depth: gtsam.Pose3 | None = None
    ) -> None:
        """Make the tables.

        Args:
            colour: lens of the colour pictures.
            depth: lens of the depth pictures.
            T_colour_depth: None where the two are one camera, or depth is registered already.
        """
        self._depth = depth
        self._T = None if T_colour_depth is None or _is_same(T_colour_depth) else T_colour_depth
        coarser = colour.camera.fx / depth.camera.fx
        self.reduction = int(coarser) if coarser >= COARSER else 1
        self.camera = _reduced(colour.camera, self.reduction)
        self._rays = _rays(self.camera)
        self._colour_map = None
        if colour.bends:
            reduced = Lens(self.camera, colour.distortion, colour.fisheye)
            self._colour_map = _project(reduced, self._rays).astype(np.float32)
        same = colour == depth and not colour.bends
        self.changes_depth = not (self._T is None and same and self.reduction == 1)
        self._where = _project(depth, self._rays) if self._T is None else None
        self._depth_rays = None if self._T is None else _undistorted_rays(depth)

    def largest_bend_px(self) -> float:
        """How far distortion moves colour's pixels, at most."""
        if self._colour_map is None:
            return 0.0
        v, u = np.mgrid[: self.camera.height, : self.camera.width]
        away = self._colour_map - np.stack([u, v], -1)
        return float(np.linalg.norm(away, axis=-1).max())

    def colour(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The picture (H, W, 3) as the result's camera takes it."""
        image: NDArray[Any] = rgb
        if self.reduction > 1:
            size = (self.camera.width, self.camera.height)
            height, width = (self.reduction * n for n in size[::-1])
            image = cv2.resize(rgb[:height, :width], size, interpolation=cv2.INTER_AREA)
        if self._colour_map is not None:
            u, v = self._colour_map[..., 0], self._colour_map[..., 1]
            image = cv2.remap(image, u, v, cv2.INTER_LINEAR)
        return np.ascontiguousarray(image, dtype=np.uint8)

    def depth(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth (h, w) of the depth camera, NaN where unknown, at the result's pixels (H, W)."""
        if not self.changes_depth:
            return depth_m
        if self._where is not None:
            return _looked_up(depth_m, self._where).astype(np.float32)
        return self._seen_from_colour(depth_m).astype(np.float32)

    def _seen_from_colour(self, depth_m: NDArray[np.float32]) -> FloatArray:
        assert self._T is not None and self._depth_rays is not None
        front = self._front(depth_m)
        z, last = front, np.full_like(front, np.nan)
        R, t = self._T.rotation().matrix(), self._T.translation()
        for _ in range(ROUNDS):
            p_depth = (self._rays * z[..., None] - t) @ R
            with np.errstate(divide="ignore", invalid="ignore"):
                rays = p_depth / np.where(p_depth[..., 2:] > 0, p_depth[..., 2:], np.nan)
            z_depth = _looked_up(depth_m, _project(self._depth, rays))
            last, z = z, (rays * z_depth[..., None]) @ R[2] + t[2]
        good = (np.abs(z - last) < CONVERGED * z) & (z < HIDDEN * front)
        return np.where(good, z, np.nan)

    def _front(self, depth_m: NDArray[np.float32]) -> FloatArray:
        """Depth of the nearest surface around each of the result's pixels, roughly."""
        assert self._T is not None and self._depth_rays is not None
        known = np.isfinite(depth_m)
        points = self._depth_rays[known] * depth_m[known][:, None].astype(np.float64)
        points = points @ self._T.rotation().matrix().T + self._T.translation()
        points = points[points[:, 2] > 0]
        uv = np.rint(self.camera.project(points)).astype(np.int64)
        height, width = self.camera.height, self.camera.width
        inside = (uv >= 0).all(1) & (uv[:, 0] < width) & (uv[:, 1] < height)
        front = np.full((height, width), NOTHING_M)
        np.minimum.at(front, (uv[inside, 1], uv[inside, 0]), points[inside, 2])
        reach = int(np.ceil(self.camera.fx / self._depth.camera.fx))
        front = cv2.erode(front, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        return np.where(front < NOTHING_M, front, np.nan)


def _is_same(T: gtsam.Pose3) -> bool:
    return bool(np.allclose(T.matrix(), np.eye(4), atol=1e-9))


def _reduced(camera: PinholeCamera, times: int) -> PinholeCamera:
    """Of a picture whose pixels are means of times x times; centres at integers."""
    return PinholeCamera(
        camera.width // times,
        camera.height // times,
        camera.fx / times,
        camera.fy / times,
        (camera.cx + 0.5) / times - 0.5,
        (camera.cy + 0.5) / times - 0.5,
    )


def _grid(camera: PinholeCamera) -> FloatArray:
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return np.stack([u, v], -1)


def _rays(camera: PinholeCamera) -> FloatArray:
    """(H, W, 3) points at depth 1."""
    uv = _grid(camera)
    return camera.back_project(uv, np.ones(uv.shape[:2]))


def _matrix(camera: PinholeCamera) -> FloatArray:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])


def _project(lens: Lens, rays: FloatArray) -> FloatArray:
    """Pixels (H, W, 2) in the picture of a lens, distortion and all, of rays (H, W, 3)."""
    if not lens.bends:
        return lens.camera.project(rays)
    flat = np.nan_to_num(rays.reshape(-1, 1, 3), nan=0.0)
    K, D, still = _matrix(lens.camera), np.array(lens.distortion), np.zeros(3)
    project = cv2.fisheye.projectPoints if lens.fisheye else cv2.projectPoints
    uv = project(flat, still, still, K, D)[0].reshape(*rays.shape[:2], 2)
    return np.where(np.isfinite(rays[..., :1]), uv, np.nan)


def _undistorted_rays(lens: Lens) -> FloatArray:
    """(h, w, 3) points at depth 1 that the pixels of a lens show."""
    if not lens.bends:
        return _rays(lens.camera)
    uv, K, D = _grid(lens.camera), _matrix(lens.camera), np.array(lens.distortion)
    undistort = cv2.fisheye.undistortPoints if lens.fisheye else cv2.undistortPoints
    xy = undistort(uv.reshape(-1, 1, 2), K, D).reshape(uv.shape)
    return np.concatenate([xy, np.ones((*uv.shape[:2], 1))], -1)


def _looked_up(depth_m: NDArray[np.float32], uv: FloatArray) -> FloatArray:
    """Depth at pixels (H, W, 2) between those of a picture (h, w); NaN outside and unknown."""
    height, width = depth_m.shape
    inside = (uv > -0.5).all(-1) & (uv[..., 0] < width - 0.5) & (uv[..., 1] < height - 0.5)
    uv = np.where(inside[..., None], uv, 0.0)
    whole = np.clip(np.floor(uv).astype(np.int64), 0, [max(width - 2, 0), max(height - 2, 0)])
    share = np.clip(uv - whole, 0.0, 1.0)
    total, weight = np.zeros(uv.shape[:2]), np.zeros(uv.shape[:2])
    low, high = np.full(uv.shape[:2], np.inf), np.zeros(uv.shape[:2])
    for du in (0, 1):
        for dv in (0, 1):
            u = np.minimum(whole[..., 0] + du, width - 1)
            v = np.minimum(whole[..., 1] + dv, height - 1)
            z = depth_m[v, u].astype(np.float64)
            w = np.abs(1 - du - share[..., 0]) * np.abs(1 - dv - share[..., 1])
            used = w > 0  # what lies on a pixel asks nothing of its neighbours
            total += np.where(used, w / z, 0.0)
            weight += np.where(used, w, 0.0)
            low, high = (
                np.where(used, np.fmin(low, z), low),
                np.where(used, np.fmax(high, z), high),
            )
    nearest = depth_m[
        np.clip(np.rint(uv[..., 1]), 0, height - 1).astype(np.int64),
        np.clip(np.rint(uv[..., 0]), 0, width - 1).astype(np.int64),
    ].astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        between = np.where(high < EDGE_RATIO * low, weight / total, nearest)
    z = np.where(np.isfinite(between), between, nearest)
    return np.where(inside, z, np.nan)
