"""One picture of a PyBullet client, by either of its renderers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import FloatArray, PinholeCamera
from sim.bullet import p

Renderer = Literal["tiny", "egl"]
DepthImage = NDArray[np.floating]  # (H, W), metres along z
Matrix = tuple[float, ...]  # 4x4, column-major as OpenGL has it

# Where pixel (i, j) samples the image plane, pixels from its corner: TinyRenderer at (i, j + 1),
# the EGL plugin at (i + 0.5, j + 0.5). Proven by the back-projection test.
SAMPLED_AT = {"tiny": (0.0, 1.0), "egl": (0.5, 0.5)}
# Of the near plane. TinyRenderer's depth is in floats. Drivers may give EGL 16 bits: with these,
# depth is exact to 0.5 z^2 / (2^16 near), a tenth of a millimetre at 1.8 m.
NEAR_M = {"tiny": 0.1, "egl": 0.25}


@dataclass(frozen=True, slots=True)
class Shot:
    """From where, how large and in what light; plain numbers, so that it can be sent away."""

    width: int
    height: int
    view: Matrix
    projection: Matrix
    near_m: float
    far_m: float
    light: tuple[float, float, float]  # direction to the light, world


@dataclass(frozen=True, slots=True)
class Picture:
    """What a shot shows, before any noise."""

    rgb: NDArray[np.uint8]  # (H, W, 3)
    depth_m: DepthImage  # (H, W), along z, exact to 1e-5 m; NaN beyond the far plane
    body: NDArray[np.int32]  # (H, W) id of the body that each pixel shows; -1 is none


def rendered_intrinsics(
    width: int, height: int, focal_px: float, renderer: Renderer = "tiny"
) -> PinholeCamera:
    """Intrinsics of a rendered image, pixel centres at integers.

    The projection's middle is (width / 2, height / 2); see SAMPLED_AT for what follows.
    """
    du, dv = SAMPLED_AT[renderer]
    return PinholeCamera(width, height, focal_px, focal_px, width / 2.0 - du, height / 2.0 - dv)


def view_matrix(T_world_cam: gtsam.Pose3) -> Matrix:
    """OpenGL's view of a camera with x right, y down, z forward."""
    eye, R = T_world_cam.translation(), T_world_cam.rotation().matrix()
    ahead, up = eye + R[:, 2], -R[:, 1]
    return tuple(p.computeViewMatrix(eye.tolist(), ahead.tolist(), up.tolist()))


def projection_matrix(
    size: tuple[int, int], focal_px: float, near_m: float, far_m: float
) -> Matrix:
    """OpenGL's projection with the principal point in the middle of `size` (width, height)."""
    n, f = near_m, far_m
    x, y = 2.0 * focal_px / size[0], 2.0 * focal_px / size[1]
    z, w = -(f + n) / (f - n), -2.0 * f * n / (f - n)
    return (x, 0, 0, 0, 0, y, 0, 0, 0, 0, z, -1, 0, 0, w, 0)


def take(client: int, shot: Shot, renderer: Renderer = "tiny") -> Picture:
    """Draws all that `client` holds."""
    w, h = shot.width, shot.height
    image = p.getCameraImage(
        w,
        h,
        viewMatrix=shot.view,
        projectionMatrix=shot.projection,
        lightDirection=list(shot.light),
        lightAmbientCoeff=0.62,
        lightDiffuseCoeff=0.42,
        lightSpecularCoeff=0.05,
        shadow=0,
        renderer=p.ER_TINY_RENDERER if renderer == "tiny" else p.ER_BULLET_HARDWARE_OPENGL,
        physicsClientId=client,
    )
    rgb = cv2.cvtColor(np.asarray(image[2], dtype=np.uint8).reshape(h, w, 4), cv2.COLOR_RGBA2RGB)
    buffer = np.asarray(image[3], dtype=np.float32).reshape(h, w)
    near, far = shot.near_m, shot.far_m
    depth = far * near / (far - (far - near) * buffer)
    depth[buffer >= 1.0 - 1e-7] = np.nan
    body = np.asarray(image[4], dtype=np.int32).reshape(h, w)
    return Picture(np.asarray(rgb), depth, body)


def height_above_plane(
    depth_m: DepthImage, camera: PinholeCamera, T_world_cam: gtsam.Pose3, axis: int, at_m: float
) -> FloatArray:
    """(H, W) signed distance of back-projected pixels from the world plane x[axis] = at_m."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    p_cam = camera.back_project(np.stack([u, v], axis=-1), np.asarray(depth_m, dtype=float))
    row = T_world_cam.rotation().matrix()[axis]
    return np.asarray(p_cam @ row + T_world_cam.translation()[axis] - at_m)
