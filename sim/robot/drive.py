"""The arm's low level: measured state in, limited torques out, one physics step at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from akm_fg.arm.body.limits import MotionRecorder, TorqueLimiter
from akm_fg.arm.body.model import N_ARM
from akm_fg.records import FloatArray
from sim.bullet import p
from sim.robot.gripper import SimGripper
from sim.world import SimWorld


@dataclass(frozen=True, slots=True)
class ArmState:
    """What the arm's encoders say."""

    q: FloatArray  # (7,) rad
    dq: FloatArray  # (7,) rad/s
    fingers_m: tuple[float, float]  # travel of each, 0 where they meet
    finger_speeds_m_s: tuple[float, float]


class ArmDrive:
    """Executes torques at the control rate, which is that of the physics (1 kHz, as Franka's).

    Encoders are off by `offsets_rad` (7,), always by the same.
    """

    def __init__(
        self, world: SimWorld, gripper: SimGripper, offsets_rad: FloatArray | None = None
    ) -> None:
        self._offsets_rad = np.zeros(N_ARM) if offsets_rad is None else offsets_rad
        self._world, self._gripper = world, gripper
        self._joints = [*range(N_ARM), *gripper.joints]
        self._arm_joints = list(range(N_ARM))
        self.step_s = world.config.step_s
        self.recorder: MotionRecorder | None = None
        self.state = self._measure()
        opening = sum(self.state.fingers_m)
        at_rest = world.kinematics.gravity(self.state.q, opening / 2.0)
        self._limiter = TorqueLimiter(at_rest, self.step_s)

    def refresh(self) -> ArmState:
        """Reads the encoders: needed where someone else has moved the arm."""
        self.state = self._measure()
        return self.state

    def execute(self, motion: Iterator[FloatArray], tick_s: float) -> Iterator[None]:
        """Applies a motion's torques (7,) N m step by step; hands back control every `tick_s`."""
        due = self._world.time_s + tick_s
        self.refresh()
        for tau in motion:
            self._step(tau)
            if self._world.time_s >= due - 0.5 * self.step_s:
                due += tick_s
                yield None

    def _step(self, tau_wanted: FloatArray) -> None:
        tau = self._limiter.limited(tau_wanted)
        p.setJointMotorControlArray(
            self._world.robot_id,
            self._arm_joints,
            p.TORQUE_CONTROL,
            forces=tau.tolist(),
            physicsClientId=self._world.client,
        )
        self._world.step()
        state = self.refresh()
        self._gripper.advance(state.fingers_m, state.finger_speeds_m_s, self.step_s)
        if self.recorder is not None:
            self.recorder.add(state.q, state.dq, tau)

    def _measure(self) -> ArmState:
        states = p.getJointStates(
            self._world.robot_id, self._joints, physicsClientId=self._world.client
        )
        q, dq, *_ = zip(*states, strict=True)
        measured = np.array(q[:N_ARM]) + self._offsets_rad
        return ArmState(measured, np.array(dq[:N_ARM]), (q[-2], q[-1]), (dq[-2], dq[-1]))
