"""The robot's surface as a camera would see it, from the meshes it is drawn by and its joints.

Unlike the silhouette, which is grown to be sure, this is as exact as the meshes are: what a depth
camera measures there can be held against it. World is the robot's base.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from akm_fg.arm.body.description import ArmDescription, franka_description
from akm_fg.arm.body.model import N_ARM, read_drawn_meshes, read_model
from akm_fg.arm.body.silhouette import mesh_triangles
from akm_fg.records import FloatArray, PinholeCamera


@dataclass(frozen=True, slots=True)
class SeenSurface:
    """What each pixel would show of the robot."""

    depth_m: NDArray[np.float32]  # (H, W) along camera z; infinite where there is no robot
    normal_cam: FloatArray  # (H, W, 3) unit, towards the camera; 0 where there is no robot
    link: NDArray[np.int64]  # (H, W) which of the robot's meshes; -1 where there is none


class ArmSurface:
    """The robot, base and fingers included."""

    def __init__(self, description: ArmDescription | None = None) -> None:
        """Reads the meshes; without a description, those of the installed PyBullet's data.

        Raises:
            MissingDependency: no description is given, and none is installed.
            InputError: the description cannot be read.
        """
        description = description or franka_description()
        self._model = read_model(description)
        self._meshes = read_drawn_meshes(description, self._model)
        self._data, self._places = self._model.createData(), self._meshes.createData()
        self._parts = [mesh_triangles(shape) for shape in self._meshes.geometryObjects]

    def seen(
        self, q: FloatArray, fingers_m: float, camera: PinholeCamera, T_world_cam: gtsam.Pose3
    ) -> SeenSurface:
        """The robot alone, as an undistorted image shows it.

        Args:
            q: joint angles (7,), rad.
            fingers_m: travel of either finger, half of their opening.
            camera: of the image.
            T_world_cam: where it is.
        """
        import open3d as o3d  # takes seconds, and who only plans never casts a ray

        q_all = np.full(self._model.nq, fingers_m)
        q_all[:N_ARM] = q
        pin.updateGeometryPlacements(self._model, self._data, self._meshes, self._places, q_all)
        T_cam_world = pin.SE3(T_world_cam.inverse().matrix())
        # Tensors and scene live no longer than this call: kept ones can end the process.
        scene = o3d.t.geometry.RaycastingScene()
        for T_world_part, (p_part, faces) in zip(self._places.oMg, self._parts, strict=True):
            T = T_cam_world * T_world_part
            p_cam = (p_part @ T.rotation.T + T.translation).astype(np.float32)
            scene.add_triangles(o3d.core.Tensor(p_cam), o3d.core.Tensor(faces))
        rays = np.zeros((camera.height, camera.width, 6), dtype=np.float32)
        rays[..., 3] = (np.arange(camera.width) - camera.cx) / camera.fx
        rays[..., 4] = ((np.arange(camera.height) - camera.cy) / camera.fy)[:, None]
        rays[..., 5] = 1.0  # so that lengths along a ray are depths
        found = scene.cast_rays(o3d.core.Tensor(rays))
        depth_m = found["t_hit"].numpy().copy()
        hit = np.isfinite(depth_m)
        normal = np.where(hit[..., None], found["primitive_normals"].numpy(), 0.0)
        away = np.einsum("hwi,hwi->hw", normal, rays[..., 3:]) > 0.0
        normal[away] *= -1.0
        link = np.where(hit, found["geometry_ids"].numpy().astype(np.int64), -1)
        return SeenSurface(depth_m, normal, link)

    def turned_by(self, p_world: FloatArray, link: NDArray[np.int64]) -> FloatArray:
        """How points (N, 3) on meshes `link` (N,) go with each joint: (N, 3, 7) m/rad.

        Where the arm stood in the last `seen`.
        """
        J = np.zeros((len(p_world), 3, N_ARM))
        carries = np.array([shape.parentJoint for shape in self._meshes.geometryObjects])
        for j in range(N_ARM):  # joint j + 1 of the model, whose joint 0 is the world
            T_world_joint = self._data.oMi[j + 1]
            axis = T_world_joint.rotation[:, 2]
            moved = carries[link] > j  # the arm is a chain
            arm = p_world[moved] - T_world_joint.translation
            J[moved, :, j] = np.cross(axis, arm)
        return J
