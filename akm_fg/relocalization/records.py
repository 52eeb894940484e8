"""What the filter takes in and tells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from akm_fg.records import FloatArray

Mode = Literal["searching", "tracking", "lost"]


@dataclass(frozen=True, slots=True)
class StateBelief:
    """What is known of a part's state at one time.

    `mean` and `sd` are of the likeliest hypothesis; `sd` holds what the model's joint leaves open.
    """

    stamp_s: float
    mode: Mode
    mean: float | None  # m or rad; None where nothing is known
    sd: float | None
    rate: float | None  # of the state, a second
    probability: float  # of the likeliest hypothesis, among all
    seen: bool  # whether the part's surface told anything of this frame
    nis: float | None  # normalised innovation squared of the surface, one degree of freedom
    predicted: float | None = None  # before this frame was looked at
    reason: str | None = None  # why it is lost, or nothing is seen
    by_outline: bool = False  # what told is where it hides what is behind it, and where not


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """States that explain a frame, likeliest first."""

    q: FloatArray  # (H,)
    sd: FloatArray  # (H,)
    probability: FloatArray  # (H,) sums to at most 1
