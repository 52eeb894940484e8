"""The obstacles as the simulator has them. FOR TESTS AND SCORING ALONE: no part of the program.

What the arm may know of the scene comes from its camera (`akm_fg.arm.motion.obstacle_map`).
"""

from __future__ import annotations

from typing import Any

import coal
import gtsam
import numpy as np

from akm_fg.arm.body.collision import Obstacle
from sim.bullet import p
from sim.world import SimWorld


def true_obstacles(world: SimWorld) -> list[Obstacle]:
    """Every collision shape of the world but the robot's, where it is now.

    Meshes are taken as their convex hulls, as PyBullet takes them.
    """
    client, result = world.client, []
    for k in range(p.getNumBodies(physicsClientId=client)):
        body = p.getBodyUniqueId(k, physicsClientId=client)
        if body == world.robot_id:
            continue
        for link in range(-1, p.getNumJoints(body, physicsClientId=client)):
            T_world_link = _link_pose(client, body, link)
            shapes = p.getCollisionShapeData(body, link, physicsClientId=client)
            for i, shape in enumerate(shapes):
                name = f"body {body} link {link}"
                if shape[2] == p.GEOM_BOX:
                    T_world_box = T_world_link * _pose(shape[5], shape[6])
                    result.append(Obstacle(name, coal.Box(*shape[3]), T_world_box))
                else:
                    result.append(Obstacle(name, _hull(client, body, link, i), T_world_link))
    return result


def _link_pose(client: int, body: int, link: int) -> gtsam.Pose3:
    """Of the link's inertial frame, in which PyBullet gives the shapes."""
    if link < 0:
        return _pose(*p.getBasePositionAndOrientation(body, physicsClientId=client))
    state = p.getLinkState(body, link, computeForwardKinematics=True, physicsClientId=client)
    return _pose(state[0], state[1])


def _pose(position: Any, quaternion_xyzw: Any) -> gtsam.Pose3:
    x, y, z, w = quaternion_xyzw
    return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), np.array(position))


def _hull(client: int, body: int, link: int, index: int) -> coal.CollisionGeometry:
    """Of a mesh, or of a cylinder, which PyBullet keeps as a prism; in the link's frame."""
    _, corners = p.getMeshData(body, link, collisionShapeIndex=index, physicsClientId=client)
    points = np.array(corners, dtype=float)
    cloud = coal.BVHModelOBBRSS()
    cloud.beginModel(0, len(points))
    cloud.addVertices(points)
    cloud.endModel()
    cloud.buildConvexHull(True, "Qt")
    return cloud.convex
