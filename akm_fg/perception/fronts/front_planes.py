"""The large planes of an object, as one depth image shows them.

Pixels whose windows are plane (`depth_planes`) vote for the plane of a few of them drawn at random;
the plane with the largest area is refined by least squares and taken away, and so on.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.depth.depth_planes import DepthPlanesConfig, depth_planes
from akm_fg.perception.fronts.front_records import FrontFrame
from akm_fg.perception.fronts.sides import turn_of_sides
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

BLIND_PX = 9  # wider without depth: the robot, or what shines; a gap's shadow is narrower

UP_WORLD = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class FrontPlanesConfig:
    """Search for planes."""

    windows: DepthPlanesConfig = field(
        default_factory=lambda: DepthPlanesConfig(radius_px=5)  # handles leave narrow fronts
    )
    seeds: int = 60  # planes tried for each that is found; one of a tenth is missed by 0.002
    voters: int = 3000  # pixels that vote
    seed: int = 0  # the same frame gives the same planes
    near_m: float = 0.003  # half thickness, before noise
    near_sigmas: float = 2.0  # of a depth reading, on top
    same_deg: float = 20.0  # between a window's normal and the plane's: noise is 5 deg
    min_area_m2: float = 0.008  # a drawer's front is 0.02
    most: int = 8
    lying: float = 0.8  # of the normal's upward part: which way is up says nothing on such a plane


@dataclass(frozen=True, slots=True)
class SeenPlane:
    """A plane of the object and the pixels that show it."""

    frame: FrontFrame
    mask: BoolArray  # (H, W)


@dataclass(frozen=True, slots=True)
class ObjectCloud:
    """Every pixel of the object as a point."""

    p_world: FloatArray  # (H, W, 3); NaN outside the object, and where depth is unknown
    sigma_m: FloatArray  # (H, W) of a depth reading
    area_m2: FloatArray  # (H, W) that a pixel covers, across its ray
    eye_world: FloatArray  # (3,) the camera

    @property
    def known(self) -> BoolArray:
        """(H, W) where there is a point."""
        return np.asarray(np.isfinite(self.p_world[..., 0]))


def object_cloud(frame: RgbdFrame, mask: BoolArray, noise: DepthNoiseModel) -> ObjectCloud:
    """The points of the object's pixels.

    Raises:
        ValueError: the mask has another size than the image.
    """
    camera = frame.camera
    if mask.shape != frame.depth_m.shape:
        raise ValueError(f"mask {mask.shape}, expected {frame.depth_m.shape}")
    depth = np.where(mask & (frame.depth_m > 0), frame.depth_m, np.nan).astype(float)
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    p_cam = camera.back_project(np.stack([u, v], axis=-1), depth)
    T = frame.T_world_cam
    p_world = p_cam @ T.rotation().matrix().T + T.translation()
    area = depth * depth / (camera.fx * camera.fy)
    return ObjectCloud(p_world, noise.sigma_m(depth, camera.fx), area, T.translation())


def seen_planes(
    frame: RgbdFrame,
    mask: BoolArray,
    cloud: ObjectCloud,
    noise: DepthNoiseModel,
    config: FrontPlanesConfig,
) -> tuple[SeenPlane, ...]:
    """The object's planes, largest first; none where there is too little depth."""
    planes = depth_planes(frame, noise, mask, config.windows)
    v, u = np.nonzero(planes.valid & cloud.known)
    if len(u) < 3:
        return ()
    at = planes.at(np.column_stack([u, v]).astype(float))
    good = np.isfinite(at.normal_world).all(axis=1)
    v, u, p, n = v[good], u[good], at.p_world[good], at.normal_world[good]
    slant = np.abs(np.einsum("ni,ni->n", n, _unit_rows(cloud.eye_world - p)))
    area = cloud.area_m2[v, u] / np.maximum(slant, 0.2)
    near = config.near_m + config.near_sigmas * cloud.sigma_m[v, u] * slant
    rng = np.random.default_rng(config.seed)
    left = np.ones(len(u), dtype=bool)
    found: list[SeenPlane] = []
    blind = _beside_blind(frame.depth_m)
    for _ in range(config.most):
        best = _largest(p, n, area, near, left, rng, config)
        if best is None:
            break
        normal, offset = best
        support = left & _on(p, n, near, normal, offset, config)
        if area[support].sum() < config.min_area_m2:
            break
        found.append(
            _seen_plane(cloud, p[support], normal, offset, (v[support], u[support]), blind, config)
        )
        left &= ~(np.abs(p @ normal - offset) < 1.5 * near)
    return tuple(found)


def _on(
    p: FloatArray,
    n: FloatArray,
    near: FloatArray,
    normal: FloatArray,
    offset: float,
    config: FrontPlanesConfig,
) -> BoolArray:
    """(N,) which points with normals lie on a plane."""
    along = n @ normal > np.cos(np.deg2rad(config.same_deg))
    return np.asarray((np.abs(p @ normal - offset) < near) & along)


def _largest(
    p: FloatArray,
    n: FloatArray,
    area: FloatArray,
    near: FloatArray,
    left: BoolArray,
    rng: np.random.Generator,
    config: FrontPlanesConfig,
) -> tuple[FloatArray, float] | None:
    """Normal and offset of the plane with the most area among the points left; or None."""
    index = np.flatnonzero(left)
    if len(index) < 3 or area[index].sum() < config.min_area_m2:
        return None
    voters = index if len(index) <= config.voters else rng.choice(index, config.voters, False)
    seeds = rng.choice(index, config.seeds)
    offsets = np.einsum("si,si->s", n[seeds], p[seeds])
    close = np.abs(p[voters] @ n[seeds].T - offsets) < 2.0 * near[voters, None]
    close &= n[voters] @ n[seeds].T > np.cos(np.deg2rad(config.same_deg))
    best = int((area[voters] @ close).argmax())
    normal, offset = n[seeds[best]], float(offsets[best])
    for widen in (2.0, 1.0, 1.0):
        support = left & _on(p, n, widen * near, normal, offset, config)
        if support.sum() < 3:
            return None
        refined, at = _fitted(p[support], area[support] / near[support] ** 2)
        sign = 1.0 if refined @ normal > 0 else -1.0
        if sign * (refined @ normal) < np.cos(np.deg2rad(config.same_deg)):
            return None  # a thin band of points: its plane may turn about it
        normal, offset = sign * refined, sign * at
    return normal, offset


def _fitted(p: FloatArray, weight: FloatArray) -> tuple[FloatArray, float]:
    """Least-squares plane of points (N, 3): unit normal, either way, and offset."""
    middle = weight @ p / weight.sum()
    d = p - middle
    normal = np.linalg.eigh(np.einsum("n,ni,nj->ij", weight, d, d))[1][:, 0]
    return normal, float(normal @ middle)


def _seen_plane(
    cloud: ObjectCloud,
    p: FloatArray,
    normal: FloatArray,
    offset: float,
    pixels: tuple[NDArray[np.int64], NDArray[np.int64]],
    blind: BoolArray,
    config: FrontPlanesConfig,
) -> SeenPlane:
    """A plane and its pixels: those of its windows, and at its rim those that are on it.

    Where it ends beside pixels that are `blind` (H, W) it may go on behind the robot.
    """
    if normal @ cloud.eye_world < offset:
        normal, offset = -normal, -offset
    mask = np.zeros(cloud.known.shape, dtype=bool)
    mask[pixels] = True
    side = 2 * config.windows.radius_px + 1
    rim = cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > mask
    near = config.near_m + config.near_sigmas * cloud.sigma_m[rim]
    with np.errstate(invalid="ignore"):
        mask[rim] = np.abs(cloud.p_world[rim] @ normal - offset) < near
    middle = p.mean(axis=0)
    origin = middle - (normal @ middle - offset) * normal
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    outline = cloud.p_world[mask & ~inner & cloud.known & ~blind]
    return SeenPlane(FrontFrame(origin, _axes(outline, normal, origin, cloud.eye_world)), mask)


def _beside_blind(depth_m: NDArray[np.float32]) -> BoolArray:
    """(H, W) pixels in or beside large places without depth: the robot, or what shines."""
    return np.asarray(cv2.dilate(wide_blind(depth_m), np.ones((5, 5), np.uint8)) > 0)


def wide_blind(depth_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(H, W) 1 in places without depth that are wider than a gap's shadow."""
    blind = np.isnan(depth_m).astype(np.uint8)
    return np.asarray(
        cv2.morphologyEx(blind, cv2.MORPH_OPEN, np.ones((BLIND_PX,) * 2, np.uint8)), np.uint8
    )


def _axes(
    outline: FloatArray, normal: FloatArray, origin: FloatArray, eye_world: FloatArray
) -> FloatArray:
    """(3, 3) columns: along the sides of what has this outline (N, 3), and the normal.

    Furniture is rectangular, but need not stand level. x is the side nearest to the horizontal; on
    a lying plane, nearest to what is sideways for who stands where the camera is.
    """
    towards = eye_world - origin
    upwards = UP_WORLD if abs(normal @ UP_WORLD) < 0.9 else -towards
    y = upwards - (upwards @ normal) * normal
    y /= np.linalg.norm(y)
    x = np.cross(y, normal)
    angle = turn_of_sides((outline - origin) @ np.column_stack([x, y]))
    turned = np.cos(angle) * x + np.sin(angle) * y
    return np.column_stack([turned, np.cross(normal, turned), normal])


def _unit_rows(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12))
