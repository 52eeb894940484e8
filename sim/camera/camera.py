"""A fixed RGB-D camera, rendered without a display, that masks the robot by its own geometry."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from akm_fg.arm.body.description import ArmDescription
from akm_fg.arm.body.model import N_ARM
from akm_fg.arm.depth_from_arm import DepthCorrection
from akm_fg.records import RgbdFrame
from sim.bullet import connect, load_urdf, p
from sim.camera.materials import MATT, specular_of
from sim.camera.mirror import Scene, Shape, bodies_of, poses_of, shapes_of
from sim.camera.noise import NOISE_LEVELS, NoiseConfig, Surface
from sim.camera.pictures import (
    NEAR_M,
    DepthImage,
    Picture,
    Renderer,
    Shot,
    projection_matrix,
    rendered_intrinsics,
    take,
    view_matrix,
)
from sim.camera.rendering import Choice, Wanted, choose_renderer, open_scene
from sim.camera.rig import CameraErrors, DrawnRig
from sim.camera.sensor import NoisySensor
from sim.world import SimWorld


@dataclass(frozen=True, slots=True)
class CameraConfig:
    """Image geometry and rendering."""

    width: int = 640
    height: int = 480
    focal_px: float = 600.0  # middle of the 1280 x 800 colour image of a D455 (about 630 px)
    far_m: float = 8.0
    renderer: Wanted = "auto"
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

    def shot(self, T_world_cam: gtsam.Pose3, renderer: Renderer = "tiny", scale: int = 1) -> Shot:
        """A picture from a pose, `scale` times smaller."""
        size, near_m = (self.width, self.height), NEAR_M[renderer]
        return Shot(
            self.width // scale,
            self.height // scale,
            view_matrix(T_world_cam),
            projection_matrix(size, self.focal_px, near_m, self.far_m),
            near_m,
            self.far_m,
            self.light,
        )


def _load_robot_outline(client: int, robot: ArmDescription) -> int:
    """The robot drawn by its collision meshes: they enclose it and have few triangles."""
    meshes = robot.urdf.parent / "meshes" / "collision"
    text = robot.urdf.read_text(encoding="utf-8")
    for folder in ("visual", "collision"):
        text = text.replace(f"package://meshes/{folder}", meshes.as_posix())
    with tempfile.TemporaryDirectory(prefix="akm-fg-sim-") as scratch:
        path = Path(scratch) / "outline.urdf"
        path.write_text(text, encoding="utf-8")
        return load_urdf(client, path, gtsam.Pose3(), keep_files=True)


NO_SHAPES = np.array([MATT], dtype=np.float32)


def _specular_of(shapes: Sequence[Shape]) -> NDArray[np.float32]:
    """(N + 1,) specular share of each shape, and of none at the end, where index -1 finds it."""
    return np.array([*(specular_of(shape.mesh) for shape in shapes), MATT], dtype=np.float32)


class SimCamera:
    """Fits `akm_fg.interfaces.Camera`. To be closed: it holds a renderer and a robot to mask."""

    def __init__(
        self,
        world: SimWorld,
        T_world_cam: gtsam.Pose3,
        seed: int,
        config: CameraConfig | None = None,
        scene: Scene | None = None,
        rig: DrawnRig | None = None,
    ) -> None:
        """Opens the renderer and draws what stands still.

        Args:
            world: what is seen.
            T_world_cam: from where; fixed.
            seed: of the noise.
            config: image size, noise and the renderer, which is chosen by trial by default.
            scene: draws, instead of the configuration's renderer; is closed with the camera.
            rig: errs: `intrinsics` and `T_world_cam` are what is believed; perfect if absent.

        Raises:
            RendererFailed: the renderer that was asked for does not work here.
        """
        self.config = config or CameraConfig()
        self._errors = CameraErrors() if rig is None else rig.camera
        self._offsets_rad = np.zeros(N_ARM) if rig is None else rig.joint_offsets_rad
        self.T_world_cam = self._errors.believed_place(T_world_cam)
        c = self.config
        if scene is None:
            self.renderer = choose_renderer(c.renderer, (c.width, c.height))
        else:
            self.renderer = Choice(scene.renderer, "handed in")
        name = self.renderer.name
        true = rendered_intrinsics(c.width, c.height, c.focal_px, name)
        self.intrinsics = self._errors.believed_camera(true)
        self._correction: DepthCorrection | None = None
        self._world = world
        self._sensor = NoisySensor(c.noise, true, np.random.default_rng([seed, 11]))
        self._robot_client = connect()
        self._robot = _load_robot_outline(self._robot_client, world.arm_description)
        self._shot = c.shot(T_world_cam, name)
        self._scene = scene or open_scene(self.renderer)
        self._still = self._draw_still()
        self._bodies: tuple[int, ...] = ()
        self._shapes: list[Shape] = []
        self._specular = NO_SHAPES

    def close(self) -> None:
        """Frees the renderer and the robot-only client."""
        self._scene.close()
        if self._robot_client >= 0:
            p.disconnect(physicsClientId=self._robot_client)
            self._robot_client = -1

    def capture(self) -> RgbdFrame:
        """The scene now, with noise; pixels that show the robot carry no depth."""
        frame = self.measured()
        if self._correction is not None:
            frame = self._correction.corrected(frame)
        robot = self.robot_depth()
        # A hole in front of the robot stays a hole; NaN compares False.
        hidden = robot - self.config.mask_slack_m <= frame.depth_m
        return replace(frame, depth_m=np.where(hidden, np.float32(np.nan), frame.depth_m))

    def measured(self) -> RgbdFrame:
        """The scene now, with noise, as it is measured: the robot in it, and no correction."""
        surface, exact = self._exact()
        depth = self._errors.measured_depth(self._sensor.depth(exact, surface))
        stamp_s = self._world.time_s
        return RgbdFrame(
            stamp_s=stamp_s,
            rgb=self._sensor.rgb(surface, stamp_s),
            depth_m=depth.astype(np.float32),
            camera=self.intrinsics,
            T_world_cam=self.T_world_cam,
        )

    def correct_depth(self, correction: DepthCorrection) -> None:
        """From now on, what is captured is corrected so."""
        self._correction = correction

    def exact(self) -> tuple[NDArray[np.uint8], DepthImage]:
        """RGB (H, W, 3) and depth (H, W) before noise and masking."""
        surface, depth = self._exact()
        return surface.rgb, depth

    def shown(self, body: int, link: int) -> NDArray[np.bool_]:
        """(H, W) which pixels show a link of one of the world's bodies. For scoring alone."""
        self._follow()
        picture = self._scene.draw(poses_of(self._world.client, self._shapes), self._shot)
        wanted = np.array([*((s.body, s.link) == (body, link) for s in self._shapes), False])
        _, still_depth = self._still
        return np.asarray(wanted[picture.body] & ~(still_depth <= picture.depth_m))

    def _exact(self) -> tuple[Surface, DepthImage]:
        """What each pixel shows and how far away.

        Only what moves is drawn: what stands still was drawn once.
        """
        self._follow()
        poses = poses_of(self._world.client, self._shapes)
        picture = self._scene.draw(poses, self._shot)
        rgb, depth = picture.rgb, picture.depth_m
        specular = self._specular.take(picture.body, mode="wrap")
        still, still_depth = self._still
        # Nothing moves behind what is not there: NaN in `still_depth` compares False.
        behind = ~np.isfinite(depth) | (still_depth <= depth)
        mask = behind.view(np.uint8)
        cv2.copyTo(still.rgb, mask, rgb)  # ten times as fast as indexing
        cv2.copyTo(still_depth, mask, depth)
        cv2.copyTo(still.specular, mask, specular)
        return Surface(rgb, specular), depth

    def _follow(self) -> None:
        """Shows the bodies that the world has now."""
        bodies = bodies_of(self._world.client)
        if bodies != self._bodies:
            self._bodies, self._shapes = bodies, shapes_of(self._world.client, bodies)
            self._specular = _specular_of(self._shapes)
            self._scene.show(self._shapes)

    def _draw_still(self) -> tuple[Surface, DepthImage]:
        """What never moves: room, supports and corpus."""
        client = connect()
        try:
            bodies = [load_urdf(client, urdf, T) for urdf, T in self._world.still]
            shapes = shapes_of(client, bodies)
            self._scene.show(shapes)
            picture: Picture = self._scene.draw(poses_of(client, shapes), self._shot)
        finally:
            p.disconnect(physicsClientId=client)
        specular = _specular_of(shapes).take(picture.body, mode="wrap")
        return Surface(picture.rgb, specular), picture.depth_m

    def robot_depth(self) -> DepthImage:
        """Depth (H, W) of the robot alone at its measured joint angles, grown; NaN elsewhere."""
        world = self._world
        n = p.getNumJoints(world.robot_id, physicsClientId=world.client)
        states = p.getJointStates(world.robot_id, list(range(n)), physicsClientId=world.client)
        measured = np.array([state[0] for state in states])
        measured[:N_ARM] += self._offsets_rad
        for j, angle in enumerate(measured.tolist()):
            p.resetJointState(self._robot, j, angle, physicsClientId=self._robot_client)
        scale = self.config.mask_scale
        believed = replace(self.config, focal_px=self._errors.believed_px(self.config.focal_px))
        small = take(self._robot_client, believed.shot(self.T_world_cam, scale=scale)).depth_m
        side = 2 * int(np.ceil(self.config.mask_grow_px / scale)) + 1
        solid = np.where(np.isfinite(small), small, np.inf).astype(np.float32)
        grown = cv2.erode(solid, np.ones((side, side), dtype=np.uint8))
        full = np.repeat(np.repeat(grown, scale, axis=0), scale, axis=1)
        return np.where(np.isfinite(full), full, np.nan)
