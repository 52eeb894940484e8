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
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import gtsam
import numpy as np
from scipy.special import ndtr

from akm_fg.errors import GraspFailed, InsufficientData, MotionInfeasible, TracksLost
from akm_fg.interfaces import Arm, Camera
from akm_fg.io.recording_depth import as_stored
from akm_fg.pipeline import fit_recording
from akm_fg.planning.opening_path import HandLimits, plan_opening
from akm_fg.posterior import JointPosterior, StatePosterior
from akm_fg.records import FloatArray, Recording, RgbdFrame, RoundSummary
from akm_fg.stages import RecordingFit
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


@dataclass(frozen=True, slots=True)
class Look:
    """What is known of one moment: a frame, and where the gripper was."""

    frame: RgbdFrame
    T_world_gripper: gtsam.Pose3
    holding: bool  # something was between the closed fingers


@dataclass(slots=True)
class Episode:
    """What has happened so far; stays readable when it is interrupted."""

    looks: list[Look] = field(default_factory=list)
    fit: RecordingFit | None = None
    rounds: list[RoundSummary] = field(default_factory=list)
    closed_loop_frame: int | None = None
    failure: str | None = None
    time_s: dict[str, float] = field(default_factory=dict)

    @property
    def grasp_frames(self) -> tuple[int, int] | None:
        """First and last frame of the first stretch in which the gripper holds."""
        held = [look.holding for look in self.looks]
        if True not in held:
            return None
        first = held.index(True)
        end = held.index(False, first) if False in held[first:] else len(held)
        return first, end - 1

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


Modeller = Callable[[Recording], RecordingFit]
"""The frames so far -> what was seen in them and what it means."""


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
    model: Modeller = fit_recording,
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
        model: makes a posterior of the frames so far.
    """
    config = config or EpisodeConfig()
    watch = _Watch(arm, camera, episode, observer)
    tick_s = config.pull_tick_s
    try:
        watch.show_the_arm()
        observer.stage("grasping the given contact")
        watch.until_done(arm.grasp(task.T_world_grasp, tick_s), "grasp", looking=False)
        watch.look()
        observer.stage(f"pulling {100 * config.pull_m:.0f} cm")
        watch.until_done(arm.pull(task.direction_world, config.pull_m, tick_s), "pull")
        watch.look()
        _drive(arm, watch, task, config, model)
    except (GraspFailed, MotionInfeasible, InsufficientData) as error:
        episode.failure = str(error)


class _Watch:
    """Takes frames into an episode while motions run, and the time that both take."""

    def __init__(
        self,
        arm: Arm,
        camera: Camera,
        episode: Episode,
        observer: Observer,
    ) -> None:
        self._arm, self._camera = arm, camera
        self.episode, self.observer = episode, observer

    def look(self) -> None:
        """Take one frame, unless the last was taken at this very moment."""
        began = time.perf_counter()
        frame = as_stored(self._camera.capture())
        look = Look(frame, self._arm.T_world_gripper(), self._arm.holding())
        looks = self.episode.looks
        if not looks or frame.stamp_s > looks[-1].frame.stamp_s:
            self.observer.looked(look)
            looks.append(look)
        self.took("camera", began)

    def show_the_arm(self) -> None:
        """One frame for the arm alone: what it has to keep clear of. The part is not moving yet."""
        began = time.perf_counter()
        self._arm.see(self._camera.capture())
        self.took("camera", began)

    def until_done(self, motion: Iterator[None], stage: str, looking: bool = True) -> None:
        """Run a motion to its end, a frame at every tick."""
        began = time.perf_counter()
        while next(motion, _DONE) is not _DONE:
            self.took(stage, began)
            if looking:
                self.look()
            began = time.perf_counter()
        self.took(stage, began)

    def took(self, stage: str, began: float) -> None:
        """Account for the time since `began`."""
        times = self.episode.time_s
        times[stage] = times.get(stage, 0.0) + time.perf_counter() - began


_DONE = object()


def _drive(arm: Arm, watch: _Watch, task: Task, config: EpisodeConfig, model: Modeller) -> None:
    """Rounds of fit, decide, move."""
    episode, observer = watch.episode, watch.observer
    commanded: float | None = None
    for number in range(config.max_rounds + 1):
        observer.stage(f"modelling {len(episode.looks)} frames")
        began = time.perf_counter()
        episode.fit = model(episode.recording(task.name))
        watch.took("model", began)
        joint, states = _joint_of(episode.fit)
        if joint.kind not in task.target:
            raise InsufficientData(f"the joint seems {joint.kind}, for which no target is given")
        wanted, tolerance = task.target[joint.kind], config.tolerance(joint.kind)
        mean, sd = _last_state(states)
        p = probability_within(mean, sd, wanted, tolerance)
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
        watch.look()
        commanded = wanted
    last = episode.rounds[-1]
    episode.failure = (
        f"not sure of the target after {config.max_rounds} rounds "
        f"(probability {last.p_within_tolerance:.2f} of being within tolerance)"
    )


def _joint_of(fit: RecordingFit) -> tuple[JointPosterior, StatePosterior]:
    best = fit.posterior.best
    if best.joint is None or best.states is None:
        raise InsufficientData("the part was pulled, but the most probable answer is no motion")
    return best.joint, best.states


def _last_state(states: StatePosterior) -> tuple[float, float]:
    if not np.isfinite(states.mean[-1]):
        raise TracksLost("the part is not seen in the last frame")
    return float(states.mean[-1]), float(states.sd[-1])
