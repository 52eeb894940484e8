"""Compliant motions of the hand where something may be touched: lines, feeling, the approach."""

from __future__ import annotations

from collections.abc import Generator, Iterator

import gtsam

from akm_fg.arm.body.kinematics import FrankaKinematics
from akm_fg.arm.motion.reaching import GraspConfiguration, looked_along, standoff
from akm_fg.errors import GraspFailed
from akm_fg.hardware.franka.compliance import Law
from akm_fg.hardware.franka.config import ReflexConfig, SpringConfig
from akm_fg.hardware.franka.control import HandControl
from akm_fg.hardware.franka.straight import StraightLine, off_by
from akm_fg.records import FloatArray


class GuardedHand:
    """Moves the hand by springs, one motion at a time."""

    def __init__(self, control: HandControl, kinematics: FrankaKinematics) -> None:
        """Keeps what is given; `kinematics` is for the caller's thread."""
        self.control, self._kinematics = control, kinematics
        self._config = control.config
        self._running: Generator[None] | None = None

    def held(self, law: Law, spring: SpringConfig, tick_s: float) -> Iterator[None]:
        """A compliant motion, until its law ends or nobody iterates it and the next begins."""
        self.expect(self._config.held_reflex)
        self._running = self.control.run(law, spring, tick_s)
        yield from self._running

    def expect(self, reflex: ReflexConfig) -> None:
        """Rest, and from now on stop at these forces."""
        self.rest()
        self.control.link.expect(reflex)

    def rest(self) -> None:
        """End a compliant motion that nobody iterates any more."""
        if self._running is not None:
            self._running.close()
            self._running = None

    def approach(
        self,
        T_world_grasp: gtsam.Pose3,
        choice: GraspConfiguration,
        feel_m: float,
        eye_world: FloatArray | None,
        tick_s: float,
    ) -> Iterator[None]:
        """From the pre-grasp to the grasp.

        Args:
            T_world_grasp: where the fingers will close.
            choice: the configuration with which it is approached.
            feel_m: how far its depth may be wrong; the hand goes on by as far to feel it.
            eye_world: (3,) of the camera that saw it.
            tick_s: between two ticks.

        Raises:
            GraspFailed: the approach was blocked.
        """
        c, T = self._config.approach, T_world_grasp
        speed_m_s = c.unseen_m_s if choice.unseen else c.speed_m_s
        if feel_m > 0.0:
            slow_m, way = max(c.guarded_m, feel_m), looked_along(T, eye_world, c.aslant_rad)
            begin, end = (T.translation() + m * way for m in (-slow_m, feel_m))
            start = standoff(T, choice.standoff_m).translation()
            yield from self._line(T, start, begin, speed_m_s, tick_s)
            yield from self._feel(T, begin, end, tick_s)
        else:
            yield from self.straight(T, choice.standoff_m, c.guarded_m, speed_m_s, tick_s)
            yield from self.straight(T, c.guarded_m, 0.0, c.guarded_m_s, tick_s)
        off_m = off_by(self._T_world_gripper().matrix(), T)[0]
        if off_m > c.arrival_m + feel_m:
            raise GraspFailed(_blocked(off_m))

    def _feel(
        self, T_world_grasp: gtsam.Pose3, begin: FloatArray, end: FloatArray, tick_s: float
    ) -> Iterator[None]:
        """On from a point (3,) to another until something stops the hand, and a little back."""
        c = self._config.approach
        try:
            yield from self._line(T_world_grasp, begin, end, c.feel_m_s, tick_s)
        except GraspFailed:  # what it was looking for
            pass
        here = gtsam.Pose3(T_world_grasp.rotation(), self._T_world_gripper().translation())
        yield from self.straight(here, 0.0, c.felt_back_m, c.feel_m_s, tick_s)

    def straight(
        self,
        T_world_goal: gtsam.Pose3,
        from_m: float,
        to_m: float,
        speed_m_s: float,
        tick_s: float,
    ) -> Iterator[None]:
        """Along the goal's z, from `from_m` behind it to `to_m` behind it; see `_line`."""
        start, end = (standoff(T_world_goal, m).translation() for m in (from_m, to_m))
        yield from self._line(T_world_goal, start, end, speed_m_s, tick_s)

    def _line(
        self,
        T_world_goal: gtsam.Pose3,
        start: FloatArray,
        end: FloatArray,
        speed_m_s: float,
        tick_s: float,
    ) -> Iterator[None]:
        """From a point (3,) to another, turned as the goal is.

        Raises:
            GraspFailed: something is in the way.
        """
        c = self._config
        line = StraightLine(T_world_goal, start, end, speed_m_s, c.approach, c.period_s)
        yield from self.held(line, c.stiff, tick_s)
        if line.blocked_m is not None:
            raise GraspFailed(_blocked(line.blocked_m))

    def _T_world_gripper(self) -> gtsam.Pose3:
        return self._kinematics.T_world_gripper(self.control.link.state().q)


def _blocked(left_m: float) -> str:
    return f"the approach was blocked {1e3 * left_m:.0f} mm before the grasp"
