"""The Franka hand: two fingers that stay centred and squeeze with a bounded force."""

from __future__ import annotations

from dataclasses import dataclass

from sim.bullet import joint_index, p
from sim.world import SimWorld


@dataclass(frozen=True, slots=True)
class GripperConfig:
    """The Franka hand's figures."""

    force_n: float = 70.0  # continuous grasping force (Franka hand data sheet)
    speed_m_s: float = 0.05  # of each finger
    open_m: float = 0.04  # travel of each finger
    nothing_m: float = 0.004  # opening below which the fingers have met
    gear_force_n: float = 200.0  # what the coupling may use to keep the fingers centred


class SimGripper:
    """Finger motors and the gear between them; the only constraint of the world."""

    def __init__(self, world: SimWorld, config: GripperConfig | None = None) -> None:
        self.config = config or GripperConfig()
        self._client, self._robot = world.client, world.robot_id
        self._fingers = [
            joint_index(self._client, self._robot, f"panda_finger_joint{i}") for i in (1, 2)
        ]
        gear = p.createConstraint(
            self._robot,
            self._fingers[0],
            self._robot,
            self._fingers[1],
            p.JOINT_GEAR,
            [1, 0, 0],
            [0, 0, 0],
            [0, 0, 0],
            physicsClientId=self._client,
        )
        p.changeConstraint(
            gear,
            gearRatio=-1,
            erp=0.1,
            maxForce=self.config.gear_force_n,
            physicsClientId=self._client,
        )
        self.squeezing = False
        self.open()

    def open(self) -> None:
        """Drives the fingers apart."""
        self.squeezing = False
        self._drive(self.config.speed_m_s)

    def close(self) -> None:
        """Drives the fingers together and keeps squeezing with the force limit."""
        self.squeezing = True
        self._drive(-self.config.speed_m_s)

    def _drive(self, speed_m_s: float) -> None:
        for finger in self._fingers:
            p.setJointMotorControl2(
                self._robot,
                finger,
                p.VELOCITY_CONTROL,
                targetVelocity=speed_m_s,
                force=self.config.force_n,
                physicsClientId=self._client,
            )

    def travel_m(self) -> tuple[float, float]:
        """Measured travel of each finger, 0 where they meet."""
        states = p.getJointStates(self._robot, self._fingers, physicsClientId=self._client)
        return float(states[0][0]), float(states[1][0])

    def opening_m(self) -> float:
        """Measured distance between the fingertips."""
        return sum(self.travel_m())

    def closed_on_something(self) -> bool:
        """Squeezing, and stopped by something thicker than `nothing_m`."""
        return self.squeezing and self.opening_m() > self.config.nothing_m
