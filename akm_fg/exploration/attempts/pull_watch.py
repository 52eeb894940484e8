"""What is seen of an attempt while it pulls: frames into the stream, its answers into stretches.

Knows pictures, joint angles and whether something is between the fingers, and nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from akm_fg.errors import InsufficientData
from akm_fg.exploration.attempts.filled import filled
from akm_fg.exploration.config import ExploreConfig
from akm_fg.exploration.foresight import Pulled, bounds_of, foreseen
from akm_fg.exploration.mobile_points import part_points
from akm_fg.exploration.processor_time import taking
from akm_fg.exploration.records import Attempt, Bounds, Stretch
from akm_fg.interfaces import Arm, Camera
from akm_fg.io.recording_depth import as_stored
from akm_fg.posterior import JointPosterior, StatePosterior
from akm_fg.records import Look, RgbdFrame
from akm_fg.stages import RecordingFit
from akm_fg.stream.seen_so_far import Hand


class Stream(Protocol):
    """Takes frames in as they come, and says what they mean: see `akm_fg.stream`."""

    def add(self, frame: RgbdFrame, hand: Hand | None = None) -> object:
        """Take in the next frame."""
        ...

    def posterior(self) -> RecordingFit:
        """What was seen so far, and what it means."""
        ...


class Observer(Protocol):
    """Is told what happens, as it happens."""

    def begun(self, number: int, attempt: Attempt) -> None:
        """An attempt begins."""
        ...

    def looked(self, look: Look) -> None:
        """A frame of the attempt was taken."""
        ...

    def stretched(self, attempt: Attempt) -> None:
        """A stretch was pulled and solved: the attempt's last."""
        ...

    def ended(self, number: int, attempt: Attempt) -> None:
        """An attempt has its outcome."""
        ...

    def stage(self, words: str) -> None:
        """What comes next."""
        ...


@dataclass(slots=True)
class Tried:
    """What an attempt left behind."""

    attempt: Attempt
    looks: list[Look] = field(default_factory=list)
    fit: RecordingFit | None = None  # of its frames, where something moved


class PullWatch:
    """What is seen of one attempt: frames into a stream, and its answers into stretches."""

    def __init__(
        self,
        arm: Arm,
        camera: Camera,
        stream: Stream,
        tried: Tried,
        observer: Observer,
        config: ExploreConfig,
        before: RgbdFrame | None = None,
    ) -> None:
        """Nothing is seen yet.

        Args:
            arm: holds and pulls.
            camera: watches.
            stream: solves.
            tried: is filled.
            observer: is told.
            config: of the exploration.
            before: shows what the arm hides now and what has not moved since; None: nothing does.
        """
        self._arm, self._camera, self._stream = arm, camera, stream
        self._tried, self._observer, self._config = tried, observer, config
        self._tick_s, self._time_s = config.pull.tick_s, tried.attempt.time_s
        self._before = before
        self.travel_m = 0.0  # of the hand since it took hold

    def watched(self, motion: Iterator[None]) -> None:
        """Run a motion to its end, a frame at every tick in which the hand has gone on."""
        while True:
            with taking(self._time_s, "pull"):
                more = next(motion, _DONE) is not _DONE
            if not more:
                break
            if self._gone_on():
                self.look()
        self.look()

    def _gone_on(self) -> bool:
        """Whether the hand is elsewhere than in the last frame: what stands still tells no more."""
        looks = self._tried.looks
        before = looks[-1].T_world_gripper.translation()
        went = float(np.linalg.norm(self._arm.T_world_gripper().translation() - before))
        return went > self._config.pull.look_m

    def look(self) -> None:
        """Take in one frame, unless the last was taken at this very moment."""
        with taking(self._time_s, "camera"):
            frame = self._camera.capture()
            if self._before is not None:  # from then on it is the past
                frame, self._before = filled(frame, self._before), None
            frame = as_stored(frame)
            look = Look(frame, self._arm.T_world_gripper(), self._arm.holding())
        looks = self._tried.looks
        if looks and frame.stamp_s <= looks[-1].frame.stamp_s:
            return
        looks.append(look)
        self._observer.looked(look)
        with taking(self._time_s, "watch"):
            self._stream.add(frame, Hand(look.T_world_gripper, look.holding))

    def solve(self) -> Stretch | None:
        """The joint from all frames of the attempt; None where nothing moved."""
        began = time.process_time()
        try:
            with taking(self._time_s, "solve"):
                fit = self._stream.posterior()
        except InsufficientData:
            return None
        best = fit.posterior.best
        if best.joint is None or best.states is None:
            return None
        if self._beyond_hand_m(best.joint, best.states) > self._config.pull.slipped_m:
            self._observer.stage("  what is seen to move is not what is held: it went too far")
            return None
        self._tried.fit = fit
        states = best.states if fit.carried is None else fit.carried
        state, sd = float(states.mean[-1]), float(states.sd[-1])
        known, seen = bool(np.isfinite(state)), bool(np.isfinite(best.states.mean[-1]))
        frames = len(self._tried.looks)
        stretch = Stretch(
            travel_m=self.travel_m,
            frames=frames,
            kind=str(fit.posterior.kind),
            kind_probability=dict(fit.posterior.kind_probability),
            state=state if known else None,
            state_sd=sd if known else None,
            bounds=bounds_of(best.joint),
            expected_next=None if not known else self._foreseen(fit, best.joint, state),
            solve_s=time.process_time() - began,
            seen=seen,
        )
        self._tried.attempt.stretches.append(stretch)
        self._observer.stretched(self._tried.attempt)
        return stretch

    def _beyond_hand_m(self, joint: JointPosterior, states: StatePosterior) -> float:
        """By how much more than the hand the held point must have gone, surely (3 sd).

        A hand may slide along what it holds, but nothing that it holds goes farther than it does.
        """
        held = self._tried.attempt.T_world_grasp
        seen = np.flatnonzero(np.isfinite(states.mean) & np.isfinite(states.sd))
        if held is None or not len(seen):
            return 0.0
        state, sd = float(states.mean[seen[-1]]), float(states.sd[seen[-1]])
        state = float(np.sign(state)) * max(abs(state) - 3.0 * sd, 0.0)
        p = held.translation()
        R, t = joint.joint.motion(np.array([state]))
        hand = [look.T_world_gripper.translation() for look in self._tried.looks if look.holding]
        went = max((float(np.linalg.norm(at - p)) for at in hand), default=0.0)
        return float(np.linalg.norm(R[0] @ p + t[0] - p)) - went

    def _foreseen(self, fit: RecordingFit, joint: JointPosterior, state: float) -> Bounds:
        points = part_points(fit, self._tried.attempt.contact)
        frames = len(self._tried.looks)
        held = max(sum(look.holding for look in self._tried.looks), 1)
        stretches = len(self._tried.attempt.stretches) + 1
        then = Pulled(state * (stretches + 1) / stretches, frames + held // stretches)
        return bounds_of(foreseen(joint, points, Pulled(state, frames), then))

    def joint(self) -> JointPosterior | None:
        """As it is known now; None as long as nothing was seen to move."""
        fit = self._tried.fit
        return None if fit is None else fit.posterior.best.joint

    def from_aside(self, why: str) -> Stretch | None:
        """Let go, look from where the arm hides little, and solve."""
        self._observer.stage(f"{why}; looking from aside")
        with taking(self._time_s, "reach"):
            for _ in self._arm.step_aside(self._tried.looks[-1].frame, self._tick_s):
                pass
        self.look()
        self._arm.see(self._tried.looks[-1].frame)
        return self.solve()


_DONE = object()
