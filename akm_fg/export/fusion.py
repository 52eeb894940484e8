"""Coloured meshes of an object's surfaces: fused from depth where its recording is at hand.

The frames are put where the posterior's states say that the part was, into a truncated signed
distance volume (Curless and Levoy, "A volumetric method for building complex models from range
images", 1996; Open3D's). Which pixels are the part's and which rest the model's own surface says:
those near it. Without the recording a Poisson surface is laid through the model's points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from scipy.spatial import cKDTree

from akm_fg.export.config import ExportConfig
from akm_fg.export.description import Mesh
from akm_fg.model.records import Surface
from akm_fg.records import RgbdFrame


@dataclass(frozen=True, slots=True)
class PlacedFrame:
    """A frame, and where the surface is in it."""

    frame: RgbdFrame
    T_world_surface: gtsam.Pose3


def fused_mesh(surface: Surface, frames: Sequence[PlacedFrame], config: ExportConfig) -> Mesh:
    """The mesh of a surface from the depth of frames.

    Args:
        surface: of a model; says which depth belongs to it.
        frames: with depth of it.
        config: tuning.
    """
    import open3d as o3d

    tree = cKDTree(surface.p_world)
    volume = o3d.pipelines.integration.ScalableTSDFVolume(
        config.voxel_m, config.truncation_m, o3d.pipelines.integration.TSDFVolumeColorType.RGB8
    )
    for placed in frames:
        frame, c = placed.frame, placed.frame.camera
        T_surface_cam = placed.T_world_surface.inverse() * frame.T_world_cam
        depth = _depth_near(frame, T_surface_cam, tree, config.near_m)
        image = o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(np.ascontiguousarray(frame.rgb)),
            o3d.geometry.Image(depth),
            depth_scale=1.0,
            depth_trunc=float(depth.max()) + 1.0,
            convert_rgb_to_intensity=False,
        )
        intrinsic = o3d.camera.PinholeCameraIntrinsic(c.width, c.height, c.fx, c.fy, c.cx, c.cy)
        volume.integrate(image, intrinsic, T_surface_cam.inverse().matrix())
    return _simplified(volume.extract_triangle_mesh(), config.triangles)


def _depth_near(
    frame: RgbdFrame, T_surface_cam: gtsam.Pose3, tree: Any, near_m: float
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """(H, W) depth of the pixels that lie on the surface; 0 elsewhere."""
    v, u = np.nonzero(np.isfinite(frame.depth_m))
    depth = frame.depth_m[v, u]
    p = frame.camera.back_project(np.stack([u, v], axis=-1).astype(float), depth.astype(float))
    p = p @ T_surface_cam.rotation().matrix().T + T_surface_cam.translation()
    distance, _ = tree.query(p, distance_upper_bound=near_m)
    near = np.isfinite(distance)
    out = np.zeros(frame.depth_m.shape, np.float32)
    out[v[near], u[near]] = depth[near]
    return out


def poisson_mesh(surface: Surface, config: ExportConfig) -> Mesh:
    """The mesh of a surface from its points alone (Kazhdan and Hoppe, 2013; Open3D's)."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(surface.p_world))
    cloud.normals = o3d.utility.Vector3dVector(surface.normal_world)
    cloud.colors = o3d.utility.Vector3dVector(surface.rgb / 255.0)
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud.voxel_down_sample(config.voxel_m), depth=config.poisson_depth, n_threads=1
    )
    # The function is solved for on a cube: where no point is near it is made up.
    distance, _ = cKDTree(surface.p_world).query(np.asarray(mesh.vertices))
    mesh.remove_vertices_by_mask(distance > config.near_m)
    return _simplified(mesh, config.triangles)


def _simplified(mesh: Any, triangles: int) -> Mesh:
    """An Open3D mesh with at most so many triangles, as a record."""
    if len(mesh.triangles) > triangles:
        mesh = mesh.simplify_quadric_decimation(triangles)
    mesh.remove_degenerate_triangles()
    mesh.remove_unreferenced_vertices()
    colours = np.clip(np.asarray(mesh.vertex_colors) * 255.0, 0, 255)
    return Mesh(
        np.array(mesh.vertices),
        np.array(mesh.triangles).astype(np.int64).reshape(-1, 3),
        np.rint(colours).astype(np.uint8).reshape(-1, 3),
    )


def with_fewer_triangles(mesh: Mesh, triangles: int) -> Mesh:
    """The same surface with at most so many triangles."""
    import open3d as o3d

    made = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.points),
        o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32)),
    )
    made.vertex_colors = o3d.utility.Vector3dVector(mesh.rgb / 255.0)
    return _simplified(made, triangles)
