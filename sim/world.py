"""One PyBullet world in DIRECT mode: floor, wall, one cabinet, one Franka."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import cv2
import gtsam
import numpy as np

from akm_fg.records import FloatArray, JointTruth
from sim.bullet import PANDA_URDF, joint_index, load_urdf, p, quaternion_xyzw, quiet
from sim.kinematics import N_ARM, Q_HOME, FrankaKinematics
from sim.meshes import Box, write_textured_boxes
from sim.objects import PartSpec
from sim.staging import find_spec, stage
from sim.textures import floor, plaster
from sim.urdf_files import PART_JOINT


@dataclass(frozen=True, slots=True)
class WorldConfig:
    """Physics and contact."""

    step_s: float = 1e-3  # the rate of Franka's control interface; stiff grasps need it
    gravity_m_s2: float = 9.81
    solver_iterations: int = 60  # friction of a squeezed handle converges by then
    finger_mu: float = 1.0  # rubber pads on metal or lacquer
    finger_spin_m: float = 0.005  # torsional friction, 2/3 mu r of a pad of 8 mm radius


ROOM_CELL_M = 1.5  # side of a cell of the floor and the wall
ROOM_URDF = (
    '<robot name="{name}"><link name="{name}"><inertial><mass value="0"/>'
    '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
    '<visual><geometry><mesh filename="{name}.obj"/></geometry></visual></link></robot>'
)


class SimWorld:
    """The physics of one object and one robot. A context manager; deterministic by seed.

    World frame: the robot's base, z up.
    """

    def __init__(self, object_name: str, seed: int, config: WorldConfig | None = None) -> None:
        self.spec: PartSpec = find_spec(object_name, seed)
        self.config = config or WorldConfig()
        self.kinematics = FrankaKinematics()
        self._steps = 0
        self._entered = False
        self.room: list[tuple[Path, gtsam.Pose3]] = []  # looks of floor and wall

    def __enter__(self) -> SimWorld:
        self._folder = tempfile.TemporaryDirectory(prefix="akm-fg-sim-")
        folder = Path(self._folder.name)
        self.built, self.placement = stage(self.spec, folder, self.kinematics)
        with quiet():
            self.client = int(p.connect(p.DIRECT))
        self._entered = True
        self._set_physics()
        self.robot_id = load_urdf(
            self.client, PANDA_URDF, gtsam.Pose3(), p.URDF_USE_INERTIA_FROM_FILE
        )
        self._set_up_robot()
        self.object_id = load_urdf(self.client, self.built.urdf, self.placement.T_world_object)
        self.part_joint = joint_index(self.client, self.object_id, PART_JOINT)
        self._furnish()
        self._add_room(folder)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._entered:
            p.disconnect(physicsClientId=self.client)
            self._entered = False
        self._folder.cleanup()

    @property
    def time_s(self) -> float:
        """Simulated time since the start."""
        return self._steps * self.config.step_s

    def step(self) -> None:
        """One physics step."""
        if self.built.lift_n > 0.0:
            self._balance()
        p.stepSimulation(physicsClientId=self.client)
        self._steps += 1

    def _balance(self) -> None:
        """A balanced hinge carries the part's weight, wherever it stands."""
        state = p.getLinkState(self.object_id, self.part_joint, physicsClientId=self.client)
        p.applyExternalForce(
            self.object_id,
            self.part_joint,
            [0.0, 0.0, self.built.lift_n],
            state[0],
            p.WORLD_FRAME,
            physicsClientId=self.client,
        )

    def part_state(self) -> float:
        """The true state of the part, m or rad. For scoring alone."""
        return float(
            p.getJointState(self.object_id, self.part_joint, physicsClientId=self.client)[0]
        )

    def truth(self) -> JointTruth:
        """The true joint and its state now. For scoring alone: nothing on the robot sees it."""
        T = self.placement.T_world_object
        prismatic = self.spec.kind == "prismatic"
        return JointTruth(
            kind=self.spec.kind,
            axis=T.rotation().matrix() @ self.built.axis_object,
            pivot=None if prismatic else T.transformFrom(self.built.pivot_object),
            states=np.array([self.part_state()]),
        )

    def _set_physics(self) -> None:
        p.setGravity(0, 0, -self.config.gravity_m_s2, physicsClientId=self.client)
        p.setPhysicsEngineParameter(
            fixedTimeStep=self.config.step_s,
            numSubSteps=0,
            numSolverIterations=self.config.solver_iterations,
            deterministicOverlappingPairs=1,
            physicsClientId=self.client,
        )

    def _add_room(self, folder: Path) -> None:
        """A floor and a wall a hand's breadth behind the cabinet.

        Here they are collision shapes alone; their looks never change and are drawn once, by
        the camera, from the files written here.
        """
        rng = np.random.default_rng([self.spec.seed, 9])
        T, depth = self.placement.T_world_object, self.spec.size_m[1]
        ground, plinth = self.placement.floor_m, self.placement.plinth_m
        T_floor = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, ground - 0.025]))
        behind = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, depth / 2 + 0.1, 2.0 - plinth]))
        for name, image, size, T_world_box, side in (
            ("floor", floor(rng), [16.0, 16.0, 0.05], T_floor, 4),
            ("wall", plaster(rng), [16.0, 0.05, 4.0], T * behind, 3),
        ):
            cv2.imwrite(str(folder / f"{name}.png"), image[..., ::-1])
            box = Box(name, np.array(size), gtsam.Pose3(), name)
            path = folder / f"{name}.obj"
            write_textured_boxes(path, [box], f"{name}.png", split_m=ROOM_CELL_M, sides=[side])
            self._add_wall(np.array(size), T_world_box)
            urdf = path.with_suffix(".urdf")
            urdf.write_text(ROOM_URDF.format(name=name), encoding="utf-8")
            self.room.append((urdf, T_world_box))
        self._add_supports()

    def _add_supports(self) -> None:
        """What lifts the object (a plinth) or the robot (a pedestal) off the floor."""
        ground, plinth = self.placement.floor_m, self.placement.plinth_m
        T, size = self.placement.T_world_object, self.spec.size_m
        if plinth > 0.0:
            middle = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -plinth / 2.0]))
            self._add_block(np.array([size[0], 0.9 * size[1], plinth]), T * middle)
        if ground < 0.0:
            middle = gtsam.Pose3(gtsam.Rot3(), np.array([-0.05, 0.0, ground / 2.0]))
            self._add_block(np.array([0.3, 0.3, -ground]), middle)

    def _add_wall(self, size_m: FloatArray, T_world_box: gtsam.Pose3) -> None:
        # Without a visual shape the collision shape would be drawn: give it a speck inside.
        self._add_static(size_m, np.full(3, 2e-4), T_world_box, [1.0, 1.0, 1.0, 1.0])

    def _add_block(self, size_m: FloatArray, T_world_box: gtsam.Pose3) -> None:
        self._add_static(size_m, size_m, T_world_box, [0.45, 0.45, 0.47, 1.0])

    def _add_static(
        self, size_m: FloatArray, seen_m: FloatArray, T_world_box: gtsam.Pose3, rgba: list[float]
    ) -> None:
        shape = p.createCollisionShape(
            p.GEOM_BOX, halfExtents=(size_m / 2.0).tolist(), physicsClientId=self.client
        )
        looks = p.createVisualShape(
            p.GEOM_BOX,
            halfExtents=(seen_m / 2.0).tolist(),
            rgbaColor=rgba,
            physicsClientId=self.client,
        )
        p.createMultiBody(
            0.0,
            shape,
            looks,
            T_world_box.translation().tolist(),
            quaternion_xyzw(T_world_box.rotation()),
            physicsClientId=self.client,
        )

    def _furnish(self) -> None:
        """Coulomb friction as a velocity motor of bounded force; viscous damping; contact."""
        spec = self.spec
        p.setJointMotorControl2(
            self.object_id,
            self.part_joint,
            p.VELOCITY_CONTROL,
            targetVelocity=0.0,
            force=spec.friction,
            physicsClientId=self.client,
        )
        p.changeDynamics(
            self.object_id,
            self.part_joint,
            jointDamping=spec.damping,
            lateralFriction=spec.handle_mu,
            linearDamping=0.0,
            angularDamping=0.0,
            physicsClientId=self.client,
        )

    def _set_up_robot(self) -> None:
        for link in range(-1, p.getNumJoints(self.robot_id, physicsClientId=self.client)):
            p.changeDynamics(
                self.robot_id,
                link,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=self.client,
            )
        for j in range(N_ARM):
            p.resetJointState(self.robot_id, j, Q_HOME[j], physicsClientId=self.client)
        for name in ("panda_finger_joint1", "panda_finger_joint2"):
            finger = joint_index(self.client, self.robot_id, name)
            p.resetJointState(self.robot_id, finger, 0.04, physicsClientId=self.client)
            p.changeDynamics(
                self.robot_id,
                finger,
                lateralFriction=self.config.finger_mu,
                spinningFriction=self.config.finger_spin_m,
                rollingFriction=0.0,
                frictionAnchor=1,
                physicsClientId=self.client,
            )
