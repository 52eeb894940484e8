"""A scene of shapes alone, drawn beside the physics and moved as the physics moves them.

Rendering has a client of its own. So a renderer can be loaded before the first body (the EGL
plugin sees no body that was there before it), the pictures show the present poses (the physics
client draws those of the step before), and each shape is a body of its own, so that a pixel tells
its material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sim.bullet import connect, p, quiet
from sim.camera.pictures import Picture, Renderer, Shot, take

# The EGL plugin draws a new scene without its shadows this many times.
WARM_UP = {"tiny": 0, "egl": 2}

Vector = tuple[float, ...]
Placed = tuple[Vector, Vector]  # position, quaternion xyzw


@dataclass(frozen=True, slots=True)
class Shape:
    """What is seen of a link of a body; plain numbers, so that it can be sent away."""

    body: int
    link: int  # -1 is the base
    geometry: int  # PyBullet's number
    size: Vector  # scale of a mesh; PyBullet's dimensions of anything else
    mesh: str
    T_link_shape: Placed
    rgba: Vector


class Scene(Protocol):
    """Draws shapes where it is told to."""

    renderer: Renderer

    def show(self, shapes: Sequence[Shape]) -> None:
        """Shows these shapes, and nothing else, from now on."""

    def draw(self, poses: Sequence[Placed], shot: Shot) -> Picture:
        """The shapes at `poses` in the world; the picture's bodies count them from 0."""

    def close(self) -> None:
        """Frees the renderer."""


def shapes_of(client: int, bodies: Sequence[int]) -> list[Shape]:
    """Every shape that is seen of the bodies of a client."""
    found = []
    for body in bodies:
        for data in p.getVisualShapeData(body, physicsClientId=client):
            _, link, geometry, size, mesh, position, quaternion, rgba = data[:8]
            T = (tuple(position), tuple(quaternion))
            name = mesh.decode()
            found.append(Shape(body, link, geometry, tuple(size), name, T, tuple(rgba)))
    return found


def bodies_of(client: int) -> tuple[int, ...]:
    """Ids of the bodies of a client."""
    n = p.getNumBodies(physicsClientId=client)
    return tuple(p.getBodyUniqueId(i, physicsClientId=client) for i in range(n))


def poses_of(client: int, shapes: Sequence[Shape]) -> list[Placed]:
    """Where the shapes are now in the client's world, by its present joint states."""
    links: dict[tuple[int, int], Placed] = {}
    for shape in shapes:
        key = (shape.body, shape.link)
        if key not in links:
            links[key] = _link_pose(client, *key)
    return [
        p.multiplyTransforms(*links[shape.body, shape.link], *shape.T_link_shape)
        for shape in shapes
    ]


def _link_pose(client: int, body: int, link: int) -> Placed:
    if link >= 0:
        state = p.getLinkState(body, link, computeForwardKinematics=True, physicsClientId=client)
        return state[4], state[5]
    # PyBullet tells where the base's centre of mass is; shapes hang on its frame.
    T_world_com = p.getBasePositionAndOrientation(body, physicsClientId=client)
    T_base_com = p.getDynamicsInfo(body, -1, physicsClientId=client)[3:5]
    return p.multiplyTransforms(*T_world_com, *p.invertTransform(*T_base_com))


class LocalScene:
    """A scene drawn in this process; see `Scene`."""

    def __init__(self, renderer: Renderer = "tiny", plugin: str | None = None) -> None:
        """Connects; `plugin` is the file of the EGL plugin.

        Raises:
            RuntimeError: the plugin does not load.
        """
        self.renderer: Renderer = renderer
        self._client = connect()
        if plugin is not None:
            loaded = p.loadPlugin(plugin, "_eglRendererPlugin", physicsClientId=self._client)
            if loaded < 0:
                self.close()
                raise RuntimeError("the EGL plugin does not load")
        self._bodies: list[int] = []
        self._warm_up = 0  # pictures to throw away

    def show(self, shapes: Sequence[Shape]) -> None:
        """As `Scene` says."""
        where = {"physicsClientId": self._client}
        for body in self._bodies:
            p.removeBody(body, **where)
        with quiet():
            self._bodies = [
                p.createMultiBody(0.0, -1, self._visual(shape), **where) for shape in shapes
            ]
        self._warm_up = WARM_UP[self.renderer]

    def draw(self, poses: Sequence[Placed], shot: Shot) -> Picture:
        """As `Scene` says."""
        for body, pose in zip(self._bodies, poses, strict=True):
            p.resetBasePositionAndOrientation(body, *pose, physicsClientId=self._client)
        for _ in range(self._warm_up):
            take(self._client, shot, self.renderer)
        self._warm_up = 0
        picture = take(self._client, shot, self.renderer)
        index = np.full(max(self._bodies, default=-1) + 2, -1, dtype=np.int32)
        index[self._bodies] = np.arange(len(self._bodies))
        return Picture(picture.rgb, picture.depth_m, index[picture.body])

    def close(self) -> None:
        """As `Scene` says."""
        if self._client >= 0:
            p.disconnect(physicsClientId=self._client)
            self._client = -1

    def _visual(self, shape: Shape) -> int:
        look = {"rgbaColor": shape.rgba, "physicsClientId": self._client}
        size = shape.size
        if shape.geometry == p.GEOM_MESH:
            look |= {"fileName": shape.mesh, "meshScale": size}
        elif shape.geometry == p.GEOM_BOX:
            look["halfExtents"] = [x / 2.0 for x in size]
        elif shape.geometry == p.GEOM_SPHERE:
            look["radius"] = size[0]
        elif shape.geometry in (p.GEOM_CYLINDER, p.GEOM_CAPSULE):
            look |= {"length": size[0], "radius": size[1]}
        else:
            raise ValueError(f"shape {shape.geometry} of body {shape.body} cannot be drawn")
        return int(p.createVisualShape(shape.geometry, **look))
