"""Pull, model, and drive the part to a target state: look, move, look again.

The camera keeps watching while the hand moves, and every frame goes into the graph: the model
gets better with use. The episode ends when P(|q - target| <= tolerance) is high enough, or says
why not. States are relative to the first frame.

An episode works on frames as a recording holds them and models them as `akm-fg fit` does, with
the same defaults: `fit` gives the posterior of its recording again, every digit.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import gtsam
import numpy as np
from scipy.special import ndtr

from akm_fg.errors import GraspFailed, InsufficientData, MotionInfeasible, TracksLost
from akm_fg.interfaces import Arm, Camera
from akm_fg.io.recording_depth import as_stored
from akm_fg.planning.opening_path import HandLimits, plan_opening
from akm_fg.posterior import JointPosterior
from akm_fg.records import FloatArray, Look, Recording, RgbdFrame, RoundSummary, first_hold
from akm_fg.stages import RecordingFit
from akm_fg.stream.frame_stream import FrameStream, FrameUpdate
from akm_fg.stream.seen_so_far import Hand
from factors.joint import JointKind

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class EpisodeConfig:
    """How an episode goes."""

    pull_m: float = 0.12  # of hand path; the paper pulls 0.1
    pull_tick_s: float = 0.15  # between frames of the pull
    move_tick_s: float = 0.3  # between frames of a closed-loop move
    max_rounds: int = 5  # the paper's
    confidence: float = 0.95
    tolerance_m: float = 0.01
    tolerance_rad: float = float(np.deg2rad(1.5))
    limits: HandLimits = field(default_factory=HandLimits)

    def tolerance(self, kind: JointKind) -> float:
        """In the unit of the kind's state."""
        return self.tolerance_rad if kind.turns else self.tolerance_m


@dataclass(slots=True)
class Episode:
    """What has happened so far; stays readable when it is interrupted."""

    looks: list[Look] = field(default_factory=list)
    update: FrameUpdate | None = None  # with the last frame
    fit: RecordingFit | None = None  # of the frames until the last decision
    rounds: list[RoundSummary] = field(default_factory=list)
    closed_loop_frame: int | None = None
    failure: str | None = None
    time_s: dict[str, float] = field(default_factory=dict)

    @property
    def grasp_frames(self) -> tuple[int, int] | None:
        """First and last frame of the first stretch in which the gripper holds."""
        return first_hold(self.looks)

    def recording(self, name: str) -> Recording:
        """The frames so far."""
        frames = tuple(look.frame for look in self.looks)
        poses = tuple(look.T_world_gripper for look in self.looks)
        return Recording(name, frames, None, poses, self.grasp_frames)


@dataclass(frozen=True, slots=True)
class Task:
    """What to do with an object."""

    name: str  # of the recording, in posteriors and messages
    T_world_grasp: gtsam.Pose3  # the given contact
    direction_world: FloatArray  # (3,) unit, where to pull first
    target: dict[str, float]  # kind -> wanted state relative to the first frame, m or rad


class Stream(Protocol):
    """Takes frames in as they come, and says what they mean: see `akm_fg.stream.FrameStream`."""

    def add(self, frame: RgbdFrame, hand: Hand | None = None) -> FrameUpdate:
        """Take in the next frame."""
        ...

    def posterior(self) -> RecordingFit:
        """What was seen so far, and what it means."""
        ...


class Observer(Protocol):
    """Is told what happens, as it happens."""

    def looked(self, look: Look) -> None:
        """A frame was taken."""
        ...

    def stage(self, words: str) -> None:
        """What comes next."""
        ...


def probability_within(mean: float, sd: float, target: float, tolerance: float) -> float:
    """P(|q - target| <= tolerance) for q ~ N(mean, sd^2)."""
    sd = max(sd, 1e-12)
    return float(ndtr((target + tolerance - mean) / sd) - ndtr((target - tolerance - mean) / sd))


def run_episode(
    arm: Arm,
    camera: Camera,
    task: Task,
    episode: Episode,
    observer: Observer,
    config: EpisodeConfig | None = None,
    stream: Stream | None = None,
) -> None:
    """Grasp a given contact, pull, model, and drive the part to a target.

    Args:
        arm: holds and moves.
        camera: fixed, watches.
        task: what to do.
        episode: is filled as things happen, and stays valid when this is interrupted; `failure`
            says in one line why the target was not reached.
        observer: is told of frames and stages.
        config: tuning.
        stream: models the frames of the whole episode; with the defaults if not given.
    """
    config = config or EpisodeConfig()
    watch = _Watch(arm, camera, stream or FrameStream(task.name), episode, observer)
    commanded: float | None = None
    try:
        watch.show_the_arm()
        observer.stage("grasping the given contact")
        grasp = arm.grasp(task.T_world_grasp, config.pull_tick_s)
        watch.until_done(grasp, "grasp", looking=False)
        watch.look()
        observer.stage(f"pulling {100 * config.pull_m:.0f} cm")
        watch.until_done(arm.pull(task.direction_world, config.pull_m, config.pull_tick_s), "pull")
        for number in range(config.max_rounds + 1):
            watch.look()
            observer.stage(f"modelling {len(episode.looks)} frames")
            joint, mean, sd = watch.joint_and_state()
            wanted = _wanted(task, joint)
            p = probability_within(mean, sd, wanted, config.tolerance(joint.kind))
            episode.rounds.append(RoundSummary(commanded, mean, sd, p))
            if p >= config.confidence:
                return
            if number == config.max_rounds:
                break
            if not arm.holding():
                raise GraspFailed("the gripper lost the part")
            observer.stage(f"moving to the target (round {number + 1})")
            episode.closed_loop_frame = episode.closed_loop_frame or len(episode.looks)
            path = plan_opening(joint, arm.T_world_gripper(), mean, wanted, config.limits)
            watch.until_done(arm.follow(path, config.move_tick_s), "move")
            commanded = wanted
        episode.failure = (
            f"not sure of the target after {config.max_rounds} rounds "
            f"(probability {p:.2f} of being within tolerance)"
        )
    except (GraspFailed, MotionInfeasible, InsufficientData) as error:
        episode.failure = str(error)


class _Watch:
    """Takes frames into an episode while motions run, and the time that both take."""

    def __init__(
        self, arm: Arm, camera: Camera, stream: Stream, episode: Episode, observer: Observer
    ) -> None:
        self._arm, self._camera, self._stream = arm, camera, stream
        self._episode, self._observer = episode, observer

    def look(self) -> None:
        """Take one frame, unless the last was taken at this very moment."""
        began = time.perf_counter()
        frame = as_stored(self._camera.capture())
        look = Look(frame, self._arm.T_world_gripper(), self._arm.holding())
        looks = self._episode.looks
        new = not looks or frame.stamp_s > looks[-1].frame.stamp_s
        if new:
            self._observer.looked(look)
            looks.append(look)
        self._took("camera", began)
        if new:
            began = time.perf_counter()
            hand = Hand(look.T_world_gripper, look.holding)
            self._episode.update = self._stream.add(frame, hand)
            self._took("model", began)

    def joint_and_state(self) -> tuple[JointPosterior, float, float]:
        """The joint as it is known now, and the part's state with its standard deviation.

        Raises:
            InsufficientData: the frames so far do not tell them.
        """
        began = time.perf_counter()
        self._episode.fit = self._stream.posterior()
        self._took("model", began)
        best = self._episode.fit.posterior.best
        if best.joint is None or best.states is None:
            raise InsufficientData("the part was pulled, but the most probable answer is no motion")
        mean, sd = float(best.states.mean[-1]), float(best.states.sd[-1])
        if not np.isfinite(mean):
            raise TracksLost("the part is not seen in the last frame")
        return best.joint, mean, sd

    def show_the_arm(self) -> None:
        """One frame for the arm alone: what it has to keep clear of. The part is not moving yet."""
        began = time.perf_counter()
        self._arm.see(self._camera.capture())
        self._took("camera", began)

    def until_done(self, motion: Iterator[None], stage: str, looking: bool = True) -> None:
        """Run a motion to its end, a frame at every tick."""
        began = time.perf_counter()
        while next(motion, _DONE) is not _DONE:
            self._took(stage, began)
            if looking:
                self.look()
            began = time.perf_counter()
        self._took(stage, began)

    def _took(self, stage: str, began: float) -> None:
        """Account for the time since `began`."""
        times = self._episode.time_s
        times[stage] = times.get(stage, 0.0) + time.perf_counter() - began


_DONE = object()


def _wanted(task: Task, joint: JointPosterior) -> float:
    """The target of this kind of joint."""
    if joint.kind not in task.target:
        raise InsufficientData(f"the joint seems {joint.kind}, for which no target is given")
    return task.target[joint.kind]
