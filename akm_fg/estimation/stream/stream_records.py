"""What goes into and comes out of an incremental fit."""

from __future__ import annotations

from dataclasses import dataclass

from akm_fg.posterior import JointPosterior, NamedKind

LEAST_KEYFRAMES = 3  # the first one stays, and two others may become one


@dataclass(frozen=True, slots=True)
class IncrementalConfig:
    """How much is kept, and how often it is thought over."""

    max_keyframes: int = 40  # a graph of so many is solved on within half a camera's period
    max_pooled: int = 16  # frames that a keyframe may stand for
    max_tracks: int = 400  # beyond them, those lost are forgotten, the least seen first
    noise_floor: float = 2.5  # deviations of noise within which two places are one; beyond: 1e-7
    resting_keyframes: int = 10  # in one place until a motion is named: rest is told by many
    growth_to_solve: float = 0.05  # share of new frames after which the leading kind is solved on
    pieces_to_solve: int = 1  # of a comparison that is under way, between two times of solving on
    growth_to_compare: float = 0.15  # and after which all kinds are compared again
    pieces_together: int = 2  # of comparing by tracks alone, in a frame: tracks end meanwhile

    def __post_init__(self) -> None:
        if self.max_keyframes < LEAST_KEYFRAMES:
            raise ValueError(
                f"max_keyframes {self.max_keyframes}, expected at least {LEAST_KEYFRAMES}"
            )
        least_one = (self.max_pooled, self.pieces_to_solve, self.pieces_together)
        if min(least_one) < 1:
            raise ValueError(
                f"max_pooled, pieces_to_solve, pieces_together {least_one}, expected at least 1"
            )


@dataclass(frozen=True, slots=True)
class FrameUpdate:
    """What is known after a frame. The kinds' probabilities are those of the last comparison."""

    number: int  # of the frame, from 0
    stamp_s: float | None
    is_keyframe: bool
    kind: NamedKind
    kind_probability: dict[str, float]  # empty before the first comparison
    joint: JointPosterior | None  # of the most probable kind; None while that is rigid
    state: float | None  # of this frame, metres or radians; None where it is not seen
    state_sd: float | None
    zero_frame: int | None  # where the state is zero: the first frame whose tracks are kept
    keyframes: int
    warning: str | None  # why kinds could not be fitted or solved on, or a joint is provisional
