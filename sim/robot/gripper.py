"""The Franka hand: two fingers that stay centred and squeeze with a bounded force."""

from __future__ import annotations

from dataclasses import dataclass

from sim.bullet import p
from sim.robot.contacts import finger_links
from sim.world import SimWorld


@dataclass(frozen=True, slots=True)
class GripperConfig:
    """The Franka hand's figures, and how gently it closes."""

    force_n: float = 70.0  # continuous grasping force (Franka hand data sheet)
    open_m_s: float = 0.05  # of each finger, the hand's largest
    close_m_s: float = 0.015  # slower, so that touching jerks the arm less than its limit
    open_m: float = 0.04  # travel of each finger
    nothing_m: float = 0.004  # opening below which the fingers have met
    seek_n: float = 1.5  # of each finger until both stand: touching with more jerks the arm
    ramp_n_s: float = 100.0  # from there to the full force
    touch_m_s: float = 0.002  # a slower finger stands
    touch_s: float = 0.03  # for this long
    opened_m: float = 0.0005  # this far from its end a finger stops: a hit would jerk the arm
    gear_force_n: float = 200.0  # what the coupling may use: more than both fingers push
    slips_m_s: float = 0.03  # faster fingers have lost what they squeezed


class SimGripper:
    """Finger motors and the gear between them; the only constraint of the world."""

    def __init__(self, world: SimWorld, config: GripperConfig | None = None) -> None:
        self.config = config or GripperConfig()
        self._client, self._robot = world.client, world.robot_id
        self.joints = finger_links(self._client, self._robot)
        self._couple()
        self.squeezing = False
        self._force_n = 0.0
        self._stood_s = 0.0
        self._opening = self._braking = False
        mass = [
            p.getDynamicsInfo(self._robot, j, physicsClientId=self._client)[0] for j in self.joints
        ]
        self._finger_kg = min(mass)
        self.open()

    def _couple(self) -> None:
        """The rack and pinion between the fingers: a gear with ratio -1 keeps them centred."""
        gear = p.createConstraint(
            self._robot,
            self.joints[0],
            self._robot,
            self.joints[1],
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

    @property
    def force_n(self) -> float:
        """What each finger's motor may push with now."""
        return self._force_n

    @property
    def at_full_force(self) -> bool:
        """Squeezing with all that the hand is allowed."""
        return self.squeezing and self._force_n >= self.config.force_n

    def open(self) -> None:
        """Drives the fingers apart."""
        self.squeezing, self._opening = False, True
        self._drive(self.config.open_m_s, self.config.force_n)

    def close(self) -> None:
        """Drives the fingers together; once both stand, the force grows to the limit and stays."""
        self.squeezing, self._opening = True, False
        self._stood_s = 0.0
        self._drive(-self.config.close_m_s, self.config.seek_n)

    def advance(
        self, travel_m: tuple[float, float], speeds_m_s: tuple[float, float], step_s: float
    ) -> None:
        """One control step, given the measured travel and speed of each finger."""
        c = self.config
        if self._opening and min(travel_m) > c.open_m - c.opened_m:
            self._opening = False
            self._drive(0.0, c.force_n)
        if not self.squeezing:
            return
        speed_m_s = max(abs(speed) for speed in speeds_m_s)
        if speed_m_s > c.slips_m_s:  # what was squeezed is lost: stop, and seek anew
            self._stood_s, self._braking = 0.0, True
            return self._drive(-c.close_m_s, c.force_n)
        if self._braking:
            self._braking = False
            return self._drive(-c.close_m_s, c.seek_n)
        self._stood_s = self._stood_s + step_s if speed_m_s < c.touch_m_s else 0.0
        if self._force_n > c.seek_n or self._stood_s >= c.touch_s:
            self._squeeze(min(self._force_n + c.ramp_n_s * step_s, c.force_n), step_s)

    def _squeeze(self, force_n: float, step_s: float) -> None:
        """A finger that stands pushes with what its motor may use.

        The motor is a constraint on the speed, and its force, where something is in the way, what
        the solver's sweeps make of the wanted speed: of one sweep no more than the finger's
        momentum at it. So the speed is that which the force would give the finger in one step.
        """
        wanted_m_s = self.config.close_m_s + force_n * step_s / self._finger_kg
        self._drive(-wanted_m_s, force_n)

    def _drive(self, speed_m_s: float, force_n: float) -> None:
        self._force_n = force_n
        for finger in self.joints:
            p.setJointMotorControl2(
                self._robot,
                finger,
                p.VELOCITY_CONTROL,
                targetVelocity=speed_m_s,
                force=force_n,
                physicsClientId=self._client,
            )

    def travel_m(self) -> tuple[float, float]:
        """Measured travel of each finger, 0 where they meet."""
        states = p.getJointStates(self._robot, self.joints, physicsClientId=self._client)
        return float(states[0][0]), float(states[1][0])

    def opening_m(self) -> float:
        """Measured distance between the fingertips."""
        return sum(self.travel_m())

    def closed_on_something(self) -> bool:
        """Squeezing, and stopped by something thicker than `nothing_m`."""
        return self.squeezing and self.opening_m() > self.config.nothing_m
