"""What the arm must not touch, as a camera frame shows it.

Space within reach is cut into voxels. A voxel is free where the camera sees through it to
something behind; it is occupied where the seen surface lies in it, and also where it lies behind
the surface: what the camera cannot see may be solid. Space outside the picture is unknown too, but
taken as free: the arm could not leave its own shadow otherwise. The arm's own space is free.
Only the shell of the occupied space is kept (the arm cannot get inside without crossing it), as
an octree. Of each voxel the map knows whether a surface was seen in it or whether it is only hidden
behind one: a hand may have to go where nobody could look (`akm_fg.arm.motion.reaching`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import coal
import cv2
import gtsam
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from akm_fg.arm.body.collision import Obstacle, arm_corners, inside_arm
from akm_fg.arm.body.description import ArmDescription
from akm_fg.records import BoolArray, FloatArray, RgbdFrame

FLOOR_M = 6.0  # side of the floor: more than the arm can reach
PEDESTAL_M = (0.3, 0.3)  # of the block under the robot's base
PEDESTAL_X_M = -0.05  # of its middle


@dataclass(frozen=True, slots=True)
class MapConfig:
    """Resolution and extent of the map; how far the arm keeps from it: `reaching`."""

    voxel_m: float = 0.02
    lower_m: tuple[float, float, float] = (-0.30, -0.96, -0.62)  # corners of what is mapped:
    upper_m: tuple[float, float, float] = (1.00, 0.96, 1.14)  # what the arm can reach, in front
    median_px: int = 5  # side of the window that smooths depth
    # Share by which depth changes from pixel to pixel of one face: 0.007 at 75 deg to its normal.
    # Over the gap that a stereo camera has beside a near edge it is 0.025 or more.
    slope: float = 0.015
    support_px: int = 4  # known pixels of the window as near as a thin thing that is there
    carve_m: float = 0.05  # around the arm, which is where it is

    def near(self, p_world: FloatArray, half_m: float, voxel_m: float) -> MapConfig:
        """The same with other voxels, for a cube of side 2 `half_m` about a point (3,)."""
        low, high = (p_world - half_m).tolist(), (p_world + half_m).tolist()
        lower, upper = (low[0], low[1], low[2]), (high[0], high[1], high[2])
        return replace(self, voxel_m=voxel_m, lower_m=lower, upper_m=upper)


@dataclass(frozen=True, slots=True)
class ObstacleMap:
    """The shell of the space that may be occupied."""

    p_world: FloatArray  # (N, 3) middles of the shell's voxels
    surface: BoolArray  # (N,) whether a surface was seen in the voxel; else it is hidden behind one
    voxel_m: float

    def obstacle(self, chosen: BoolArray | None = None) -> Obstacle | None:
        """The shell, or the chosen ones (N,) of its voxels, as an obstacle. None: no voxels."""
        points = self.p_world if chosen is None else self.p_world[chosen]
        if not len(points):
            return None
        octree = coal.makeOctree(np.ascontiguousarray(points), self.voxel_m)
        return Obstacle("what the camera sees", octree, gtsam.Pose3())


def map_from_frame(
    frame: RgbdFrame,
    q: FloatArray,
    floor_m: float,
    config: MapConfig | None = None,
    description: ArmDescription | None = None,
) -> ObstacleMap:
    """The map of one frame.

    Args:
        frame: the robot's own pixels carry no depth.
        q: (7,) joint angles of the arm when the frame was taken, rad.
        floor_m: height of the floor, world; nothing below it is mapped.
        config: resolution and extent.
        description: of the arm; without one, the Franka of the installed PyBullet's data.
    """
    config = config or MapConfig()
    lower = np.array(config.lower_m)
    lower[2] = max(lower[2], floor_m)
    count = np.ceil((np.array(config.upper_m) - lower) / config.voxel_m).astype(int)
    axes = [lower[i] + config.voxel_m * (np.arange(max(count[i], 0)) + 0.5) for i in range(3)]
    arm = _arm_in_picture(frame, arm_corners(q, description))
    occupied, surface = _occupied(axes, frame, arm, config)
    shell = _shell(occupied)
    if inside_arm(_middles(axes, shell), q, config.carve_m, description).any():
        index = np.argwhere(occupied)
        mine = inside_arm(_middles(axes, occupied), q, config.carve_m, description)
        occupied[tuple(index[mine].T)] = False
        shell = _shell(occupied)
    return ObstacleMap(_middles(axes, shell), surface[shell], config.voxel_m)


def _middles(axes: list[FloatArray], chosen: BoolArray) -> FloatArray:
    """(N, 3) of the voxels where `chosen` (X, Y, Z) is True."""
    return np.column_stack([axis[i] for axis, i in zip(axes, np.nonzero(chosen), strict=True)])


def _occupied(
    axes: list[FloatArray], frame: RgbdFrame, arm: BoolArray, config: MapConfig
) -> tuple[BoolArray, BoolArray]:
    """(X, Y, Z) where a voxel may be occupied; (X, Y, Z) where that is because a surface is in it.

    A voxel's middle is compared with the surfaces that its width in the picture covers: behind the
    nearest it may be occupied, near the nearest, the middle or the farthest of them a surface is in
    it.
    """
    camera, T = frame.camera, frame.T_world_cam
    R, eye = T.rotation().matrix(), T.translation()
    parts = [np.outer(axes[i] - eye[i], R[i]).astype(np.float32) for i in range(3)]
    x, y, z = (
        parts[0][:, None, None, k] + parts[1][None, :, None, k] + parts[2][None, None, :, k]
        for k in range(3)
    )
    ahead = np.where(z > config.voxel_m, z, np.float32(np.inf))
    u = np.rint(camera.fx * x / ahead + camera.cx).astype(np.int32)
    v = np.rint(camera.fy * y / ahead + camera.cy).astype(np.int32)
    seen = (z > config.voxel_m) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    nearest, surfaces = _surfaces(frame, arm, config)
    slack = np.float32(config.voxel_m * np.sqrt(3.0) / 2.0)  # half a voxel's diagonal
    occupied, surface = np.zeros(z.shape, dtype=bool), np.zeros(z.shape, dtype=bool)
    z, pixels = z[seen], (v[seen], u[seen])
    occupied[seen] = z > nearest[pixels] - slack
    surface[seen] = (np.abs(z - surfaces[:, *pixels]) < slack).any(axis=0)
    return occupied, surface & occupied


def _arm_in_picture(frame: RgbdFrame, hulls: list[FloatArray]) -> BoolArray:
    """(H, W) where the arm hides what is behind it, given its hulls' corners (K, 3), world."""
    picture = np.zeros(frame.depth_m.shape, dtype=np.uint8)
    for p_world in hulls:
        p_cam = frame.T_world_cam.transformTo(p_world.T).T
        if (p_cam[:, 2] > 0.0).all():  # of what convex bodies show, the outline is convex
            outline = cv2.convexHull(frame.camera.project(p_cam).round().astype(np.int32))
            cv2.fillConvexPoly(picture, outline, 1)
    return picture.astype(bool)


def _surfaces(
    frame: RgbdFrame, arm: BoolArray, config: MapConfig
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What each pixel shows within half a voxel's width, as depths.

    Returns:
        (H, W) the smallest that anything there may have, infinite where nothing is known;
        (3, H, W) the smallest, the pixel's own and the largest of what was seen. A gap in the depth
        counts as seen where it lies in one face, not between two. Infinite, or 0 for the largest,
        where nothing was.
    """
    depth = frame.depth_m
    known = np.isfinite(depth)
    if not known.any():
        nothing = np.full((4, *depth.shape), np.inf, dtype=np.float32)
        return nothing[0], nothing[1:]
    nearness = np.divide(1.0, depth, out=np.zeros(depth.shape, dtype=np.float32), where=known)
    bridged, in_a_face = _bridged(nearness, known, arm, config)
    smooth = _with_thin_things(cv2.medianBlur(bridged, config.median_px), nearness, config)
    half_px = 0.5 * config.voxel_m * frame.camera.fx * float(np.median(nearness[known]))
    window = np.ones((2 * int(np.ceil(half_px)) + 1,) * 2, dtype=np.uint8)
    faces = np.where(in_a_face, smooth, np.float32(0.0))
    far = cv2.erode(np.where(in_a_face, smooth, np.float32(np.inf)), window)
    around = np.stack([cv2.dilate(smooth, window), cv2.dilate(faces, window), faces, far])
    with np.errstate(divide="ignore"):
        around = np.asarray(1.0 / around, dtype=np.float32)
    return around[0], around[1:]


def _with_thin_things(
    smooth: NDArray[np.generic], nearness: NDArray[np.float32], config: MapConfig
) -> NDArray[np.float32]:
    """What the median takes away and is no isolated wrong depth, put back: a handle's bar.

    Of a bar of three pixels the camera loses a third at its edges, and the median sees the front
    behind. A pixel nearer than the median by a voxel counts where enough others in its window are
    as near.

    Args:
        smooth: (H, W) 1 / depth after the median.
        nearness: (H, W) 1 / depth as measured, 0 where unknown.
        config: window, voxel and support.
    """
    result = np.array(smooth, dtype=np.float32)
    with np.errstate(divide="ignore"):
        depth = 1.0 / nearness
        v, u = np.nonzero(depth < 1.0 / result - config.voxel_m)
    as_near = _windows(depth, v, u, config) < depth[v, u, None, None] + config.voxel_m
    there = as_near.sum(axis=(1, 2)) >= config.support_px
    result[v[there], u[there]] = nearness[v[there], u[there]]
    return result


def _bridged(
    nearness: NDArray[np.float32], known: BoolArray, arm: BoolArray, config: MapConfig
) -> tuple[NDArray[np.float32], BoolArray]:
    """1 / depth (H, W) with holes and the robot's silhouette bridged.

    Along rows and along columns, linearly from the last known pixel to the next: exact for planes.
    Where the camera lost something, the farther of both counts: a bridge from a near edge to a far
    wall is a phantom. Where the arm (H, W) hides something, the nearer: it may be the object.
    Second comes (H, W) where a face was seen, or a hole in one was bridged: neither way changes
    faster than a face does (`slope`).
    """
    rows, columns = np.nonzero(~known)
    along_rows, slope = _between(nearness, known, rows, columns)
    along_columns, slope_too = _between(nearness.T, known.T, columns, rows)
    result, in_a_face = nearness.copy(), _supported(nearness, known, config)
    farther, nearer = np.fmin(along_rows, along_columns), np.fmax(along_rows, along_columns)
    result[rows, columns] = np.nan_to_num(np.where(arm[rows, columns], nearer, farther))
    in_a_face[rows, columns] = np.maximum(slope, slope_too) < config.slope
    return result, in_a_face


def _supported(nearness: NDArray[np.float32], known: BoolArray, config: MapConfig) -> BoolArray:
    """(H, W) known pixels that others beside them confirm: at edges some lie in the air between."""
    side = config.median_px
    lost_beside = cv2.dilate((~known).astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    v, u = np.nonzero(known & lost_beside)
    depth = np.divide(1.0, nearness, out=np.full_like(nearness, np.inf), where=known)
    off = np.abs(_windows(depth, v, u, config) - depth[v, u, None, None])
    result = known.copy()
    result[v, u] = (off < config.voxel_m).sum(axis=(1, 2)) >= config.support_px
    return result


def _windows(
    depth: NDArray[np.float32], v: NDArray[np.int64], u: NDArray[np.int64], config: MapConfig
) -> NDArray[np.float32]:
    """(N, side, side) depths about pixels, of a picture (H, W) that is infinite beyond its edge."""
    side = config.median_px
    around = np.pad(depth, side // 2, constant_values=np.inf)
    return np.asarray(sliding_window_view(around, (side, side))[v, u])


def _between(
    values: NDArray[np.float32], known: BoolArray, lines: NDArray[np.int64], at: NDArray[np.int64]
) -> NDArray[np.float32]:
    """(2, N) at places without a value: linear interpolation in each line (row), and its slope.

    The slope is its change a pixel, as a share of the value. Where only one side has a value, that,
    with an infinite slope; where none has, NaN.
    """
    n = known.shape[1]
    index = np.arange(n)
    before = np.maximum.accumulate(np.where(known, index, -1), axis=1)[lines, at]
    after = np.minimum.accumulate(np.where(known, index, n)[:, ::-1], axis=1)[:, ::-1][lines, at]
    a = np.where(before >= 0, values[lines, before], np.nan)
    b = np.where(after < n, values[lines, np.minimum(after, n - 1)], np.nan)
    rise = (b - a) / (after - before)
    between = a + (at - before) * rise
    value = np.where(np.isnan(a), b, np.where(np.isnan(b), a, between))
    slope = np.nan_to_num(np.abs(rise / between), nan=np.inf)
    return np.stack([value, slope]).astype(np.float32)


def _shell(occupied: BoolArray) -> BoolArray:
    """The occupied voxels with a free one at a face. What lies outside is neither."""
    free = ~occupied
    touched = np.zeros_like(occupied)
    for axis in range(3):
        before, after = [slice(None)] * 3, [slice(None)] * 3
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        touched[tuple(before)] |= free[tuple(after)]
        touched[tuple(after)] |= free[tuple(before)]
    return np.asarray(touched & occupied)


def own_surroundings(floor_m: float) -> list[Obstacle]:
    """What the robot knows of the place it was set up in: the floor, and the block it stands on.

    Args:
        floor_m: height of the floor, world; below 0 the robot stands on a block.
    """
    thick = 0.2
    T_floor = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, floor_m - thick / 2.0]))
    result = [Obstacle("the floor", coal.Box(FLOOR_M, FLOOR_M, thick), T_floor)]
    if floor_m < 0.0:
        T_block = gtsam.Pose3(gtsam.Rot3(), np.array([PEDESTAL_X_M, 0.0, floor_m / 2.0]))
        result.append(Obstacle("its own pedestal", coal.Box(*PEDESTAL_M, -floor_m), T_block))
    return result
