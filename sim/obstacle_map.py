"""What the arm must not touch, as a camera frame shows it.

Space within reach is cut into voxels. A voxel is free where the camera sees through it to
something behind; it is occupied where the seen surface lies in it, and also where it lies behind
the surface: what the camera cannot see may be solid. Space outside the picture is unknown too, but
taken as free: the arm could not leave its own shadow otherwise. The arm's own space is free.
Only the shell of the occupied space is kept (the arm cannot get inside without crossing it), as
an octree.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import cv2
import gtsam
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from akm_fg.records import BoolArray, FloatArray, RgbdFrame
from sim.collision import Obstacle, inside_arm

FLOOR_M = 6.0  # side of the floor: more than the arm can reach
PEDESTAL_M = (0.3, 0.3)  # of the block under the robot's base
PEDESTAL_X_M = -0.05  # of its middle


@dataclass(frozen=True, slots=True)
class MapConfig:
    """Resolution and extent of the map; `sim.reaching` says how far the arm keeps from it."""

    voxel_m: float = 0.02
    lower_m: tuple[float, float, float] = (-0.30, -0.96, -0.62)  # corners of what is mapped:
    upper_m: tuple[float, float, float] = (1.00, 0.96, 1.14)  # what the arm can reach, in front
    median_px: int = 5  # side of the window that smooths depth
    support_px: int = 4  # known pixels of it that must be as near for a thin thing to be there
    carve_m: float = 0.05  # around the arm, which is where it is


@dataclass(frozen=True, slots=True)
class GraspRoom:
    """Where a grasped handle and the front behind it are: before the palm, about its axis.

    What sticks out farther than the palm comes, such as a table top above, is not in it.
    """

    T_world_grasp: gtsam.Pose3
    radius_m: float  # about the gripper's z
    ahead_m: float  # of the grasp point, against the gripper's z: where the room begins

    def holds(self, p_world: FloatArray) -> BoolArray:
        """(N,) which points (N, 3) are in it."""
        T = self.T_world_grasp
        p_grasp = (p_world - T.translation()) @ T.rotation().matrix()
        aside = np.linalg.norm(p_grasp[:, :2], axis=1)
        return np.asarray((p_grasp[:, 2] > -self.ahead_m) & (aside < self.radius_m))


@dataclass(frozen=True, slots=True)
class ObstacleMap:
    """The shell of the space that may be occupied."""

    p_world: FloatArray  # (N, 3) middles of the shell's voxels
    voxel_m: float

    def obstacle(self, room: GraspRoom | None = None) -> Obstacle | None:
        """The shell as an obstacle, without what a grasp's room holds. None where none is left."""
        points = self.p_world if room is None else self.p_world[~room.holds(self.p_world)]
        if not len(points):
            return None
        octree = coal.makeOctree(np.ascontiguousarray(points), self.voxel_m)
        return Obstacle("what the camera sees", octree, gtsam.Pose3())


def map_from_frame(
    frame: RgbdFrame, q: FloatArray, floor_m: float, config: MapConfig | None = None
) -> ObstacleMap:
    """The map of one frame.

    Args:
        frame: the robot's own pixels carry no depth.
        q: (7,) joint angles of the arm when the frame was taken, rad.
        floor_m: height of the floor, world; nothing below it is mapped.
        config: resolution and extent.
    """
    config = config or MapConfig()
    lower = np.array(config.lower_m)
    lower[2] = max(lower[2], floor_m)
    count = np.ceil((np.array(config.upper_m) - lower) / config.voxel_m).astype(int)
    axes = [lower[i] + config.voxel_m * (np.arange(count[i]) + 0.5) for i in range(3)]
    occupied = _hidden(axes, frame, config)
    p_world = _middles(axes, _shell(occupied))
    if inside_arm(p_world, q, config.carve_m).any():
        index = np.argwhere(occupied)
        mine = inside_arm(_middles(axes, occupied), q, config.carve_m)
        occupied[tuple(index[mine].T)] = False
        p_world = _middles(axes, _shell(occupied))
    return ObstacleMap(p_world, config.voxel_m)


def _middles(axes: list[FloatArray], chosen: BoolArray) -> FloatArray:
    """(N, 3) of the voxels where `chosen` (X, Y, Z) is True."""
    return np.column_stack([axis[i] for axis, i in zip(axes, np.nonzero(chosen), strict=True)])


def _hidden(axes: list[FloatArray], frame: RgbdFrame, config: MapConfig) -> BoolArray:
    """(X, Y, Z) True where a voxel touches the surface that is seen, or lies behind it."""
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
    nearest = _nearest_surface(frame, config)
    slack = np.float32(config.voxel_m * np.sqrt(3.0) / 2.0)  # half a voxel's diagonal
    hidden = np.zeros(z.shape, dtype=bool)
    hidden[seen] = z[seen] > nearest[v[seen], u[seen]] - slack
    return hidden


def _nearest_surface(frame: RgbdFrame, config: MapConfig) -> NDArray[np.float32]:
    """(H, W) smallest depth within half a voxel's width of each pixel; infinite where unknown."""
    depth = frame.depth_m
    known = np.isfinite(depth)
    if not known.any():
        return np.full(depth.shape, np.inf, dtype=np.float32)
    nearness = np.divide(1.0, depth, out=np.zeros(depth.shape, dtype=np.float32), where=known)
    smooth = _with_thin_things(
        cv2.medianBlur(_bridged(nearness, known), config.median_px), nearness, config
    )
    half_px = 0.5 * config.voxel_m * frame.camera.fx * float(np.median(nearness[known]))
    side = 2 * int(np.ceil(half_px)) + 1
    nearest = cv2.dilate(smooth, np.ones((side, side), dtype=np.uint8))
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / nearest, dtype=np.float32)


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
    around = np.pad(depth, config.median_px // 2, constant_values=np.inf)
    windows = sliding_window_view(around, (config.median_px, config.median_px))[v, u]
    as_near = windows < depth[v, u, None, None] + config.voxel_m
    there = as_near.sum(axis=(1, 2)) >= config.support_px
    result[v[there], u[there]] = nearness[v[there], u[there]]
    return result


def _bridged(nearness: NDArray[np.float32], known: BoolArray) -> NDArray[np.float32]:
    """1 / depth (H, W) with holes and the robot's silhouette bridged.

    Along rows and along columns, linearly from the last known pixel to the next: exact for planes.
    The farther of both counts, because a bridge from a near edge to a far wall is a phantom.
    """
    rows, columns = np.nonzero(~known)
    along_rows = _between(nearness, known, rows, columns)
    along_columns = _between(nearness.T, known.T, columns, rows)
    result = nearness.copy()
    result[rows, columns] = np.nan_to_num(np.fmin(along_rows, along_columns))
    return result


def _between(
    values: NDArray[np.float32], known: BoolArray, lines: NDArray[np.int64], at: NDArray[np.int64]
) -> NDArray[np.float32]:
    """(N,) linear interpolation in each line (row) at places without a value.

    Where only one side has a value, that; where none has, NaN.
    """
    n = known.shape[1]
    index = np.arange(n)
    before = np.maximum.accumulate(np.where(known, index, -1), axis=1)[lines, at]
    after = np.minimum.accumulate(np.where(known, index, n)[:, ::-1], axis=1)[:, ::-1][lines, at]
    a = np.where(before >= 0, values[lines, before], np.nan)
    b = np.where(after < n, values[lines, np.minimum(after, n - 1)], np.nan)
    between = a + (at - before) / (after - before) * (b - a)
    return np.where(np.isnan(a), b, np.where(np.isnan(b), a, between)).astype(np.float32)


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
