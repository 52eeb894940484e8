"""All tuning of exploration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from akm_fg.exploration.belief import BeliefConfig
from akm_fg.exploration.parts.config import PartsConfig
from akm_fg.exploration.seen_anew import SeenAnewConfig
from akm_fg.exploration.stopping import StopConfig
from akm_fg.exploration.suppression import SuppressionConfig
from akm_fg.planning.opening_path import HandLimits

StopRule = Literal["posterior", "threshold"]
BeliefName = Literal["bayes", "suppression"]


@dataclass(frozen=True, slots=True)
class PullConfig:
    """How an attempt pulls."""

    stretch_m: float = 0.03  # of hand path between two solutions
    most_stretches: int = 10
    tick_s: float = 0.25  # between frames of the pull
    look_m: float = 0.001  # by which the hand has gone on before another frame is taken
    gave_m: float = 0.004  # of the hand in a stretch, with the arm's and the pads' own give
    slipped_m: float = 0.015  # between where the hand is and where the part would have taken it
    unseen_m: float = 0.10  # that the hand goes with what it holds before anything is seen to move
    # A joint known so well (95 % bounds) leads the hand; before, the hand follows where it may go.
    led_axis_rad: float = float(np.deg2rad(10.0))  # over a stretch the hand is 5 mm off at most
    led_pivot_m: float = 0.04
    hand: HandLimits = field(default_factory=lambda: HandLimits(speed_m_s=0.05))
    most_grasps: int = 20  # asked of the planner for one contact
    most_regrasps: int = 2
    feel_m: float = 0.01  # of a grasp's depth that is not known, with a camera that does not err
    feel_sigmas: float = 2.0  # and of the camera's own errors, on top
    straight_m: float = 0.10  # the paper's pull, of the threshold's stop rule


@dataclass(frozen=True, slots=True)
class ExploreConfig:
    """How an exploration goes."""

    max_attempts: int = 25  # the paper's
    belief: BeliefName = "bayes"
    stop: StopRule = "posterior"
    adaptive_termination: bool = True  # the paper's AT: without, one attempt is all
    failure_suppression: bool = True  # its FS: without, failures teach nothing
    contact_analogy: bool = True  # its CA: without, all contacts are alike at first
    zero_shot: bool = False  # nothing is remembered of the object's own family
    bayes: BeliefConfig = field(default_factory=BeliefConfig)
    suppression: SuppressionConfig = field(default_factory=SuppressionConfig)
    pull: PullConfig = field(default_factory=PullConfig)
    stopping: StopConfig = field(default_factory=StopConfig)
    parts: int = 1  # that are looked for; 0: all that open
    several: PartsConfig = field(default_factory=PartsConfig)
    anew: SeenAnewConfig = field(default_factory=SeenAnewConfig)
    # Of an object of which nothing is known: that it opens at all. The contacts share it.
    opens_at_all: float = 0.95
    same_contact_m: float = 0.02  # candidates nearer than this are one
    shape_alone: float = 0.3  # of a contact's weight that stays where nothing remembered is like it
    memory: str = ""  # folder of remembered contacts; none: the one that comes with the package
