"""Whether the arm touches itself or what stands around it, by coal on convex parts.

The arm's parts are the convex hulls of the URDF's collision meshes, which is also how PyBullet
takes them. Obstacles may be any geometry of coal, in the world frame. All knowledge of the scene
comes in through `Obstacle`: from a camera frame (`akm_fg.arm.motion.obstacle_map`) or, for tests
alone, from the simulator's truth (`sim.robot.true_obstacles`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import coal
import gtsam
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from akm_fg.arm.body.description import ArmDescription, franka_description
from akm_fg.arm.body.model import N_ARM, ROBOT_LINKS, read_meshes, read_model
from akm_fg.records import BoolArray, FloatArray

# The pairs of parts that can meet within the joint limits, by place in ROBOT_LINKS; no others do
# (a test looks for them). Folded back, wrist and hand can reach the base, the shoulder and link 2;
# link 5's long body can meet flange, hand and fingers.
SELF_PAIRS = (
    *((first, second) for first in (0, 1, 2) for second in range(5, len(ROBOT_LINKS))),
    *((5, second) for second in range(7, len(ROBOT_LINKS))),
)
# No point of the arm, stretched and with open fingers, lies farther than this from each joint's
# axis, m (measured on the hulls, rounded up): bounds how far a point moves when the joint turns.
REACH_OF_JOINT_M = np.array([1.0, 1.0, 0.78, 0.70, 0.30, 0.30, 0.12])


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Something that the arm must not touch."""

    name: str  # as a person would say it: "the floor"
    geometry: coal.CollisionGeometry
    T_world_obstacle: gtsam.Pose3
    spared: tuple[str, ...] = ()  # links that may touch it


class ArmCollisions:
    """The arm, its fingers open, among obstacles. Keeps no reference to a simulator."""

    def __init__(
        self,
        obstacles: Sequence[Obstacle],
        margin_m: float,
        fingers_m: float = 0.04,
        description: ArmDescription | None = None,
    ) -> None:
        """Takes the arm's hulls and the obstacles together.

        Args:
            obstacles: what is around; the base is never checked, it does not move.
            margin_m: that the arm keeps from obstacles; from itself it keeps none.
            fingers_m: travel of either finger.
            description: of the arm; without one, the Franka of the installed PyBullet's data.

        Raises:
            MissingDependency: no description is given, and none is installed.
            InputError: the description cannot be read.
        """
        self._model, hulls = hull_parts(description or franka_description())
        self._data = self._model.createData()
        self._geometry = hulls.copy()
        n_robot = self._geometry.ngeoms
        for obstacle in obstacles:
            self._add(obstacle, n_robot)
        self._contacts = self._geometry.createData()
        pairs = self._geometry.collisionPairs
        self._with_obstacle = [i for i, pair in enumerate(pairs) if pair.second >= n_robot]
        self._q = np.full(self._model.nq, fingers_m)
        self.set_margin(margin_m)

    def _add(self, obstacle: Obstacle, n_robot: int) -> None:
        placement = pin.SE3(obstacle.T_world_obstacle.matrix())
        shape = pin.GeometryObject(obstacle.name, 0, 0, placement, obstacle.geometry)
        index = self._geometry.addGeometryObject(shape)
        for link in range(1, n_robot):
            if ROBOT_LINKS[link] not in obstacle.spared:
                self._geometry.addCollisionPair(pin.CollisionPair(link, index))

    def set_margin(self, margin_m: float) -> None:
        """Changes the distance that the arm keeps from obstacles."""
        self.margin_m = margin_m
        for i in self._with_obstacle:
            self._contacts.collisionRequests[i].security_margin = margin_m

    def free(self, q: FloatArray) -> bool:
        """Whether the arm at joint angles (7,) touches nothing, not even by the margin."""
        self._q[:N_ARM] = q
        return not pin.computeCollisions(
            self._model, self._data, self._geometry, self._contacts, self._q, True
        )

    def touched(self, q: FloatArray) -> str | None:
        """What is in the way at joint angles (7,): `panda_link5 and the floor`, or None."""
        if self.free(q):
            return None
        results = self._contacts.collisionResults
        for pair, result in zip(self._geometry.collisionPairs, results, strict=True):
            if result.isCollision():
                names = (self._geometry.geometryObjects[i].name for i in (pair.first, pair.second))
                return " and ".join(names)
        raise AssertionError("coal reported a contact and has none")

    def free_along(self, q: FloatArray, step_m: float) -> bool:
        """Whether the arm is free along a sampled path of joint angles (N, 7).

        Samples are skipped or added so that no point of the arm moves by more than `step_m`
        between two that are checked.
        """
        return all(self.free(x) for x in resampled(q, step_m))


def resampled(q: FloatArray, step_m: float) -> FloatArray:
    """Joint angles (M, 7) along the polyline (N, 7), no point of the arm farther apart than step_m.

    How far a point moves is bounded by the sum over the joints of angle times reach.
    """
    moved = np.abs(np.diff(q, axis=0)) @ REACH_OF_JOINT_M
    way = np.concatenate([[0.0], np.cumsum(moved)])
    count = max(int(np.ceil(way[-1] / step_m)), 1) + 1
    at = np.linspace(0.0, way[-1], count)
    return np.column_stack([np.interp(at, way, q[:, j]) for j in range(q.shape[1])])


def inside_arm(
    p_world: FloatArray,
    q: FloatArray,
    slack_m: float,
    description: ArmDescription | None = None,
) -> BoolArray:
    """(N,) which points (N, 3) lie in the arm at joint angles (7,), or within about `slack_m`.

    The hulls' faces are moved outwards by `slack_m`. The base, which never moves, is left out.
    """
    described = description or franka_description()
    inside = np.zeros(len(p_world), dtype=bool)
    for placement, (corners, faces) in zip(
        _placements(q, described), _solids(described), strict=True
    ):
        lower, upper = corners.min(axis=0), corners.max(axis=0)
        p_link = (p_world - placement.translation) @ placement.rotation
        near = np.all((p_link > lower - slack_m) & (p_link < upper + slack_m), axis=1)
        near = np.flatnonzero(near & ~inside)
        outside_by = p_link[near] @ faces[:, :3].T + faces[:, 3]
        inside[near] = outside_by.max(axis=1, initial=-np.inf) < slack_m
    return inside


def arm_corners(q: FloatArray, description: ArmDescription | None = None) -> list[FloatArray]:
    """The corners (K, 3), world, of the hull of each of the arm's parts at joint angles (7,).

    The base, which never moves, is left out.
    """
    described = description or franka_description()
    return [
        corners @ placement.rotation.T + placement.translation
        for placement, (corners, _) in zip(
            _placements(q, described), _solids(described), strict=True
        )
    ]


def _placements(q: FloatArray, description: ArmDescription) -> list[pin.SE3]:
    """Of the hulls at joint angles (7,), fingers open, without the base's; in the world."""
    model, hulls = hull_parts(description)
    data, places = model.createData(), hulls.createData()
    fingers = np.full(model.nq - N_ARM, 0.04)
    pin.updateGeometryPlacements(model, data, hulls, places, np.concatenate([q, fingers]))
    return list(places.oMg)[1:]


@functools.cache
def hull_parts(description: ArmDescription) -> tuple[pin.Model, pin.GeometryModel]:
    """The robot's model and its convex hulls, in the order of ROBOT_LINKS, with self-collisions."""
    model = read_model(description)
    meshes = read_meshes(description, model)
    hulls = pin.GeometryModel()
    for link, shape in zip(ROBOT_LINKS, meshes.geometryObjects, strict=True):
        shape.geometry.buildConvexHull(True, "Qt")
        hulls.addGeometryObject(
            pin.GeometryObject(link, shape.parentJoint, shape.placement, shape.geometry.convex)
        )
    for first, second in SELF_PAIRS:
        hulls.addCollisionPair(pin.CollisionPair(first, second))
    return model, hulls


@functools.cache
def _solids(description: ArmDescription) -> list[tuple[FloatArray, FloatArray]]:
    """Of each hull but the base's: corners (K, 3) and faces (F, 4), normal and offset."""
    result = []
    for shape in list(hull_parts(description)[1].geometryObjects)[1:]:
        corners = np.array([shape.geometry.point(i) for i in range(shape.geometry.num_points)])
        result.append((corners, ConvexHull(corners).equations))
    return result
