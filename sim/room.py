"""The room around an object: floor, wall, and what lifts object or robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import gtsam
import numpy as np

from akm_fg.records import FloatArray
from sim.bullet import p, quaternion_xyzw
from sim.objects.meshes import Box, write_textured_boxes
from sim.objects.placement import Placement
from sim.objects.textures import Rgb, floor, plaster

ROOM_CELL_M = 1.5  # side of a cell of floor and walls
ROOM_URDF = (
    '<robot name="{name}"><link name="{name}"><inertial><mass value="0"/>'
    '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
    '<visual><geometry><mesh filename="{name}.obj"/></geometry></visual></link></robot>'
)


def add_room(
    client: int, placement: Placement, size_m: FloatArray, seed: int, folder: Path
) -> list[tuple[Path, gtsam.Pose3]]:
    """A floor, a wall a hand's breadth behind the object, and what lifts object or robot.

    Args:
        client: where to.
        placement: of the object.
        size_m: (3,) of the object.
        seed: of the looks.
        folder: where the looks are written.

    Returns:
        The looks of all that, a URDF and its pose each.
    """
    rng = np.random.default_rng([seed, 9])
    T, (width, depth, _) = placement.T_world_object, size_m
    ground, plinth = placement.floor_m, placement.plinth_m
    images = [floor(rng), plaster(rng)]
    upright = gtsam.Pose3(gtsam.Rot3.Ry(-placement.roll_rad), np.zeros(3))
    behind = upright * _above(2.0 - plinth, y=depth / 2 + 0.1)
    room = _Room(client, folder)
    room.add("floor", images[0], [16.0, 16.0, 0.05], _above(ground - 0.025), [4])
    room.add("wall", images[1], [16.0, 0.05, 4.0], T * behind, [3])
    if plinth <= 0.0 <= ground:
        return room.looks
    grey = np.asarray(0.55 * plaster(rng), dtype=np.uint8)
    if plinth > 0.0:
        size, T_plinth = [width, 0.9 * depth, plinth], T * _above(-plinth / 2.0)
        room.add("plinth", grey, size, T_plinth, range(6))
    if ground < 0.0:  # the robot's flange is 0.2 m long
        T_pedestal = _above(ground / 2.0, x=-0.05)
        room.add("pedestal", grey, [0.3, 0.3, -ground], T_pedestal, range(6))
    return room.looks


def _above(z: float, x: float = 0.0, y: float = 0.0) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(), np.array([x, y, z]))


@dataclass(frozen=True, slots=True)
class _Room:
    """Boxes that never move.

    In the world they are collision shapes alone; their looks are drawn once, by the camera, from
    the files written here.
    """

    client: int
    folder: Path
    looks: list[tuple[Path, gtsam.Pose3]] = field(default_factory=list)

    def add(
        self,
        name: str,
        image: Rgb,
        size_m: Sequence[float],
        T_world_box: gtsam.Pose3,
        sides: Sequence[int],
    ) -> None:
        """Puts a box there and writes those of its sides that can be seen."""
        where = {"physicsClientId": self.client}
        cv2.imwrite(str(self.folder / f"{name}.png"), image[..., ::-1])
        box = Box(name, np.array(size_m), gtsam.Pose3(), name)
        path = self.folder / f"{name}.obj"
        write_textured_boxes(path, [box], f"{name}.png", split_m=ROOM_CELL_M, sides=sides)
        half = (np.array(size_m) / 2.0).tolist()
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, **where)
        # Without a visual shape the collision shape would be drawn: give it a speck inside.
        speck = p.createVisualShape(p.GEOM_BOX, halfExtents=[1e-4] * 3, **where)
        at = T_world_box.translation().tolist(), quaternion_xyzw(T_world_box.rotation())
        p.createMultiBody(0.0, shape, speck, *at, **where)
        urdf = path.with_suffix(".urdf")
        urdf.write_text(ROOM_URDF.format(name=name), encoding="utf-8")
        self.looks.append((urdf, T_world_box))
