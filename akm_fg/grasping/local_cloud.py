"""What a camera sees near a contact: points, voxels to keep clear of, and what is hidden."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import BoolArray, FloatArray, PinholeCamera, RgbdFrame


@dataclass(frozen=True, slots=True)
class LocalCloud:
    """The points near a contact. What is hidden behind them is unknown, not solid."""

    p_world: FloatArray  # (N, 3)
    pixels: NDArray[np.int64]  # (N, 2) u, v that show them
    on_object: BoolArray  # (N,)
    pixel_m: float  # between neighbouring points, across the ray
    depth_m: NDArray[np.float32]  # (H, W) of the whole picture
    camera: PinholeCamera
    T_world_cam: gtsam.Pose3

    def near(self, p_world: FloatArray, radius_m: float) -> FloatArray:
        """Points (M, 3) within a sphere; of the object or not: masks lack what is thin."""
        close = np.linalg.norm(self.p_world - p_world, axis=1) < radius_m
        return np.asarray(self.p_world[close])

    def voxels(self, voxel_m: float, least: int) -> FloatArray:
        """Middles (M, 3) of the voxels with so many points: a single one may be noise."""
        index = np.floor(self.p_world / voxel_m).astype(np.int64)
        cells, count = np.unique(index, axis=0, return_counts=True)
        return np.asarray((cells[count >= least] + 0.5) * voxel_m)

    def hidden(self, p_world: FloatArray, slack_m: float) -> BoolArray:
        """(M,) which places (M, 3) the camera cannot see: behind something, or out of sight."""
        p_cam = self.T_world_cam.transformTo(p_world.T).T
        uv = np.nan_to_num(self.camera.project(p_cam), nan=-1.0)
        u, v = np.rint(uv).astype(int).T
        inside = (u >= 0) & (u < self.camera.width) & (v >= 0) & (v < self.camera.height)
        seen = np.full(len(p_world), np.nan)
        seen[inside] = self.depth_m[v[inside], u[inside]]
        return np.asarray(~(p_cam[:, 2] < seen + slack_m))  # NaN: unknown


def local_cloud(
    frame: RgbdFrame, mask: BoolArray, p_world: FloatArray, half_m: float
) -> LocalCloud:
    """The points of a frame within a cube of side 2 `half_m` about a contact (3,).

    Raises:
        ValueError: the mask has another size than the image, or the contact is not finite.
    """
    if mask.shape != frame.depth_m.shape:
        raise ValueError(f"mask {mask.shape}, expected {frame.depth_m.shape}")
    if p_world.shape != (3,) or not np.isfinite(p_world).all():
        raise ValueError(f"contact {p_world}, expected three finite numbers")
    camera, T = frame.camera, frame.T_world_cam
    depth = np.where(frame.depth_m > 0, frame.depth_m, np.nan)
    window = _window(camera, T.transformTo(p_world), half_m)
    v, u = np.nonzero(np.isfinite(depth[window]))
    v, u = v + window[0].start, u + window[1].start
    z = depth[v, u].astype(float)
    p_cam = camera.back_project(np.column_stack([u, v]).astype(float), z)
    p = p_cam @ T.rotation().matrix().T + T.translation()
    close = (np.abs(p - p_world) < half_m).all(axis=1)
    distance = float(T.transformTo(p_world)[2])
    pixel_m = max(distance, 0.0) / float(np.sqrt(camera.fx * camera.fy))
    pixels = np.column_stack([u, v])[close]
    return LocalCloud(p[close], pixels, mask[v[close], u[close]], pixel_m, depth, camera, T)


def _window(camera: PinholeCamera, p_cam: FloatArray, half_m: float) -> tuple[slice, slice]:
    """Rows and columns that show a cube about a point; empty where it is behind the camera."""
    near = p_cam[2] - np.sqrt(3.0) * half_m
    if near <= 0.0:
        return np.s_[0 : camera.height, 0 : camera.width] if p_cam[2] > 0 else np.s_[0:0, 0:0]
    reach = np.sqrt(3.0) * half_m / near * max(camera.fx, camera.fy)
    u, v = camera.project(p_cam)
    rows = max(int(v - reach), 0), min(max(int(v + reach) + 2, 0), camera.height)
    columns = max(int(u - reach), 0), min(max(int(u + reach) + 2, 0), camera.width)
    return np.s_[rows[0] : max(rows), columns[0] : max(columns)]
