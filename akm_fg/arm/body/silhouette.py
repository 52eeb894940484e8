"""Where the robot is in a camera's image, from its own meshes and joint angles.

What a camera measures on the robot is not the scene: its pixels have to go before anything is
estimated, and a real camera does not say which they are. Rays from the camera through the pixels
are cast at the collision meshes (Open3D's ray casting, which needs no display), which enclose the
robot to 1.5 mm with few triangles. What is found is grown by what may be wrong about camera and
arm. World is the robot's base.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import gtsam
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from akm_fg.arm.body.description import ArmDescription, franka_description
from akm_fg.arm.body.model import N_ARM, read_meshes, read_model
from akm_fg.errors import InputError
from akm_fg.records import BoolArray, FloatArray, PinholeCamera, RgbdFrame

Depths = NDArray[np.float32]  # (H, W) along camera z; infinite where there is no robot


@dataclass(frozen=True, slots=True)
class SilhouetteConfig:
    """What the silhouette is grown by, and what counts as in front of the robot."""

    # Of the robot's surface: a calibrated camera is off by at most 4 mm at 1 m
    # (docs/calibration.md), the shell stands out of the collision meshes by up to 1.5 mm, and
    # 2 mm are left for an arm that is not quite where its encoders say.
    margin_m: float = 0.008
    margin_px: float = 2.0  # pixels are mixed at edges, and colour is registered to a pixel
    nearest_m: float = 0.05  # nearer parts grow as if they were here: less than a lens shows sharp
    slack_m: float = 0.03  # depth noise and flying pixels near the robot


@dataclass(frozen=True, slots=True)
class _Window:
    """A rectangle of pixels, which may reach beyond the image."""

    u: int
    v: int
    width: int
    height: int


class ArmSilhouette:
    """The robot, base and fingers included, as a calibrated camera sees it."""

    def __init__(
        self, description: ArmDescription | None = None, config: SilhouetteConfig | None = None
    ) -> None:
        """Reads the meshes; without a description, those of the installed PyBullet's data.

        Raises:
            MissingDependency: no description is given, and none is installed.
            InputError: the description cannot be read.
        """
        self.config = config or SilhouetteConfig()
        description = description or franka_description()
        self._model = read_model(description)
        self._meshes = read_meshes(description, self._model)
        self._data, self._places = self._model.createData(), self._meshes.createData()
        self._parts = [mesh_triangles(shape) for shape in self._meshes.geometryObjects]

    def depth(
        self, q: FloatArray, fingers_m: float, camera: PinholeCamera, T_world_cam: gtsam.Pose3
    ) -> Depths:
        """Depth (H, W) of the robot along camera z, grown by the margins; NaN elsewhere.

        Args:
            q: joint angles (7,), rad.
            fingers_m: travel of either finger, half of their opening.
            camera: of an undistorted image.
            T_world_cam: where the camera is.
        """
        corners = self._corners_cam(q, fingers_m, T_world_cam)
        window = self._window(corners, camera)
        result = np.full((camera.height, camera.width), np.nan, dtype=np.float32)
        if window is None:
            return result
        meshes = [(p_cam, faces) for p_cam, (_, faces) in zip(corners, self._parts, strict=True)]
        grown = self._grown(*_cast(meshes, camera, window), max(camera.fx, camera.fy))
        # The window reaches at least to the image's edges where it is beyond them.
        v, u = max(window.v, 0), max(window.u, 0)
        inside = grown[v - window.v :, u - window.u :][: camera.height - v, : camera.width - u]
        height, width = inside.shape
        result[v : v + height, u : u + width] = np.where(np.isfinite(inside), inside, np.nan)
        return result

    def mask(
        self, q: FloatArray, fingers_m: float, camera: PinholeCamera, T_world_cam: gtsam.Pose3
    ) -> BoolArray:
        """(H, W) where the robot may be seen; see `depth`."""
        return np.isfinite(self.depth(q, fingers_m, camera, T_world_cam))

    def masked(self, frame: RgbdFrame, q: FloatArray, fingers_m: float) -> RgbdFrame:
        """The frame without the robot: its pixels, and what it hides, carry no depth.

        What stands in front of it by more than `slack_m` stays.

        Args:
            frame: as a camera measured it.
            q: joint angles (7,) when it did, rad.
            fingers_m: travel of either finger then.
        """
        robot = self.depth(q, fingers_m, frame.camera, frame.T_world_cam)
        hidden = robot - self.config.slack_m <= frame.depth_m  # NaN compares False
        depth = np.where(hidden, np.float32(np.nan), frame.depth_m)
        return replace(frame, depth_m=np.asarray(depth, dtype=np.float32))

    def _corners_cam(
        self, q: FloatArray, fingers_m: float, T_world_cam: gtsam.Pose3
    ) -> list[FloatArray]:
        """Of each part, its mesh's corners (K, 3) in the camera's frame."""
        q_all = np.full(self._model.nq, fingers_m)
        q_all[:N_ARM] = q
        pin.updateGeometryPlacements(self._model, self._data, self._meshes, self._places, q_all)
        T_cam_world = pin.SE3(T_world_cam.inverse().matrix())
        T_cam_parts = [T_cam_world * T_world_part for T_world_part in self._places.oMg]
        return [
            p_part @ T.rotation.T + T.translation
            for T, (p_part, _) in zip(T_cam_parts, self._parts, strict=True)
        ]

    def _window(self, corners: list[FloatArray], camera: PinholeCamera) -> _Window | None:
        """Around the robot and its margin in the image; None: it is not in it."""
        p_cam = np.concatenate(corners)
        nearest_m = self.config.nearest_m
        ahead = p_cam[p_cam[:, 2] > nearest_m]
        if not len(ahead):
            return None
        pad = self._radius_px(float(p_cam[:, 2].min()), max(camera.fx, camera.fy))
        size = np.array([camera.width, camera.height])
        low, high = np.array([-pad, -pad]), size + pad
        if len(ahead) == len(p_cam):  # else something is beside the camera and fills the picture
            uv = camera.project(ahead)
            low = np.maximum(low, np.floor(uv.min(axis=0)).astype(int) - pad)
            high = np.minimum(high, np.ceil(uv.max(axis=0)).astype(int) + pad + 1)
        if (low >= size).any() or (high <= 0).any():
            return None
        (u, v), (width, height) = low.tolist(), (high - low).tolist()
        return _Window(u, v, width, height)

    def _grown(self, depth_m: Depths, part: NDArray[np.uint32], focal_px: float) -> Depths:
        """Each part grown by the margins at its nearest point; of several, the nearest counts."""
        result = np.full_like(depth_m, np.inf)
        hit = np.isfinite(depth_m)
        for k in np.unique(part[hit]):
            own = np.where(hit & (part == k), depth_m, np.float32(np.inf))
            v, u = np.nonzero(np.isfinite(own))
            radius = self._radius_px(float(own[v, u].min()), focal_px)
            around = (
                slice(max(v.min() - radius, 0), v.max() + radius + 1),
                slice(max(u.min() - radius, 0), u.max() + radius + 1),
            )
            square = np.ones((2 * radius + 1,) * 2, dtype=np.uint8)
            # OpenCV's own border is a large number, which is nearer than infinity.
            grown = cv2.erode(own[around], square, borderType=cv2.BORDER_REPLICATE)
            result[around] = np.minimum(result[around], grown)
        return result

    def _radius_px(self, depth_m: float, focal_px: float) -> int:
        c = self.config
        return int(np.ceil(c.margin_px + focal_px * c.margin_m / max(depth_m, c.nearest_m)))


def mesh_triangles(shape: pin.GeometryObject) -> tuple[FloatArray, NDArray[np.uint32]]:
    """Corners (K, 3) and triangles (F, 3) of a link's mesh, in the frame of its shape.

    Read once more from its file: of an OBJ file with several materials, such as link 6, coal 3.0.3
    takes the triangles of all but the first from wrong corners (the corners are right, and with
    them the hulls). Plain numpy is kept, nothing of Open3D.

    Raises:
        InputError: Open3D cannot read the file.
    """
    import open3d as o3d  # takes seconds, and who only plans never casts a ray

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh = o3d.io.read_triangle_mesh(shape.meshPath)  # else it tells of missing textures
    if not mesh.has_triangles():
        raise InputError(shape.meshPath, "no triangles", "a mesh that Open3D reads: OBJ, STL, PLY")
    corners = np.array(mesh.vertices) * shape.meshScale
    return corners, np.array(mesh.triangles, dtype=np.uint32)


def _cast(
    meshes: list[tuple[FloatArray, NDArray[np.uint32]]], camera: PinholeCamera, window: _Window
) -> tuple[Depths, NDArray[np.uint32]]:
    """What the pixels of a window show of meshes in the camera's frame.

    Tensors and scene live no longer than this call: kept ones can end the process.

    Returns:
        depth (h, w) along camera z, infinite where nothing is; (h, w) index of the mesh.
    """
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    for p_cam, faces in meshes:
        scene.add_triangles(o3d.core.Tensor(p_cam.astype(np.float32)), o3d.core.Tensor(faces))
    rays = np.zeros((window.height, window.width, 6), dtype=np.float32)
    u = np.arange(window.u, window.u + window.width)
    v = np.arange(window.v, window.v + window.height)
    rays[..., 3] = (u - camera.cx) / camera.fx
    rays[..., 4] = ((v - camera.cy) / camera.fy)[:, None]
    rays[..., 5] = 1.0  # so that lengths along a ray are depths
    found = scene.cast_rays(o3d.core.Tensor(rays))
    return found["t_hit"].numpy().copy(), found["geometry_ids"].numpy().copy()
