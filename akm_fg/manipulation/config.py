"""All tuning of manipulation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from akm_fg.manipulation.board_grasps import BoardConfig
from akm_fg.manipulation.length_scale import LengthScaleConfig
from akm_fg.planning.move_length import MoveConfig
from akm_fg.planning.opening_path import HandLimits

PlannerName = Literal["covariance", "blind"]


@dataclass(frozen=True, slots=True)
class HoldConfig:
    """Taking hold of a part whose state and joint are known to so much."""

    most_grasps: int = 24  # asked of the planner, each time
    most_boards: int = 10  # of them of a front's edge
    most_failures: int = 4  # of taking hold, in one run
    enough: float = 0.98  # of the way ahead, within reach: no other grasp is asked for
    least: float = 0.15  # less of it is no grasp worth taking
    way_poses: int = 12  # of the way ahead, that the arm is asked for
    gap_m: float = 0.06  # of the open fingers that a handle and the error of its place may fill
    handle_m: float = 0.02  # of that, of a handle: bars and knobs are 8 to 25 mm thick
    depth_m: float = 0.015  # of a handle between the fingers, from where it begins to their tips
    # Along the handle, where the same bar is: beneath the hand itself no camera has seen it.
    beside_m: float = 0.06
    tips_m: float = 0.01  # before the fingertips: what is seen there is handle, and not front
    least_points: int = 5  # of a handle
    palm_m: float = 0.08  # before the tips: beyond the palm nothing is between the fingers
    feel_m: float = 0.01  # as in exploration: what is felt for along the approach, at least
    most_feel_m: float = 0.03  # beyond it the palm would meet the front
    # Other ways to take the same bar: turned about the fingers' opening (along the bar), about the
    # bar, and with the hand the other way round.
    along_rad: tuple[float, ...] = tuple(np.deg2rad([0.0, 25.0, -25.0, 45.0, -45.0]))
    about_rad: tuple[float, ...] = tuple(np.deg2rad([0.0, 20.0, -20.0]))
    board: BoardConfig = field(default_factory=BoardConfig)


@dataclass(frozen=True, slots=True)
class PushConfig:
    """A push on a front."""

    before_m: float = 0.015  # the fingertips, from the front as it is seen, before they push
    tip_m: float = 0.0072  # from the grasp point to the fingertips of a Franka's hand
    clear_m: float = 0.045  # around the fingertips: nothing sticks out of the front, and it goes on
    sticks_out_m: float = 0.012
    quarter_points: int = 3  # of the front in each quarter around
    facing: float = 0.8  # cosine between a push and the way the place goes
    apart_m: float = 0.06  # between places that are asked for
    most: int = 16  # of the planner
    least: float = 0.3  # of the way within reach
    enough: float = 0.98
    # What is pushed goes on by itself where the hand slows down faster than friction slows the
    # part: slow, and slower still at the end.
    hand: HandLimits = field(
        default_factory=lambda: HandLimits(speed_m_s=0.04, acceleration_m_s2=0.05, jerk_m_s3=0.3)
    )
    rolls_rad: tuple[float, ...] = (0.0, float(np.pi / 2.0), float(np.pi / 4.0))


@dataclass(frozen=True, slots=True)
class ManipulateConfig:
    """How a part is taken to a target."""

    planner: PlannerName = "covariance"
    blind_step_m: float = 0.10  # of the hand's way: the baseline's, as the paper's pull
    max_rounds: int = 5  # the paper's
    confidence: float = 0.95  # of being within tolerance: then it is done
    tolerance_m: float = 0.01
    tolerance_rad: float = float(np.deg2rad(1.5))
    tick_s: float = 0.3  # between frames of a motion
    most_looks: int = 6  # from behind the arm, in one run
    search_frames: int = 4  # until a state is found, of each look
    stuck_ticks: int = 5  # without progress before the way's end: it has met something
    stuck_m: float = 0.002  # what counts as progress in that time
    # Of a hand at rest, off where it was sent: it has met something. A compliant hand of 700 N/m
    # presses with 28 N then, more than friction holds back.
    pressed_m: float = 0.04
    push: PushConfig = field(default_factory=PushConfig)
    scale: LengthScaleConfig = field(default_factory=LengthScaleConfig)
    move: MoveConfig = field(default_factory=MoveConfig)
    hold: HoldConfig = field(default_factory=HoldConfig)
    hand: HandLimits = field(default_factory=HandLimits)

    def tolerance(self, turns: bool) -> float:
        """In the unit of the state."""
        return self.tolerance_rad if turns else self.tolerance_m
