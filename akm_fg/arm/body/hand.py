"""The hand alone, its fingers open, against voxels that something is in."""

from __future__ import annotations

import functools

import coal
import numpy as np
import pinocchio as pin

from akm_fg.arm.body.collision import hull_parts
from akm_fg.arm.body.description import ArmDescription, franka_description
from akm_fg.arm.body.model import FINGERS, HAND
from akm_fg.records import FloatArray

FINGERS_OPEN_M = 0.04  # travel of either finger


class HandCollisions:
    """Whether the open hand at a pose touches any of some voxels."""

    def __init__(
        self, p_world: FloatArray, voxel_m: float, description: ArmDescription | None = None
    ) -> None:
        """Takes the middles (N, 3) of the voxels that something is in; without any, all is free.

        Raises:
            MissingDependency: no description is given, and none is installed.
            InputError: the description cannot be read.
        """
        self._parts = _parts(description or franka_description())
        self._octree = None
        if len(p_world):
            self._octree = coal.makeOctree(np.ascontiguousarray(p_world, dtype=float), voxel_m)
        self._request = coal.CollisionRequest()
        self._identity = coal.Transform3s()

    def free(self, T_world_grasp: FloatArray) -> bool:
        """Whether hand and fingers touch nothing at a gripper's pose (4, 4)."""
        if self._octree is None:
            return True
        for hull, T_gripper_hull in self._parts:
            T = T_world_grasp @ T_gripper_hull
            result = coal.CollisionResult()
            placed = coal.Transform3s(T[:3, :3], T[:3, 3])
            if coal.collide(hull, placed, self._octree, self._identity, self._request, result):
                return False
        return True


@functools.cache
def _parts(
    description: ArmDescription,
) -> tuple[tuple[coal.CollisionGeometry, FloatArray], ...]:
    """Hulls of hand and fingers with their T_gripper_hull (4, 4)."""
    model, hulls = hull_parts(description)
    data, places = model.createData(), hulls.createData()
    q = np.full(model.nq, FINGERS_OPEN_M)
    pin.updateGeometryPlacements(model, data, hulls, places, q)
    pin.updateFramePlacements(model, data)
    T_gripper_world = data.oMf[model.getFrameId(description.gripper_frame)].inverse()
    return tuple(
        (shape.geometry, (T_gripper_world * places.oMg[i]).homogeneous)
        for i, shape in enumerate(hulls.geometryObjects)
        if shape.name in (HAND, *FINGERS)
    )
