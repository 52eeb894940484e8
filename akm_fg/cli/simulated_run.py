"""One episode in the simulator, recorded as it goes, ready to be reported."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from akm_fg import __version__
from akm_fg.arm.body.limits import MotionRecorder
from akm_fg.arm.depth_from_arm import DepthFromArmConfig, correct_by_arm
from akm_fg.cli.config_argument import CONFIG
from akm_fg.cli.console.lines import tell
from akm_fg.cli.demo_config import DemoConfig, SimulatorConfig
from akm_fg.cli.exploring.outcome import fitted_recording
from akm_fg.cli.object_argument import ObjectArgument
from akm_fg.closed_loop import Episode, Observer, Task, run_episode
from akm_fg.config import AkmConfig
from akm_fg.errors import GraspFailed
from akm_fg.io.recording_writer import RecordingWriter
from akm_fg.model.build import FittedRecording
from akm_fg.records import JointTruth, Look
from akm_fg.report.summary import ArmRecord, Goal, PartTracks, RunSummary
from akm_fg.stages import Stages
from akm_fg.stream.frame_stream import FrameStream
from factors.joint import JointKind
from sim.episode import SimEpisode, open_world
from sim.objects.staging import PlacementMode
from sim.robot.slip import SlipGauge

RECORDING = "recording"  # the folder of the recording in the folder of the run


@dataclass(frozen=True, slots=True)
class RunRequest:
    """What to do with which object."""

    object: ObjectArgument
    seed: int  # of the object and the camera's noise
    target: dict[str, float]  # kind -> wanted state relative to the first frame, m or rad
    folder: Path  # of the run
    command: str  # that repeats it
    config: DemoConfig
    stages: Stages


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """What came of it."""

    summary: RunSummary
    fitted: FittedRecording | None  # frames until the last decision; None: without a fit
    interrupted: bool


def limit_shares(motion: MotionRecorder) -> dict[str, float]:
    """Largest share of each of the arm's limits that an executed motion used, 1 is the limit.

    As a real arm would report it: contacts change a simulated speed within one step.
    """
    if len(motion) < 3:
        return {}
    use = motion.motion().filtered().usage()
    return {
        "joint speed": use.velocity,
        "acceleration": use.acceleration,
        "jerk": use.jerk,
        "torque": use.torque,
    }


class _Reporter:
    """Writes frames and true states as they come, and says what happens."""

    def __init__(
        self, writer: RecordingWriter, world: SimEpisode, observer: Observer | None
    ) -> None:
        self._writer, self._world, self._observer = writer, world, observer
        self._began = time.perf_counter()
        self._motion = world.arm.record()
        self._gauge: SlipGauge | None = None  # from the moment at which the hand has taken hold
        self.truths: list[JointTruth] = []

    def looked(self, look: Look) -> None:
        """Keep the frame; the truth goes beside it, for scoring alone."""
        if self._observer is not None:
            self._observer.looked(look)
        self.truths.append(self._world.truth())
        if self._gauge is None and look.holding:
            self._gauge = SlipGauge(self._world.world, self._world.true_T_world_gripper())
        self._writer.add(look.frame, T_world_gripper=look.T_world_gripper)
        if sys.stderr.isatty():
            print(f"\r\033[K  frame {len(self.truths)}", end="", file=sys.stderr, flush=True)

    def stage(self, words: str) -> None:
        """Say what comes next, and when."""
        if self._observer is not None:
            self._observer.stage(words)
        tell(words, self._began)

    def arm(self) -> ArmRecord:
        """How the arm fared until now."""
        shares = limit_shares(self._motion)
        if self._gauge is None:
            return ArmRecord(None, None, shares)
        slip = self._gauge.slip(self._world.true_T_world_gripper())
        return ArmRecord(slip.translation_m, slip.rotation_rad, shares)

    def truth(self) -> JointTruth | None:
        """The true joint, one state for each frame that was written."""
        n = len(self._writer)
        if n == 0:
            return None
        states = np.array([float(truth.states[-1]) for truth in self.truths[:n]])
        return dataclasses.replace(self.truths[0], states=states)


def run_in_simulator(request: RunRequest, observer: Observer | None = None) -> SimulatedRun:
    """The episode; what was recorded stays readable when it is interrupted.

    Args:
        request: what to do.
        observer: is told of frames and stages as they come, before a frame is written.

    Raises:
        GraspFailed: it ended before the first frame.
        InputError: the object cannot be loaded.
        MotionInfeasible: the object has no place at which the arm could open it.
        OutputError: the recording cannot be written.
    """
    episode, interrupted = Episode(), False
    thing = request.object
    name = f"{thing.title}, seed {request.seed}"
    config, recording = request.config, request.folder / RECORDING
    with (
        opened_world(thing, request.seed, config.sim) as world,
        RecordingWriter(recording) as writer,
    ):
        if world.calibration is not None:
            writer.set_calibration(world.calibration)
        reporter = _Reporter(writer, world, observer)
        # The recording's name is what `akm-fg fit` calls it, so that the posteriors are the same.
        contact = world.T_world_grasp, world.pull_direction_world
        task = Task(str(recording), *contact, request.target)
        try:
            calibration = world.calibration
            stream = FrameStream(
                task.name, config.model_settings, request.stages, calibration=calibration
            )
            run_episode(world.arm, world.camera, task, episode, reporter, config.episode, stream)
        except KeyboardInterrupt:
            interrupted = True
            episode.failure = "interrupted"
        truth = reporter.truth()
        if truth is None or not episode.looks:
            if interrupted:
                raise KeyboardInterrupt
            raise GraspFailed(f"{name}: {episode.failure}; nothing was recorded")
        writer.set_truth(truth)
        if episode.grasp_frames is not None:
            writer.set_grasp_frames(*episode.grasp_frames)
        measured = _Measured(truth, float(world.truth().states[-1]), reporter.arm())
    fit, fitted = episode.fit, None
    if fit is not None:
        fitted = FittedRecording.of(fitted_recording(RECORDING, episode.looks, fit), fit)
    return SimulatedRun(_summary(request, name, episode, measured), fitted, interrupted)


@contextmanager
def opened_world(
    thing: ObjectArgument,
    seed: int,
    sim: SimulatorConfig,
    placement: PlacementMode = "reachable",
    locked: bool = False,
) -> Iterator[SimEpisode]:
    """The world of an object as the settings have it; see `sim.episode.open_world`.

    Where the camera errs, its depth is corrected by what it measures of the arm.
    """
    with open_world(
        thing.name,
        seed,
        joint=thing.joint,
        import_options=thing.options,
        world_config=sim.world,
        franka_config=sim.franka,
        camera_config=sim.camera,
        view=sim.view if placement == "reachable" else None,
        rig=sim.rig,
        placement=placement,
        locked=locked,
    ) as world:
        yield _with_corrected_depth(world, sim.depth_from_arm)


def _with_corrected_depth(world: SimEpisode, config: DepthFromArmConfig) -> SimEpisode:
    if world.calibration is None:
        return world
    q, fingers_m = world.arm.measured_joints()[0], world.arm.gripper.opening_m() / 2.0
    arm = world.world.arm_description
    correction = correct_by_arm(world.camera, arm, q, fingers_m, world.calibration, config)
    if correction is None:
        return world
    print(correction.words(), file=sys.stderr, flush=True)
    return dataclasses.replace(world, calibration=correction.left(world.calibration))


@dataclass(frozen=True, slots=True)
class _Measured:
    """What the simulator knows. For scoring alone."""

    truth: JointTruth  # a state for each frame
    final_state: float  # when all motion had ended, m or rad
    arm: ArmRecord


def _summary(request: RunRequest, name: str, episode: Episode, measured: _Measured) -> RunSummary:
    fit, n = episode.fit, len(episode.looks)
    name_of_kind, wanted = next(iter(request.target.items()))
    kind = JointKind(name_of_kind)
    tracks = None
    if fit is not None:
        parts = fit.observed.segmentation
        tracks = PartTracks(fit.observed.pixels, parts.moving, parts.static)
    turn = episode.closed_loop_frame
    return RunSummary(
        title=name,
        command=f"{request.command}\n{_replay(request, episode)}",
        seed=request.seed,
        version=__version__,
        recording=episode.recording(RECORDING),
        tracks=tracks,
        posterior=None if fit is None else fit.posterior,
        truth=measured.truth,
        goal=Goal(wanted, request.config.episode.tolerance(kind), kind.unit),
        rounds=tuple(episode.rounds),
        final_state_true=measured.final_state - float(measured.truth.states[0]),
        arm=measured.arm,
        closed_loop_frame=None if turn is None or turn >= n else turn,
        time_s=dict(episode.time_s),
        failure=episode.failure,
    )


def _replay(request: RunRequest, episode: Episode) -> str:
    """The command that gives the posterior again; it may be of fewer frames than there are."""
    states = None if episode.fit is None else episode.fit.posterior.best.states
    part = states is not None and len(states.mean) < len(episode.looks)
    frames = f" --frames {len(states.mean)}" if states is not None and part else ""
    config, usual = request.config, AkmConfig()
    read_by_fit = ("stages", "perception", "fit", "stream")
    same = all(getattr(config, x) == getattr(usual, x) for x in read_by_fit)
    settings = "" if same else f" --config {request.folder / CONFIG}"
    return f"akm-fg fit {request.folder / RECORDING}{frames}{settings} --json -"
