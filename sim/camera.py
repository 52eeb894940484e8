"""A fixed RGB-D camera, rendered without a display, that masks the robot by its own geometry."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.records import PinholeCamera, RgbdFrame
from sim.bullet import PANDA_URDF, load_urdf, p, quiet
from sim.noise import NOISE_LEVELS, DepthImage, NoiseConfig, noisy_depth, noisy_rgb
from sim.world import SimWorld


@dataclass(frozen=True, slots=True)
class CameraConfig:
    """Image geometry and rendering."""

    width: int = 640
    height: int = 480
    focal_px: float = 600.0  # colour camera of a D435 at 640 x 480 (about 56 deg wide)
    near_m: float = 0.1
    far_m: float = 8.0
    mask_scale: int = 2  # the robot is drawn this many times smaller for masking
    mask_grow_px: int = 4  # dilation of the robot, full-resolution pixels
    mask_slack_m: float = 0.03  # depth noise and flying pixels near the robot
    light: tuple[float, float, float] = (-1.0, 0.6, 2.5)  # direction to the light, world
    noise: NoiseConfig = field(default_factory=lambda: NOISE_LEVELS["d455"])

    def scaled(self, factor: float) -> CameraConfig:
        """The same view with `factor` times the pixels along either side."""
        return replace(
            self,
            width=round(factor * self.width),
            height=round(factor * self.height),
            focal_px=factor * self.focal_px,
        )


def rendered_intrinsics(width: int, height: int, focal_px: float) -> PinholeCamera:
    """Intrinsics of a TinyRenderer image, pixel centres at integers.

    TinyRenderer samples pixel (i, j) at (i, j + 1) of the image plane whose middle is
    (width / 2, height / 2); hence this principal point. Proven by the back-projection test.
    """
    return PinholeCamera(width, height, focal_px, focal_px, width / 2.0, height / 2.0 - 1.0)


def render(
    client: int, T_world_cam: gtsam.Pose3, config: CameraConfig, scale: int = 1
) -> tuple[NDArray[np.uint8], DepthImage]:
    """RGB (h, w, 3) and depth (h, w) in metres along z, exact to 1e-5 m; NaN beyond `far_m`."""
    w, h = config.width // scale, config.height // scale
    eye, R = T_world_cam.translation(), T_world_cam.rotation().matrix()
    image = p.getCameraImage(
        w,
        h,
        viewMatrix=p.computeViewMatrix(eye.tolist(), (eye + R[:, 2]).tolist(), (-R[:, 1]).tolist()),
        projectionMatrix=_projection(config),
        lightDirection=list(config.light),
        lightAmbientCoeff=0.62,
        lightDiffuseCoeff=0.42,
        lightSpecularCoeff=0.05,
        shadow=0,
        renderer=p.ER_TINY_RENDERER,
        flags=p.ER_NO_SEGMENTATION_MASK,
        physicsClientId=client,
    )
    rgb = cv2.cvtColor(np.asarray(image[2], dtype=np.uint8).reshape(h, w, 4), cv2.COLOR_RGBA2RGB)
    buffer = np.asarray(image[3], dtype=np.float32).reshape(h, w)
    near, far = config.near_m, config.far_m
    depth = far * near / (far - (far - near) * buffer)
    depth[buffer >= 1.0 - 1e-7] = np.nan
    return np.asarray(rgb), depth


def _projection(config: CameraConfig) -> list[float]:
    """OpenGL projection, column-major, with the principal point in the middle."""
    n, f = config.near_m, config.far_m
    x = 2.0 * config.focal_px / config.width
    y = 2.0 * config.focal_px / config.height
    z, w = -(f + n) / (f - n), -2.0 * f * n / (f - n)
    return [x, 0, 0, 0, 0, y, 0, 0, 0, 0, z, -1, 0, 0, w, 0]


def _render_still(
    world: SimWorld, T_world_cam: gtsam.Pose3, config: CameraConfig
) -> tuple[NDArray[np.uint8], DepthImage]:
    """RGB and depth of what never moves: room, supports and corpus."""
    with quiet():
        client = int(p.connect(p.DIRECT))
    try:
        for urdf, T_world_body in world.still:
            load_urdf(client, urdf, T_world_body)
        return render(client, T_world_cam, config)
    finally:
        p.disconnect(physicsClientId=client)


def _load_robot_outline(client: int) -> int:
    """The robot drawn by its collision meshes: they enclose it and have few triangles."""
    meshes = PANDA_URDF.parent / "meshes" / "collision"
    text = PANDA_URDF.read_text(encoding="utf-8")
    for folder in ("visual", "collision"):
        text = text.replace(f"package://meshes/{folder}", meshes.as_posix())
    with tempfile.TemporaryDirectory(prefix="akm-fg-sim-") as scratch:
        path = Path(scratch) / "outline.urdf"
        path.write_text(text, encoding="utf-8")
        return load_urdf(client, path, gtsam.Pose3())


class SimCamera:
    """Fits `akm_fg.interfaces.Camera`. A context manager: it holds a second, robot-only client."""

    def __init__(
        self,
        world: SimWorld,
        T_world_cam: gtsam.Pose3,
        seed: int,
        config: CameraConfig | None = None,
    ) -> None:
        self.config = config or CameraConfig()
        self.T_world_cam = T_world_cam
        c = self.config
        self.intrinsics = rendered_intrinsics(c.width, c.height, c.focal_px)
        self._world = world
        self._rng = np.random.default_rng([seed, 11])
        with quiet():
            self._robot_client = int(p.connect(p.DIRECT))
        self._robot = _load_robot_outline(self._robot_client)
        self._still = _render_still(world, T_world_cam, self.config)

    def close(self) -> None:
        """Frees the robot-only client."""
        if self._robot_client >= 0:
            p.disconnect(physicsClientId=self._robot_client)
            self._robot_client = -1

    def capture(self) -> RgbdFrame:
        """The scene now, with noise; pixels that show the robot carry no depth."""
        rgb, exact = self.exact()
        depth = noisy_depth(exact, self.intrinsics, self.config.noise, self._rng)
        robot = self.robot_depth()
        # A hole in front of the robot stays a hole; NaN compares False.
        depth[np.isfinite(robot) & ~(depth < robot - self.config.mask_slack_m)] = np.nan
        return RgbdFrame(
            stamp_s=self._world.time_s,
            rgb=noisy_rgb(rgb, self.config.noise, self._rng),
            depth_m=depth.astype(np.float32),
            camera=self.intrinsics,
            T_world_cam=self.T_world_cam,
        )

    def exact(self) -> tuple[NDArray[np.uint8], DepthImage]:
        """RGB (H, W, 3) and depth (H, W) before noise and masking.

        Only robot and part are drawn: what stands still was drawn once.
        """
        rgb, depth = render(self._world.client, self.T_world_cam, self.config)
        still_rgb, still_depth = self._still
        # Nothing moves behind what is not there: NaN in `still_depth` compares False.
        behind = ~np.isfinite(depth) | (still_depth <= depth)
        mask = behind.view(np.uint8)
        cv2.copyTo(still_rgb, mask, rgb)  # ten times as fast as indexing
        cv2.copyTo(still_depth, mask, depth)
        return rgb, depth

    def robot_depth(self) -> DepthImage:
        """Depth (H, W) of the robot alone at its measured joint angles, grown; NaN elsewhere."""
        world = self._world
        n = p.getNumJoints(world.robot_id, physicsClientId=world.client)
        states = p.getJointStates(world.robot_id, list(range(n)), physicsClientId=world.client)
        for j, state in enumerate(states):
            p.resetJointState(self._robot, j, state[0], physicsClientId=self._robot_client)
        scale = self.config.mask_scale
        _, small = render(self._robot_client, self.T_world_cam, self.config, scale)
        side = 2 * int(np.ceil(self.config.mask_grow_px / scale)) + 1
        solid = np.where(np.isfinite(small), small, np.inf).astype(np.float32)
        grown = cv2.erode(solid, np.ones((side, side), dtype=np.uint8))
        full = np.repeat(np.repeat(grown, scale, axis=0), scale, axis=1)
        return np.where(np.isfinite(full), full, np.nan)
