"""A law at work on the arm: a thread of its own moves the spring's end while the caller looks.

Motions hand control back every `tick_s`, and a caller who takes a picture and thinks is away for
as long as that takes. The law runs on meanwhile, in small steps of the robot's clock, but not
unwatched for long: after `patience_s` the hand waits where it is.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Iterator

import gtsam
import numpy as np

from akm_fg.arm.body.kinematics import FrankaKinematics
from akm_fg.hardware.franka.compliance import HandState, Law, Reference
from akm_fg.hardware.franka.config import FrankaArmConfig, SpringConfig
from akm_fg.hardware.franka.link import ArmState, FrankaLink, Spring

POLL_S = 0.001  # between two looks at the robot's clock


class HandControl:
    """Runs laws on one arm, one after the other."""

    def __init__(
        self,
        link: FrankaLink,
        kinematics: FrankaKinematics,
        T_ee_gripper: gtsam.Pose3,
        config: FrankaArmConfig,
    ) -> None:
        """Keeps what is given.

        Args:
            link: connected.
            kinematics: for the thread alone: it has a state.
            T_ee_gripper: from the robot's own end effector to the point between the fingertips.
            config: periods and patience.
        """
        self._link, self._kinematics, self._config = link, kinematics, config
        self._T_gripper_ee = T_ee_gripper.inverse().matrix()

    def run(self, law: Law, spring: SpringConfig, tick_s: float) -> Generator[None]:
        """The law until it ends, by a spring from where the hand is; at rest afterwards.

        Raises:
            ArmStopped: the robot has stopped by itself, or the connection is lost.
        """
        with self._link.spring(spring) as held:
            work = _Work(self, law, held)
            work.start()
            try:
                yield from work.ticks(tick_s)
            finally:
                work.end()

    def hold(self, spring: SpringConfig, until_s: float, tick_s: float) -> Iterator[None]:
        """Hold the hand where it is until the fingers have done what was asked of them.

        Raises:
            ArmStopped: as `run`, or they take longer than `until_s`.
        """
        with self._link.spring(spring):
            began = time.monotonic()
            while not self._link.fingers_done(min(tick_s, until_s)):
                self._link.done()
                if time.monotonic() - began > until_s:
                    self._link.give_up_fingers()
                yield

    def hand(self, state: ArmState) -> HandState:
        """Where the gripper is, and how it moves."""
        T, J = self._kinematics.update(state.q)
        return HandState(state.time_s, T.copy(), J @ state.dq)

    def pull_to(self, spring: Spring, reference: Reference) -> None:
        """The spring's end, said of the gripper."""
        spring.pull_to(reference.T_world_gripper @ self._T_gripper_ee, reference.twist)

    def step(self, law: Law, spring: Spring, before: ArmState) -> tuple[ArmState, Reference | None]:
        """Wait for the next period of the robot's clock, and ask the law once."""
        c, state = self._config, before
        while state.time_s - before.time_s < c.period_s:
            time.sleep(POLL_S)
            if self._link.done():
                return state, None
            state = self._link.state()
        dt_s = min(state.time_s - before.time_s, c.late_s)
        reference = law(self.hand(state), dt_s)
        if reference is not None:
            self.pull_to(spring, reference)
        return state, reference

    def wait(self, spring: Spring, last: Reference | None) -> None:
        """The spring's end stands still."""
        if last is not None:
            self.pull_to(spring, Reference(last.T_world_gripper, np.zeros(6)))

    @property
    def link(self) -> FrankaLink:
        """The connection."""
        return self._link

    @property
    def config(self) -> FrankaArmConfig:
        """The arm's settings."""
        return self._config

    @property
    def patience_s(self) -> float:
        """How long it goes on unwatched."""
        return self._config.patience_s


class _Work:
    """One law in its thread."""

    def __init__(self, control: HandControl, law: Law, spring: Spring) -> None:
        self._control, self._law, self._spring = control, law, spring
        self._thread = threading.Thread(target=self._run, name="akm-fg arm", daemon=True)
        self._over, self._stop = threading.Event(), threading.Event()
        self._watched_s = time.monotonic()
        self._moved_s = 0.0  # time of the motion so far, by the robot's clock
        self._problem: Exception | None = None

    def start(self) -> None:
        self._thread.start()

    def end(self) -> None:
        self._stop.set()
        self._thread.join()

    def ticks(self, tick_s: float) -> Iterator[None]:
        """Hands back control after every `tick_s` of motion, until the law has ended."""
        due_s = tick_s
        while not self._over.wait(POLL_S):
            self._watched_s = time.monotonic()
            if self._moved_s >= due_s:
                due_s += tick_s
                yield None
        if self._problem is not None:
            raise self._problem

    def _run(self) -> None:
        try:
            self._work()
        except Exception as problem:  # it belongs to whoever waits
            self._problem = problem
        finally:
            self._over.set()

    def _work(self) -> None:
        state = self._control.link.state()
        began_s, paused_s = state.time_s, 0.0
        reference: Reference | None = None
        while not self._stop.is_set():
            if time.monotonic() - self._watched_s > self._control.patience_s:
                self._control.wait(self._spring, reference)
                paused_s += self._pause(state.time_s)
                state = self._control.link.state()
                continue
            state, reference = self._control.step(self._law, self._spring, state)
            self._moved_s = state.time_s - began_s - paused_s
            if reference is None:
                return

    def _pause(self, since_s: float) -> float:
        """Wait until somebody looks again; how long that took by the robot's clock."""
        while time.monotonic() - self._watched_s > self._control.patience_s:
            if self._stop.wait(POLL_S):
                break
        return self._control.link.state().time_s - since_s
