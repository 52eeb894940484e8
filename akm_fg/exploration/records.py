"""What exploration works on and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import gtsam

from akm_fg.model.records import ObjectModel
from akm_fg.perception.fronts.front_records import ContactKind
from akm_fg.records import FloatArray, Look, RgbdFrame
from akm_fg.stages import RecordingFit
from factors.joint import JointKind

Outcome = Literal["opened", "rigid", "grasp_lost", "refused", "stopped"]
Way = Literal["outward", "left", "right", "upward"]
INTERRUPTED = "interrupted"  # reason of an attempt that has no other yet
StopReason = Literal["posterior", "threshold", "attempts"]


@dataclass(frozen=True, slots=True)
class Contact:
    """A place where the fingers may take hold."""

    p_world: FloatArray  # (3,) m
    uv: FloatArray  # (2,) pixel of the first look
    normal_world: FloatArray  # (3,) unit, out of the front that it is on
    front: int  # which rigid front that is
    prior: float  # probability that what is held here moves, if anything here does
    what: ContactKind = "protrusion"
    serves: float = 1.0  # probability that it moves that front, if the front opens: by its shape


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Holding this contact and pulling this way moves a part."""

    contact: int  # place among the contacts
    way: Way
    direction_world: FloatArray  # (3,) unit


@dataclass(frozen=True, slots=True)
class Bounds:
    """How well a joint is known: 95 % bounds, and standard deviations as they are printed."""

    axis_rad: float  # angle to the true axis
    pivot_m: float | None  # distance of the true axis line; None of what slides
    axis_sd_rad: float
    pivot_sd_m: float | None


@dataclass(frozen=True, slots=True)
class Stretch:
    """What was known after a short stretch of pull."""

    travel_m: float  # path of the hand since it took hold
    frames: int  # of the attempt's recording, so far
    kind: str  # `rigid` where nothing moved
    kind_probability: dict[str, float]
    state: float | None  # m or rad; None where nothing moved or nothing tells it
    state_sd: float | None
    bounds: Bounds | None
    expected_next: Bounds | None  # after a further stretch, foreseen now
    solve_s: float  # of processor time
    seen: bool = True  # the state, by the camera; else the hand that holds the part tells it

    @property
    def turns(self) -> bool:
        """Whether the state is an angle. It is of the likeliest kind, which may change later."""
        kinds = self.kind_probability
        likeliest = max(kinds, key=kinds.__getitem__, default="rigid")
        return likeliest != "rigid" and JointKind(likeliest).turns


@dataclass(slots=True)
class Attempt:
    """One try: where, which way, what came of it. Grows while it runs."""

    hypothesis: Hypothesis
    contact: Contact
    probability: float  # that it opens, as believed before
    outcome: Outcome = "stopped"
    reason: str = INTERRUPTED
    pulled: bool = False  # a refusal costs no pull
    held: bool = False  # the fingers closed on something
    rigid_before: list[Way] = field(default_factory=list)  # ways in which this hold gave nothing
    stretches: list[Stretch] = field(default_factory=list)
    T_world_grasp: gtsam.Pose3 | None = None  # as it took hold, at the first state
    grasps_refused: int = 0
    regrasps: int = 0
    unseen_m: float = 0.0  # that the hand went with what it held, and nothing was seen to move
    recording: str | None = None
    time_s: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BeliefSnapshot:
    """Probability that a pull at each contact opens, before an attempt."""

    by_contact: FloatArray  # (C,) over the ways
    anything: float  # that anything here opens by a pull that can still be tried
    free: float  # that anything here opens, whether the arm can hold it or not


@dataclass(slots=True)
class FoundPart:
    """A part that was opened, where several are looked for."""

    name: str | None  # in the model; None: too little of it was seen for one
    attempt: int  # that opened it
    state: float | None  # where it was last seen, m or rad
    explains: tuple[int, ...]  # contacts that are on it, and are left alone from then on


@dataclass(slots=True)
class Exploration:
    """What has happened so far; stays readable when it is interrupted."""

    first_look: RgbdFrame | None = None
    contacts: tuple[Contact, ...] = ()
    beliefs: list[BeliefSnapshot] = field(default_factory=list)
    attempts: list[Attempt] = field(default_factory=list)
    # Of the last attempt that opened something, or else in which something moved.
    fit: RecordingFit | None = None
    looks: list[Look] = field(default_factory=list)  # of that attempt
    fitted: int | None = None  # number of that attempt
    found: list[FoundPart] = field(default_factory=list)  # where several parts are looked for
    model: ObjectModel | None = None  # of these
    stop: StopReason | None = None
    failure: str | None = None
    notes: list[str] = field(default_factory=list)  # what was done without, and why
    time_s: dict[str, float] = field(default_factory=dict)

    @property
    def opened(self) -> bool:
        """Whether a part was opened, by the program's own belief."""
        return self.parts_opened > 0

    @property
    def parts_opened(self) -> int:
        """How many parts were opened, by the program's own belief."""
        attempts = sum(attempt.outcome == "opened" for attempt in self.attempts)
        return len(self.found) or attempts  # two attempts may open the same part

    @property
    def pulls(self) -> int:
        """Interactions: attempts that touched the object."""
        return sum(attempt.pulled for attempt in self.attempts)
