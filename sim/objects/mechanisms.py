"""What holds a part closed or pulls it shut: catches and closers.

Both act along the joint: newtons over metres for a prismatic one, newton metres over radians for
a revolute one. The state is 0 where the part is closed and grows as it opens.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Catch:
    """A magnet or a spring-loaded ball that holds the closed part.

    Its hold grows linearly from the closed state to `force` at `peak` (its stiffness is their
    ratio), and falls linearly from there to nothing at `travel`.
    """

    force: float  # the most it holds with, N or N m
    peak: float  # state at which it holds most, m or rad
    travel: float  # state from which it holds no longer, m or rad

    def __post_init__(self) -> None:
        if not (self.force > 0.0 and 0.0 < self.peak < self.travel):
            raise ValueError(f"{self}: expected force > 0 and 0 < peak < travel")

    @property
    def stiffness(self) -> float:
        """N/m or N m/rad, from the closed state to the peak."""
        return self.force / self.peak

    def holds(self, state: float) -> float:
        """Force or torque towards closed at `state`."""
        if state <= 0.0 or state >= self.travel:
            return 0.0
        if state < self.peak:
            return self.stiffness * state
        return self.force * (self.travel - state) / (self.travel - self.peak)


@dataclass(frozen=True, slots=True)
class Closer:
    """A spring that pulls the part shut, as in self-closing slides and sprung hinges."""

    preload: float  # at the closed state, N or N m
    stiffness: float  # N/m or N m/rad
    until: float  # state from which it has let go, m or rad; infinite where it never does

    def pulls(self, state: float) -> float:
        """Force or torque towards closed at `state`."""
        if state >= self.until:
            return 0.0
        return self.preload + self.stiffness * max(state, 0.0)


def resistance(state: float, catch: Catch | None, closer: Closer | None) -> float:
    """Force or torque towards closed, N or N m, of both together at `state` (m or rad)."""
    held = catch.holds(state) if catch else 0.0
    return held + (closer.pulls(state) if closer else 0.0)
