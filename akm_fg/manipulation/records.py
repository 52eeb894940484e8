"""What a manipulation works on and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import gtsam

from akm_fg.manipulation.board_grasps import BoardGrasp
from akm_fg.records import Look
from akm_fg.relocalization.records import StateBelief

Action = Literal["look", "grasp", "move", "pull", "push", "end"]


@dataclass(frozen=True, slots=True)
class Goal:
    """Where a part should be. States are the model's."""

    state: float  # m or rad
    tolerance: float


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided, from which numbers."""

    action: Action
    why: str  # one line
    state: float | None  # the belief then, m or rad; None: not known
    state_sd: float | None
    probability: float  # of being within tolerance, then
    looks: int  # frames taken until then
    commanded: float | None = None  # state that a move goes to
    foreseen: dict[str, float] = field(default_factory=dict)  # 95 % bounds at its end
    reach: float | None = None  # share of the way that a grasp can go


@dataclass(frozen=True, slots=True)
class Stop:
    """A state beyond which the part does not go."""

    state: float
    sd: float
    opening: bool  # whether it was on its way away from closed


@dataclass(frozen=True, slots=True)
class Hold:
    """The part was held."""

    T_world_gripper: gtsam.Pose3
    state: float  # of the part then
    board: BoardGrasp | None = None  # where it was held by its front's edge

    @property
    def by_edge(self) -> bool:
        """Of its front, which is free only where the part stands open."""
        return self.board is not None


@dataclass(slots=True)
class Manipulation:
    """What has happened so far; stays readable when it is interrupted."""

    looks: list[Look] = field(default_factory=list)
    beliefs: list[StateBelief] = field(default_factory=list)  # one a look
    decisions: list[Decision] = field(default_factory=list)
    rounds: int = 0  # moves
    regrasps: int = 0  # of a part that was held before
    probability: float = 0.0  # of being within tolerance, at the end
    stop: Stop | None = None  # met on the way
    failure: str | None = None
    holds: list[Hold] = field(default_factory=list)
    time_s: dict[str, float] = field(default_factory=dict)

    @property
    def belief(self) -> StateBelief | None:
        """The last."""
        return self.beliefs[-1] if self.beliefs else None

    @property
    def clear_looks(self) -> int:
        """From behind the arm."""
        return sum(decision.action == "look" for decision in self.decisions)
