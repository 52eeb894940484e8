"""First looks at objects as exploration has them, with what they show: for training and scoring.

An object stands where the paper's ranges put it, the arm is turned aside, the fixed camera looks.
Which pixels show a handle, free or locked, is read off the drawn meshes. Then the free part's grip
is pulled, by a force and without an arm, the way that it moves: whether that opens it is noted.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import Q_HOME
from akm_fg.errors import InputError
from akm_fg.io.arrays.npz import load_arrays
from akm_fg.perception.depth.object_mask import DepthObjectSegmenter
from akm_fg.records import BoolArray, FloatArray, JointTruth, PinholeCamera, RgbdFrame
from sim.bullet import connect, load_urdf, p
from sim.camera.mirror import Shape, bodies_of, poses_of, shapes_of
from sim.camera.rendering import open_scene
from sim.episode import SimEpisode, open_world
from sim.objects.placement import opened
from sim.truth import true_handles
from sim.world import SimWorld

ASIDE_RAD = -0.5 * np.pi  # of the arm's first axis: away from the side on which the camera stands
PULL_N = 60.0  # what a hand may pull with; opens catches and closers
PULL_S = 2.0
ENOUGH = {"prismatic": 0.05, "revolute": float(np.deg2rad(5.0))}  # the paper's ESR_5
HANDLE = "handle"  # in the names of the meshes that are handles
EDGE_M = 0.03  # around the grip of a front that has its board's edge for a handle
ARRAYS = (
    "rgb", "depth_m", "camera", "t_world_cam", "mask", "handles",
    "contact_world", "direction_world", "normal_world", "kind", "family", "opened",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class FirstLook:
    """A closed object as it is first seen, and the truth about it."""

    name: str
    family: str
    kind: str
    frame: RgbdFrame
    mask: BoolArray  # (H, W) as the default segmenter finds the object
    handles: BoolArray  # (H, W) pixels that show a handle, or the free front's grip
    contact_world: FloatArray  # (3,) m, the free part's grip
    direction_world: FloatArray  # (3,) unit, in which it begins to move
    normal_world: FloatArray  # (3,) unit, out of its front
    opened: bool  # by a pull at the contact, along the direction

    @property
    def contact_uv(self) -> FloatArray:
        """(2,) pixel of the contact, seen or not."""
        p_cam = self.frame.T_world_cam.transformTo(self.contact_world)
        return self.frame.camera.project(p_cam[None])[0]


def first_look(name: str, seed: int) -> FirstLook:
    """A look at the object SUITE/NAME as met with `seed`.

    Raises:
        TracksLost: the default segmenter finds no object.
    """
    with open_world(name, seed, placement="published") as episode:
        world = episode.world
        p.resetJointState(
            world.robot_id, 0, float(Q_HOME[0] + ASIDE_RAD), physicsClientId=world.client
        )
        frame = episode.camera.capture()
        T_world_object = world.placement.T_world_object
        contact = T_world_object.transformFrom(world.built.T_object_handle.translation())
        direction = first_motion(world.truth(), contact)
        return FirstLook(
            name=name,
            family=str(getattr(world.spec, "family", "")),
            kind=world.spec.kind,
            frame=frame,
            mask=DepthObjectSegmenter().segment(frame),
            handles=_handles(episode, frame) & np.isfinite(frame.depth_m),
            contact_world=contact,
            direction_world=direction,
            normal_world=episode.pull_direction_world,
            opened=_pulled_open(world, contact),
        )


def _pulled_open(world: SimWorld, contact_world: FloatArray) -> bool:
    """Whether a force at the contact, always the way that it can move, opens the part."""
    T, enough = world.placement.T_world_object, ENOUGH[world.spec.kind]
    for _ in range(round(PULL_S / world.config.step_s)):
        T_world_moved = T * opened(world.built, world.part_state()) * T.inverse()
        at = T_world_moved.transformFrom(contact_world)
        force = PULL_N * first_motion(world.truth(), at)
        p.applyExternalForce(
            world.object_id,
            world.part_joint,
            force.tolist(),
            at.tolist(),
            p.WORLD_FRAME,
            physicsClientId=world.client,
        )
        world.step()
        if world.part_state() > enough:
            return True
    return False


def first_motion(truth: JointTruth, contact_world: FloatArray) -> FloatArray:
    """(3,) unit: which way a point of the part sets out."""
    if truth.pivot is None:
        return truth.axis / np.linalg.norm(truth.axis)
    way = np.cross(truth.axis, contact_world - truth.pivot)
    return np.asarray(way / np.linalg.norm(way))


def _handles(episode: SimEpisode, frame: RgbdFrame) -> BoolArray:
    """(H, W) pixels that show a handle's mesh, or what lies around the grips of edges."""
    world, camera = episode.world, episode.camera
    with _everything(episode) as (shapes, poses):
        scene = open_scene(camera.renderer)
        try:
            scene.show(shapes)
            picture = scene.draw(
                poses, camera.config.shot(camera.T_world_cam, camera.renderer.name)
            )
        finally:
            scene.close()
    is_handle = np.array([HANDLE in Path(shape.mesh).stem for shape in shapes] + [False])
    shown = is_handle[picture.body]
    if getattr(getattr(world.spec, "handle", None), "style", None) != "edge":
        return shown
    v, u = np.mgrid[: frame.camera.height, : frame.camera.width].astype(float)
    depth = np.asarray(picture.depth_m, dtype=float)
    p_cam = frame.camera.back_project(np.stack([u, v], axis=-1), depth)
    for handle in true_handles(world):
        away = np.linalg.norm(p_cam - frame.T_world_cam.transformTo(handle.p_world), axis=-1)
        shown |= away < EDGE_M
    return shown


@contextmanager
def _everything(episode: SimEpisode) -> Iterator[tuple[list[Shape], list]]:
    """All shapes of a world, moving and still, and where they are."""
    world = episode.world
    moving = shapes_of(world.client, bodies_of(world.client))
    poses = poses_of(world.client, moving)
    client = connect()
    try:
        still = shapes_of(client, [load_urdf(client, urdf, T) for urdf, T in world.still])
        yield moving + still, poses + poses_of(client, still)
    finally:
        p.disconnect(physicsClientId=client)


def write_look(path: Path, look: FirstLook) -> None:
    """Keep a look, whole or not at all."""
    camera = look.frame.camera
    part = path.with_suffix(".part.npz")
    np.savez_compressed(
        part,
        rgb=look.frame.rgb,
        depth_m=look.frame.depth_m,
        camera=np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        t_world_cam=look.frame.T_world_cam.matrix(),
        mask=look.mask,
        handles=look.handles,
        contact_world=look.contact_world,
        direction_world=look.direction_world,
        normal_world=look.normal_world,
        kind=look.kind,
        family=look.family,
        opened=look.opened,
    )
    part.rename(path)


def read_look(path: Path, name: str) -> FirstLook:
    """A look that was kept.

    Raises:
        InputError: it is damaged.
    """
    found = load_arrays(path, ARRAYS, "a first look")
    absent = [name for name in ARRAYS if name not in found]
    if absent:
        raise InputError(path, f"holds no {', '.join(absent)}", "a first look")
    height, width = found["mask"].shape
    camera = PinholeCamera(width, height, *found["camera"].tolist())
    T_world_cam = gtsam.Pose3(found["t_world_cam"])
    frame = RgbdFrame(0.0, found["rgb"], found["depth_m"], camera, T_world_cam)
    return FirstLook(
        name=name,
        family=str(found["family"]),
        kind=str(found["kind"]),
        frame=frame,
        mask=found["mask"],
        handles=found["handles"],
        contact_world=found["contact_world"],
        direction_world=found["direction_world"],
        normal_world=found["normal_world"],
        opened=bool(found["opened"]),
    )
