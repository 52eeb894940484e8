"""One PyBullet world in DIRECT mode: floor, wall, one cabinet, one Franka."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import gtsam
import numpy as np

from akm_fg.arm.body.description import franka_description
from akm_fg.arm.body.kinematics import Q_HOME, FrankaKinematics, IkConfig
from akm_fg.records import JointTruth
from sim.bullet import connect, joint_index, load_urdf, p
from sim.camera.robot_meshes import light_panda_urdf
from sim.objects.imported.imported_spec import ImportOptions
from sim.objects.mechanisms import resistance
from sim.objects.part_spec import Mechanism, PartSpec, mechanisms
from sim.objects.slope import HOLDS, slope_load
from sim.objects.staging import PlacementMode, find_spec, stage
from sim.objects.urdf.urdf_files import part_joint
from sim.robot.contacts import finger_links
from sim.robot.standing_aside import arm_angles, put_arm, stand_aside
from sim.room import add_room


@dataclass(frozen=True, slots=True)
class WorldConfig:
    """Physics and contact."""

    step_s: float = 1e-3  # the rate of Franka's control interface; stiff grasps need it
    gravity_m_s2: float = 9.81
    solver_iterations: int = 60  # friction of a squeezed handle converges by then
    finger_mu: float = 1.0  # rubber pads on metal or lacquer
    finger_spin_m: float = 0.005  # torsional friction, 2/3 mu r of a pad of 8 mm radius
    # Of each contact point of a pad, stiff and damped enough that the force hardly jumps when the
    # number of points changes: the URDF's 3e4 N/m and 1e3 N s/m press pads in by 2.4 mm and do.
    pad_stiffness_n_m: float = 1e6
    pad_damping_n_s_m: float = 2e4
    ik: IkConfig = field(default_factory=IkConfig)  # of the arm; objects are placed by it too


LOCK_FORCE = 1e4  # N or N m, of a locked joint: the arm can exert a hundred


class SimWorld:
    """The physics of one object and one robot. A context manager; deterministic by seed.

    World frame: the robot's base, z up.
    """

    def __init__(
        self,
        object_name: str,
        seed: int,
        config: WorldConfig | None = None,
        *,
        joint: str | None = None,
        options: ImportOptions | None = None,
        placement: PlacementMode = "reachable",
        locked: bool = False,
    ) -> None:
        """Finds the object; files are read (`sim.objects.staging`), nothing is built yet.

        Args:
            object_name: as `find_spec` takes it.
            seed: of what varies from one meeting to the next.
            config: physics.
            joint: of a file or folder, the one that is free.
            options: what else to say of a file or folder.
            placement: where the object stands (`sim.objects.staging.stage`).
            locked: whether the parts that would be free are jammed as well.
        """
        self.spec: PartSpec = find_spec(object_name, seed, joint, options)
        self._placement_mode, self._locked = placement, locked
        self.config = config or WorldConfig()
        self.arm_description = franka_description()  # of what PyBullet loads
        self.kinematics = FrankaKinematics(self.config.ik, self.arm_description)
        self._steps = 0
        self.every_step: list[Callable[[], None]] = []  # called before physics: trials use it
        self._entered = False
        self.still: list[tuple[Path, gtsam.Pose3]] = []  # looks of what never moves

    def __enter__(self) -> SimWorld:
        self._folder = tempfile.TemporaryDirectory(prefix="akm-fg-sim-")
        folder = Path(self._folder.name)
        self.built, self.placement = stage(self.spec, self.kinematics, self._placement_mode)
        files = self.built.urdf.parent
        self.client = connect()
        self._entered = True
        self._set_physics()
        self.robot_id = load_urdf(
            self.client,
            light_panda_urdf(self.arm_description),
            gtsam.Pose3(),
            p.URDF_USE_INERTIA_FROM_FILE,
            keep_files=True,
        )
        self._set_up_robot()
        T_world_object = self.placement.T_world_object
        self.object_id = load_urdf(self.client, files / "moving.urdf", T_world_object)
        self.still.append((files / "corpus.urdf", T_world_object))
        self.part_joints = tuple(
            joint_index(self.client, self.object_id, part_joint(i))
            for i in range(len(self._mechanisms))
        )
        self.part_joint = self.part_joints[0]
        self._furnish()
        self.still += add_room(
            self.client, self.placement, self.spec.size_m, self.spec.seed, folder
        )
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
        for call in self.every_step:
            call()
        for part, mechanism in enumerate(self._mechanisms):
            if mechanism.balanced:
                self._balance(part)
            if mechanism.catch or mechanism.closer:
                self._hold_back(part)
        p.stepSimulation(physicsClientId=self.client)
        self._steps += 1

    def _balance(self, part: int) -> None:
        """A balanced hinge carries the part's weight, wherever it stands."""
        joint = self.part_joints[part]
        state = p.getLinkState(self.object_id, joint, physicsClientId=self.client)
        lift_n = self.config.gravity_m_s2 * self._mechanisms[part].mass_kg
        p.applyExternalForce(
            self.object_id,
            joint,
            [0.0, 0.0, lift_n],
            state[0],
            p.WORLD_FRAME,
            physicsClientId=self.client,
        )

    def _hold_back(self, part: int) -> None:
        """Catch and closer act along the joint, on top of the friction motor."""
        mechanism = self._mechanisms[part]
        torque = -resistance(self.part_state(part), mechanism.catch, mechanism.closer)
        p.setJointMotorControl2(
            self.object_id,
            self.part_joints[part],
            p.TORQUE_CONTROL,
            force=torque,
            physicsClientId=self.client,
        )

    @property
    def _mechanisms(self) -> tuple[Mechanism, ...]:
        return mechanisms(self.spec)

    @property
    def parts(self) -> int:
        """How many parts open, by the object's making. For scoring alone."""
        return len(self._mechanisms)

    def part_state(self, part: int = 0) -> float:
        """The true state of a part, m or rad. For scoring alone."""
        joint = self.part_joints[part]
        return float(p.getJointState(self.object_id, joint, physicsClientId=self.client)[0])

    def put_part(self, state: float, part: int = 0) -> None:
        """A part is at another state, at rest: moved while nobody looked.

        Where the arm would stand in its way it is put out of it: whoever moves the part does so.

        Raises:
            ValueError: the robot is there, wherever its arm stands; nothing has moved then.
        """
        before, arm = self.part_state(part), arm_angles(self.client, self.robot_id)
        self.set_part(state, part)
        if stand_aside(self.client, self.robot_id, self.object_id) <= 0.0:
            self.set_part(before, part)
            put_arm(self.client, self.robot_id, arm)
            raise ValueError(f"a part at {state:g} would be in the robot's base")

    def set_part(self, state: float, part: int = 0) -> None:
        """A part is at another state, at rest, whatever is there."""
        joint = self.part_joints[part]
        p.resetJointState(self.object_id, joint, state, 0.0, physicsClientId=self.client)

    def truth(self, part: int = 0) -> JointTruth:
        """A true joint and its state now. For scoring alone: nothing on the robot sees it."""
        T, built = self.placement.T_world_object, self.built
        axes = [built.axis_object, *built.more_axes_object]
        pivots = [built.pivot_object, *built.more_pivots_object]
        kind = self._mechanisms[part].kind
        return JointTruth(
            kind=kind,
            axis=T.rotation().matrix() @ axes[part],
            pivot=None if kind == "prismatic" else T.transformFrom(pivots[part]),
            states=np.array([self.part_state(part)]),
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

    def _furnish(self) -> None:
        """Coulomb friction as a velocity motor of bounded force; viscous damping; contact."""
        for number, part in enumerate(self._mechanisms):
            joint = self.part_joints[number]
            if self._locked:
                self.jam(number)
            else:
                p.setJointMotorControl2(
                    self.object_id,
                    joint,
                    p.VELOCITY_CONTROL,
                    targetVelocity=0.0,
                    force=max(part.friction, HOLDS * self._slope_load(number)),
                    physicsClientId=self.client,
                )
            p.changeDynamics(
                self.object_id,
                joint,
                jointDamping=part.damping,
                lateralFriction=part.handle_mu,
                linearDamping=0.0,
                angularDamping=0.0,
                physicsClientId=self.client,
            )
        # Fingers slide on locked handles as on the free one.
        p.changeDynamics(
            self.object_id, -1, lateralFriction=self.spec.handle_mu, physicsClientId=self.client
        )

    def _slope_load(self, part: int) -> float:
        """What gravity adds along a part's joint because the object does not stand level."""
        mechanism, truth = self._mechanisms[part], self.truth(part)
        if mechanism.balanced:
            return 0.0
        lever_m = None
        if truth.pivot is not None:
            joint = self.part_joints[part]
            state = p.getLinkState(self.object_id, joint, physicsClientId=self.client)
            lever_m = float(np.linalg.norm(np.cross(state[0] - truth.pivot, truth.axis)))
        axis_object = self.placement.T_world_object.rotation().matrix().T @ truth.axis
        weight_n = self.config.gravity_m_s2 * mechanism.mass_kg
        return slope_load(weight_n, axis_object, truth.axis, lever_m)

    def jam(self, part: int = 0) -> None:
        """A motor stronger than any hand holds a part where it is; it looks as it always does."""
        p.setJointMotorControl2(
            self.object_id,
            self.part_joints[part],
            p.POSITION_CONTROL,
            targetPosition=self.part_state(part),
            force=LOCK_FORCE,
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
        put_arm(self.client, self.robot_id, Q_HOME)
        for finger in finger_links(self.client, self.robot_id):
            p.resetJointState(self.robot_id, finger, 0.04, physicsClientId=self.client)
            p.changeDynamics(
                self.robot_id,
                finger,
                lateralFriction=self.config.finger_mu,
                spinningFriction=self.config.finger_spin_m,
                rollingFriction=0.0,
                frictionAnchor=1,
                contactStiffness=self.config.pad_stiffness_n_m,
                contactDamping=self.config.pad_damping_n_s_m,
                physicsClientId=self.client,
            )
