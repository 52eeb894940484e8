"""What a report needs to know of one run.

All states are relative to the first frame of the recording, where the state is zero, and are
signed along the estimated axis; metres or radians as the joint's states are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from akm_fg.posterior import ArticulationPosterior, StatePosterior
from akm_fg.records import BoolArray, FloatArray, JointTruth, PixelTracks, Recording, RoundSummary

CONFIDENCE = 0.95
"""A run says that it reached the target from this probability on (DESIGN: closed loop)."""

Verdict = Literal["reached", "not reached", "modelled", "wrong", "undecided", "failed"]


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True, slots=True)
class PartTracks:
    """Tracks in the image, and the part that each belongs to."""

    pixels: PixelTracks  # T frames, N tracks
    moving: BoolArray  # (N,) on the moving part
    static: BoolArray  # (N,) at rest; neither of the two is rejected or open

    def __post_init__(self) -> None:
        want = (self.pixels.visible.shape[1],)
        _require(self.moving.shape == want, f"moving {self.moving.shape}, expected {want}")
        _require(self.static.shape == want, f"static {self.static.shape}, expected {want}")
        _require(not (self.moving & self.static).any(), "a track is both moving and static")


@dataclass(frozen=True, slots=True)
class PointPaths:
    """Points in space where there are no images: those of tracks, or the one of a pose log."""

    p_world: FloatArray  # (T, N, 3) metres, NaN where lost
    stamps_s: FloatArray | None = None  # (T,) from the first frame on


@dataclass(frozen=True, slots=True)
class Goal:
    """Where the part was wanted."""

    target: float  # m or rad, relative to the first frame
    tolerance: float  # same unit
    unit: Literal["m", "rad"]

    def __post_init__(self) -> None:
        _require(bool(np.isfinite(self.target)), f"target {self.target} must be finite")
        _require(self.tolerance > 0, f"tolerance {self.tolerance} must be > 0")


@dataclass(frozen=True, slots=True)
class ArmRecord:
    """How the arm fared, as the simulator measured it. For scoring alone."""

    slip_m: float | None  # way of the gripper in the part since it took hold; None: it never held
    slip_rad: float | None  # and its turn
    limit_shares: dict[str, float]  # quantity -> largest share of its limit, 1 is the limit


@dataclass(frozen=True, slots=True)
class RunSummary:
    """One run, ready to be reported."""

    title: str  # the object's or recording's name
    command: str  # that repeats the run
    seed: int
    version: str
    recording: Recording | None  # None where `paths` are all there is
    tracks: PartTracks | None  # None where no point could be followed
    posterior: ArticulationPosterior | None  # None where the run failed before
    paths: PointPaths | None = None  # of an input without images
    states: StatePosterior | None = None  # (T,) all frames; None: the posterior's own
    truth: JointTruth | None = None  # for scoring alone; states (T,) of the recording's frames
    goal: Goal | None = None  # None where the part was only observed
    rounds: tuple[RoundSummary, ...] = ()
    final_state_true: float | None = None  # measured when all motion had ended
    arm: ArmRecord | None = None  # None where nothing was measured
    closed_loop_frame: int | None = None  # first frame of the closed loop; None if there was none
    time_s: dict[str, float] = field(default_factory=dict)  # stage -> seconds
    failure: str | None = None  # the cause, one line

    def __post_init__(self) -> None:
        given = (self.recording is None) != (self.paths is None)
        _require(given, "a run is of a recording or of paths")
        n = self.frame_count
        if self.tracks is not None:
            t = self.tracks.pixels.visible.shape[0]
            _require(t <= n, f"tracks of {t} frames, recording of {n}")
        states = self.frame_states
        if states is not None:
            _require(len(states.mean) <= n, f"{len(states.mean)} states, {n} frames")
        first = self.closed_loop_frame
        _require(first is None or 0 <= first < n, f"closed_loop_frame {first} outside 0..{n - 1}")

    @property
    def frame_count(self) -> int:
        """Of the recording or the paths."""
        if self.recording is not None:
            return len(self.recording.frames)
        return 0 if self.paths is None else len(self.paths.p_world)

    @property
    def times_s(self) -> FloatArray | None:
        """(T,) from the first frame on; None where the input has no stamps."""
        if self.recording is None:
            return None if self.paths is None else self.paths.stamps_s
        stamps = np.array([frame.stamp_s for frame in self.recording.frames])
        return stamps - stamps[0]

    @property
    def frame_states(self) -> StatePosterior | None:
        """States per frame: the run's own belief, else those of the most probable kind."""
        if self.states is not None or self.posterior is None:
            return self.states
        return self.posterior.best.states

    @property
    def claims_reached(self) -> bool:
        """Whether the program itself believes that it reached the target."""
        return bool(
            self.failure is None
            and self.rounds
            and self.rounds[-1].p_within_tolerance >= CONFIDENCE
        )

    @property
    def final_error(self) -> float | None:
        """True final state minus target; None without target or truth."""
        if self.goal is None or self.final_state_true is None:
            return None
        return self.final_state_true - self.goal.target

    @property
    def truly_within(self) -> bool | None:
        """Whether the true state ended within the tolerance; None where it is not known."""
        if self.goal is None or self.final_error is None:
            return None
        return bool(abs(self.final_error) <= self.goal.tolerance)

    @property
    def verdict(self) -> Verdict:
        """The run in one word. Reached takes both: the program says so, and it is so if known."""
        if self.goal is not None:
            agreed = self.claims_reached and self.truly_within is not False
            return "reached" if agreed else "not reached"
        if self.failure is not None or self.posterior is None:
            return "failed"
        if self.posterior.kind == "undecided":
            return "undecided"
        right = self.truth is None or self.truth.kind == self.posterior.kind
        return "modelled" if right else "wrong"
