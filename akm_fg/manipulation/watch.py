"""What is seen of a part while it is moved: frames into a belief, and decisions from it.

Knows pictures, joint angles and whether something is between the fingers, and nothing else.
"""

from __future__ import annotations

import logging
from typing import Protocol

from akm_fg.closed_loop import probability_within
from akm_fg.errors import MotionInfeasible, TracksLost
from akm_fg.exploration.processor_time import taking
from akm_fg.interfaces import Arm, Camera
from akm_fg.io.recording_depth import as_stored
from akm_fg.manipulation.config import ManipulateConfig
from akm_fg.manipulation.felt_state import can_be_felt_for
from akm_fg.manipulation.length_scale import LengthScale
from akm_fg.manipulation.records import Action, Decision, Goal, Manipulation
from akm_fg.model.records import ModelPart
from akm_fg.records import Look, RgbdFrame
from akm_fg.relocalization.records import StateBelief
from akm_fg.stream.seen_so_far import Hand

log = logging.getLogger(__name__)


class Follower(Protocol):
    """Tells a part's state from frames: see `akm_fg.relocalization.relocalizer`."""

    def update(
        self,
        frame: RgbdFrame,
        hand: Hand | None = None,
        commanded: float | None = None,
        felt: tuple[float, float] | None = None,
    ) -> StateBelief:
        """Take in the next frame."""
        ...


class Stream(Protocol):
    """Takes frames in as they come, to learn the joint better."""

    def add(self, frame: RgbdFrame, hand: Hand | None = None) -> object:
        """Take in the next frame."""
        ...


class Observer(Protocol):
    """Is told what happens, as it happens."""

    def looked(self, look: Look) -> None:
        """A frame was taken."""
        ...

    def decided(self, decision: Decision) -> None:
        """What comes next, and why."""
        ...


class PartLost(MotionInfeasible):
    """The part's state is not known."""


class Watch:
    """Watches one part while an arm moves it.

    Args:
        arm: steps out of the picture.
        camera: fixed.
        follower: tells the part's state.
        part: of the model.
        goal: where it should be.
        run: is filled with frames, beliefs and decisions.
        observer: is told of frames and decisions.
        config: tuning.
        stream: learns from the frames; None: nothing does.
    """

    def __init__(
        self,
        arm: Arm,
        camera: Camera,
        follower: Follower,
        part: ModelPart,
        goal: Goal,
        run: Manipulation,
        observer: Observer,
        config: ManipulateConfig,
        stream: Stream | None = None,
    ) -> None:
        self._arm, self._camera, self._follower = arm, camera, follower
        self._part, self._goal, self._run = part, goal, run
        self._observer, self._config, self._stream = observer, config, stream
        length_sd = 0.0 if part.correction is None else part.correction.length_share_sd
        self._scale = LengthScale(part.joint.joint, length_sd, config.scale)
        self.frame: RgbdFrame | None = None  # the last from behind the arm
        self.seen_held = True  # a frame has shown the part since the hand took hold

    def look_clear(self, why: str) -> None:
        """Frames from behind the arm, which lets go and keeps clear of what they show.

        Raises:
            PartLost: the state is not known after it.
        """
        if self._run.clear_looks >= self._config.most_looks:
            raise PartLost(f"{why}, after {self._run.clear_looks} looks")
        self.decide("look", why)
        with taking(self._run.time_s, "step aside"):
            frame = as_stored(self._camera.capture())
            self._arm.see(self._part.corrected(frame))
            for _ in self._arm.step_aside(frame, self._config.tick_s):
                pass
        for _ in range(self._config.search_frames):
            frame = self.look()
            if self.seen() or self._outlined():
                break
            self._wait()  # a part that is not where it was believed is given up after some frames
        self.frame = self._part.corrected(frame)
        self._arm.see(self.frame)
        if not self.seen() and not self.borne_unseen():
            belief = self._run.belief
            told = "" if belief is None or belief.reason is None else f": {belief.reason}"
            raise PartLost(f"the part is not found{told}")

    def seen(self) -> bool:
        """Whether the last frame shows the part, at a state that is known."""
        belief = self._run.belief
        return belief is not None and belief.seen and self.state() is not None

    def _outlined(self) -> bool:
        """Whether the last frame tells by its outline where the part is, to what a hand feels."""
        belief = self._run.belief
        return belief is not None and belief.by_outline and self.borne_unseen()

    def borne_unseen(self) -> bool:
        """Whether a state that no frame shows is known as well as a hand can feel for a handle."""
        state = self.state()
        return state is not None and can_be_felt_for(self._part, *state, self._config.hold)

    def _wait(self) -> None:
        """Until the next frame: nothing moves."""
        frame = as_stored(self._camera.capture())
        with taking(self._run.time_s, "step aside"):
            for _ in self._arm.step_aside(frame, self._config.tick_s, unseen=True):
                pass

    def look(self, felt: tuple[float, float] | None = None) -> RgbdFrame:
        """One frame into the belief, unless the last was taken at this very moment.

        `felt`: state and deviation that a hand tells which has just closed.
        """
        run = self._run
        with taking(run.time_s, "camera"):
            frame = as_stored(self._camera.capture())
            look = Look(frame, self._arm.T_world_gripper(), self._arm.holding())
        if run.looks and frame.stamp_s <= run.looks[-1].frame.stamp_s:
            return run.looks[-1].frame
        run.looks.append(look)
        self._observer.looked(look)
        hand = Hand(look.T_world_gripper, look.holding)
        with taking(run.time_s, "relocalize"):
            run.beliefs.append(self._follower.update(frame, hand, felt=felt))
        self.seen_held = self.seen() or (self.seen_held and felt is None)
        self._take_scale(look)
        if self._stream is not None:
            with taking(run.time_s, "learn"):
                self._learn(frame, hand)
        return frame

    def _take_scale(self, look: Look) -> None:
        belief = self._run.beliefs[-1]
        if not look.holding or belief.mode != "tracking":
            self._scale.let_go()
        elif belief.seen and belief.mean is not None and belief.sd is not None:
            self._scale.held(belief.mean, belief.sd, look.T_world_gripper)

    def _learn(self, frame: RgbdFrame, hand: Hand) -> None:
        assert self._stream is not None
        try:
            self._stream.add(frame, hand)
        except TracksLost as error:
            log.info("nothing to learn from a frame: %s", error)

    def state(self) -> tuple[float, float] | None:
        """State and standard deviation, as far as somebody knows them."""
        belief = self._run.belief
        if belief is None or belief.mode != "tracking":
            return None
        if belief.mean is None or belief.sd is None:
            return None
        return self._scale.true_state(belief.mean, belief.sd, self._part.closed_state)

    def known(self) -> tuple[float, float]:
        """As `state`, from a clear look where it is lost.

        Raises:
            PartLost: it stays lost.
        """
        state = self.state()
        if state is None:
            belief = self._run.belief
            told = "" if belief is None or belief.reason is None else f": {belief.reason}"
            self.look_clear(f"the part was lost{told}")
            state = self.state()
        assert state is not None
        return state

    def decide(
        self,
        action: Action,
        why: str,
        commanded: float | None = None,
        foreseen: dict[str, float] | None = None,
        reach: float | None = None,
    ) -> None:
        """Write down what comes next and why, with the belief as it is."""
        state = self.state()
        q, sd = state if state is not None else (None, None)
        goal = self._goal
        p = 0.0 if state is None else probability_within(*state, goal.state, goal.tolerance)
        decision = Decision(
            action, why, q, sd, p, len(self._run.looks), commanded, foreseen or {}, reach
        )
        self._run.decisions.append(decision)
        self._observer.decided(decision)
