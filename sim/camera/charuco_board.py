"""A ChArUco board in the robot's hand, and the poses in which it is shown to the camera.

The board is a stiff plate whose lower edge is clamped between the fingertips. Board frame, as in
OpenCV: origin in the upper left corner of the printed pattern, x right, y down, z into the plate.
The estimator is given what a real robot gives: images, and gripper poses that are off by the
arm's repeatability. Where board and camera really are stays in `BoardTruth`, for scoring.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.arm.body.model import N_ARM
from akm_fg.errors import MotionInfeasible
from akm_fg.records import FloatArray, PinholeCamera, RgbdFrame
from sim.bullet import joint_index, load_urdf, p, quaternion_xyzw
from sim.camera.camera import CameraConfig, SimCamera
from sim.camera.charuco_plate import PlateSpec, write_plate
from sim.camera.noise import NOISE_LEVELS, noisy_depth, noisy_rgb
from sim.camera.pictures import DepthImage
from sim.episode import open_world
from sim.robot.contacts import finger_links, nearby
from sim.world import SimWorld

FARTHEST_M = 1e6  # stands for infinity
SHOULDER_M = np.array([0.0, 0.0, 0.333])  # of the Franka, world


@dataclass(frozen=True, slots=True)
class PoseConfig:
    """How the board is shown, and how well the arm knows where it holds it."""

    views: int = 25
    distance_m: tuple[float, float] = (0.5, 1.2)  # of the board's middle, along camera z
    least_height_m: float = 0.2  # of the board's middle above the robot's foot
    reach_m: float = 0.85  # from the shoulder to the board's middle; Franka's data sheet: 0.855
    tilt_rad: float = np.deg2rad(45.0)  # largest angle between normal and line of sight
    roll_rad: float = np.deg2rad(60.0)  # largest turn about the line of sight
    border_px: float = 12.0  # kept between the pattern and the image's edge
    clearance_m: float = 0.01  # of plate and arm to the furniture
    tries: int = 20000
    repeat_mm: float = 0.1  # sd along each axis; Franka's data sheet: repeatability +-0.1 mm
    repeat_deg: float = 0.05  # sd about each axis
    mount_mm: float = 4.0  # sd of where the plate sits in the fingers
    mount_deg: float = 3.0
    supersample: int = 4  # drawn this many times larger and averaged: corners err by 0.07 px rms
    # (0.12 px at 2, most of it in rows and columns of pixels that run along the squares' edges)


@dataclass(frozen=True, slots=True)
class BoardTruth:
    """What the calibration should find. For scoring alone."""

    camera: PinholeCamera
    T_world_cam: gtsam.Pose3
    T_gripper_board: gtsam.Pose3


@dataclass(frozen=True, slots=True)
class BoardShot:
    """One image of the board and what the arm says of its pose."""

    frame: RgbdFrame  # its camera and T_world_cam are the true ones: replace before use
    T_world_gripper: gtsam.Pose3  # reported


def held_board(spec: PlateSpec, config: PoseConfig, rng: np.random.Generator) -> gtsam.Pose3:
    """T_gripper_board: upright in the hand, its face along gripper y, somewhat askew."""
    R = np.column_stack([[-1.0, 0, 0], [0, 0, -1.0], [0, -1.0, 0]])
    width, height = spec.size_m
    origin = np.array([width / 2.0, spec.thickness_m / 2.0, spec.margin_m + height])
    turn = gtsam.Rot3.Expmap(np.deg2rad(config.mount_deg) * rng.normal(size=3))
    return gtsam.Pose3(gtsam.Rot3(R) * turn, origin + 1e-3 * config.mount_mm * rng.normal(size=3))


class BoardCamera:
    """The fixed camera, drawn larger and averaged, because TinyRenderer does not smooth edges."""

    def __init__(
        self, world: SimWorld, T_world_cam: gtsam.Pose3, seed: int, config: CameraConfig, scale: int
    ) -> None:
        self._fine = SimCamera(world, T_world_cam, seed, config.scaled(scale))
        self._scale, self._noise, self._world = scale, config.noise, world
        self._slack_m = config.mask_slack_m
        self._rng = np.random.default_rng([seed, 23])
        fine = self._fine.intrinsics
        # A pixel covers scale x scale finer ones: its centre is theirs.
        cx, cy = ((c - (scale - 1) / 2.0) / scale for c in (fine.cx, fine.cy))
        self.intrinsics = PinholeCamera(
            fine.width // scale, fine.height // scale, fine.fx / scale, fine.fy / scale, cx, cy
        )

    def close(self) -> None:
        """Frees the camera underneath."""
        self._fine.close()

    def capture(self) -> RgbdFrame:
        """The scene now, with noise; pixels that show the robot carry no depth."""
        rgb, fine_depth = self._fine.exact()
        size = (self.intrinsics.width, self.intrinsics.height)
        small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        depth = noisy_depth(self._averaged(fine_depth), self.intrinsics, self._noise, self._rng)
        robot = self._averaged(self._fine.robot_depth())
        depth[np.isfinite(robot) & ~(depth < robot - self._slack_m)] = np.nan
        return RgbdFrame(
            stamp_s=self._world.time_s,
            rgb=noisy_rgb(small, self._noise, self._rng),
            depth_m=depth.astype(np.float32),
            camera=self.intrinsics,
            T_world_cam=self._fine.T_world_cam,
        )

    def _averaged(self, fine_depth: DepthImage) -> DepthImage:
        """Depth (H, W) whose inverse is the mean of the finer ones': exact on planes."""
        h, w, s = self.intrinsics.height, self.intrinsics.width, self._scale
        inverse = (1.0 / fine_depth).reshape(h, s, w, s).mean(axis=(1, 3))
        return np.asarray(1.0 / np.maximum(inverse, 1.0 / FARTHEST_M))


class BoardRig:
    """A world with the board in the robot's hand. Poses are set, not driven to."""

    def __init__(
        self, world: SimWorld, camera: BoardCamera, plate: Path, truth: BoardTruth, spec: PlateSpec
    ) -> None:
        self.world, self.camera, self.truth = world, camera, truth
        self.spec = spec
        self._plate = load_urdf(world.client, plate, gtsam.Pose3())
        self._fingers = finger_links(world.client, world.robot_id)
        hand = joint_index(world.client, world.robot_id, "panda_hand_joint")
        self._arm_links = range(-1, hand)

    def put(self, q: FloatArray) -> None:
        """Set the arm to joint angles (7,), the fingers closed on the plate's rim."""
        client, robot = self.world.client, self.world.robot_id
        for joint in range(N_ARM):
            p.resetJointState(robot, joint, q[joint], physicsClientId=client)
        for finger in self._fingers:
            p.resetJointState(robot, finger, self.spec.thickness_m / 2.0, physicsClientId=client)
        T = self.world.kinematics.T_world_gripper(q) * self.truth.T_gripper_board
        p.resetBasePositionAndOrientation(
            self._plate,
            T.translation().tolist(),
            quaternion_xyzw(T.rotation()),
            physicsClientId=client,
        )

    def is_free(self, clearance_m: float) -> bool:
        """Whether plate and arm keep clear of the furniture, and the plate of the arm."""
        world = self.world

        def near(a: int, b: int, link: int | None = None) -> bool:
            return bool(nearby(world.client, a, b, clearance_m, other_link=link))

        if near(self._plate, world.object_id) or near(world.robot_id, world.object_id):
            return False
        return not any(near(self._plate, world.robot_id, link) for link in self._arm_links)

    def in_view(self, q: FloatArray, border_px: float) -> bool:
        """Whether the whole pattern lies inside the image."""
        T_cam_board = (
            self.truth.T_world_cam.inverse()
            * self.world.kinematics.T_world_gripper(q)
            * self.truth.T_gripper_board
        )
        width, height = self.spec.size_m
        rim = np.array([[0, 0, 0], [width, 0, 0], [0, height, 0], [width, height, 0]])
        camera = self.camera.intrinsics
        uv = camera.project(np.array([T_cam_board.transformFrom(x) for x in rim]))
        high = np.array([camera.width, camera.height]) - 1.0 - border_px
        return bool((uv >= border_px).all() and (uv <= high).all())


def sample_configurations(
    rig: BoardRig, config: PoseConfig, rng: np.random.Generator
) -> Iterator[FloatArray]:
    """Joint angles (7,) that show the whole board to the camera and touch nothing.

    Raises:
        MotionInfeasible: too few are found.
    """
    found = 0
    centre = gtsam.Pose3(gtsam.Rot3(), -np.append(rig.spec.size_m / 2.0, 0.0))
    for _ in range(config.tries):
        if found == config.views:
            return
        T_world_board = _shown(rig, config, rng)
        if T_world_board is None:
            continue
        wanted = T_world_board * centre * rig.truth.T_gripper_board.inverse()
        q = rig.world.kinematics.solve(wanted, Q_HOME)
        if q is None or not rig.in_view(q, config.border_px):
            continue
        rig.put(q)
        if rig.is_free(config.clearance_m):
            found += 1
            yield q
    if found < config.views:
        raise MotionInfeasible(
            f"only {found} of {config.views} poses show the board to the camera within reach"
        )


def _shown(rig: BoardRig, config: PoseConfig, rng: np.random.Generator) -> gtsam.Pose3 | None:
    """A pose of the board's middle: anywhere in the image, its face roughly to the camera.

    None where the arm does not reach.
    """
    camera, T_world_cam = rig.camera.intrinsics, rig.truth.T_world_cam
    uv = rng.uniform([0.0, 0.0], [camera.width, camera.height])
    p_cam = camera.back_project(uv, np.asarray(rng.uniform(*config.distance_m)))
    middle = T_world_cam.transformFrom(p_cam)
    if np.linalg.norm(middle - SHOULDER_M) > config.reach_m or middle[2] < config.least_height_m:
        return None
    z = middle - T_world_cam.translation()
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, -1.0])
    x /= np.linalg.norm(x)
    facing = gtsam.Rot3(np.column_stack([x, np.cross(z, x), z]))
    about = rng.uniform(0.0, 2.0 * np.pi)
    tilt = rng.uniform(0.0, config.tilt_rad) * np.array([np.cos(about), np.sin(about), 0.0])
    roll = gtsam.Rot3.Rz(rng.uniform(-config.roll_rad, config.roll_rad))
    return gtsam.Pose3(facing * gtsam.Rot3.Expmap(tilt) * roll, middle)


def reported(
    T_world_gripper: gtsam.Pose3, config: PoseConfig, rng: np.random.Generator
) -> gtsam.Pose3:
    """What the arm says of a pose: off by its repeatability."""
    turn = np.deg2rad(config.repeat_deg) * rng.normal(size=3)
    shift = 1e-3 * config.repeat_mm * rng.normal(size=3)
    return T_world_gripper * gtsam.Pose3(gtsam.Rot3.Expmap(turn), shift)


@contextmanager
def open_board_rig(
    object_name: str,
    seed: int = 0,
    noise: str = "d455",
    spec: PlateSpec | None = None,
    config: PoseConfig | None = None,
) -> Iterator[BoardRig]:
    """The world of one object, seen by its camera, with the board in the robot's hand.

    Args:
        object_name: as `open_world`.
        seed: of the world, of how the plate sits in the hand, and of the noise.
        noise: `clean`, `d455` or `harsh`.
        spec: the board.
        config: the plate's seat and the camera's supersampling.

    Raises:
        ValueError: no such object or noise level.
        InputError: no such suite, or no such object in it.
    """
    spec, config = spec or PlateSpec(), config or PoseConfig()
    with open_world(object_name, seed, noise) as episode, TemporaryDirectory() as folder:
        T_world_cam = episode.camera.T_world_cam
        settings = replace(CameraConfig(), noise=NOISE_LEVELS[noise])
        camera = BoardCamera(episode.world, T_world_cam, seed, settings, config.supersample)
        T_gripper_board = held_board(spec, config, np.random.default_rng([seed, 29]))
        truth = BoardTruth(camera.intrinsics, T_world_cam, T_gripper_board)
        try:
            yield BoardRig(episode.world, camera, write_plate(spec, Path(folder)), truth, spec)
        finally:
            camera.close()


def board_shots(
    rig: BoardRig, seed: int = 0, config: PoseConfig | None = None
) -> Iterator[BoardShot]:
    """Show the board in one pose after another and take an image of each.

    Raises:
        MotionInfeasible: too few poses show the board.
    """
    config = config or PoseConfig()
    rng = np.random.default_rng([seed, 31])
    for index, q in enumerate(sample_configurations(rig, config, rng)):
        frame = replace(rig.camera.capture(), stamp_s=float(index))
        exact = rig.world.kinematics.T_world_gripper(q)
        yield BoardShot(frame, reported(exact, config, rng))
