"""How far to go before looking again: until the joint's covariance no longer bears it.

The hand holds the part at the state it has now and moves along the joint as it is known. A joint
that is a little wrong leads the hand off the part's true way: by `predict_pose`, after going on by
dq the hand's pose relative to the part is off by a twist with a covariance that grows with dq. What
of it lies across the way strains the grasp (the arm presses with its stiffness times the error);
what lies along the way is a state that is not known, where no camera sees it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np

from akm_fg.posterior import JointPosterior
from akm_fg.prediction import predict_pose
from akm_fg.records import FloatArray

Bound = Literal["target", "across", "turn", "state", "reach", "step", "rest"]
LEVEL = 1.96  # of a 95 % bound, of one dimension


@dataclass(frozen=True, slots=True)
class MoveConfig:
    """What a task bears at the end of a move, as 95 % bounds."""

    states: int = 40  # between now and the target, that are asked
    across_m: float = 0.012  # a compliant hand of 700 N/m presses sideways with 8 N then
    turn_rad: float = float(np.deg2rad(6.0))  # and 25 N m/rad with 2.6 N m: what pads bear
    # Of what is left to the target, that the state may be unsure by where no camera sees the part.
    state_share: float = 0.25


@dataclass(frozen=True, slots=True)
class Foreseen:
    """What a move to each of K states would leave, as 95 % bounds."""

    q: FloatArray  # (K,)
    across_m: FloatArray  # (K,) hand against the part's true way, across it
    turn_rad: FloatArray  # (K,)
    state: FloatArray  # (K,) of the state, if nobody looks

    def at(self, k: int) -> dict[str, float]:
        """The bounds at one of the states."""
        across, turn = float(self.across_m[k]), float(self.turn_rad[k])
        return {"across_m": across, "turn_rad": turn, "state": float(self.state[k])}


@dataclass(frozen=True, slots=True)
class Move:
    """The next move, and what ends it there."""

    q_end: float
    bound: Bound
    foreseen: dict[str, float]  # 95 % bounds at its end


def foreseen(
    joint: JointPosterior, T_world_hand: gtsam.Pose3, q_now: float, q_sd: float, q: FloatArray
) -> Foreseen:
    """What is expected at states (K,) of a hand that holds the part at `q_now`.

    Args:
        joint: of the part.
        T_world_hand: the hand now.
        q_now: state now, m or rad.
        q_sd: its standard deviation.
        q: states to go to.
    """
    across, turn, state = np.zeros((3, len(q)))
    for k, to in enumerate(q):
        there = predict_pose(joint, float(to) - q_now, T_world_hand)
        way = joint.joint.velocity(there.T_world_pose[:3, 3])
        lever = max(float(np.linalg.norm(way)), 1e-6)
        along = way / lever
        cov = there.cov_world
        beside = np.eye(3) - np.outer(along, along)
        across[k] = np.sqrt(max(np.linalg.eigvalsh(beside @ cov @ beside)[-1], 0.0))
        turn[k] = np.sqrt(max(np.linalg.eigvalsh(there.cov[:3, :3])[-1], 0.0))
        state[k] = np.sqrt(q_sd**2 + max(float(along @ cov @ along), 0.0) / lever**2)
    return Foreseen(np.asarray(q), LEVEL * across, LEVEL * turn, LEVEL * state)


def next_move(
    joint: JointPosterior,
    T_world_hand: gtsam.Pose3,
    q_now: float,
    q_sd: float,
    q_target: float,
    tolerance: float,
    watched: bool,
    config: MoveConfig | None = None,
) -> Move | None:
    """The longest move that the covariance bears; None where it bears none.

    Args:
        joint: of the part.
        T_world_hand: the hand now, holding.
        q_now: state now, m or rad.
        q_sd: its standard deviation.
        q_target: where the part should be.
        tolerance: of that.
        watched: whether the camera sees the part, so that its state is known on the way.
        config: what the task bears.
    """
    config = config or MoveConfig()
    q = np.linspace(q_now, q_target, config.states + 1)[1:]
    then = foreseen(joint, T_world_hand, q_now, q_sd, q)
    left = np.abs(q_target - q)
    bears = np.maximum(tolerance, config.state_share * left)
    limits: list[tuple[Bound, np.ndarray]] = [
        ("across", then.across_m > config.across_m),
        ("turn", then.turn_rad > config.turn_rad),
    ]
    if not watched:
        limits.append(("state", then.state > bears))
    first = len(q)
    bound: Bound = "target"
    for name, over in limits:
        at = int(np.argmax(over)) if over.any() else len(q)
        if at < first:
            first, bound = at, name
    if first == 0:
        return None
    return Move(float(q[first - 1]), bound, then.at(first - 1))
