"""One run in the simulator: a model, by exploring if there is none, and the way to the target."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import gtsam
import numpy as np

from akm_fg.cli.exploring.kept import Explored
from akm_fg.cli.exploring.simulated import ExploreRequest, explore_in_simulator
from akm_fg.cli.exploring.stages import perceiver_of
from akm_fg.cli.running.recorder import RECORDING, RunRecorder
from akm_fg.cli.simulated_run import limit_shares, opened_world
from akm_fg.errors import AkmError, InputError
from akm_fg.exploration.records import Contact
from akm_fg.interfaces import Camera
from akm_fg.io.recording_writer import RecordingWriter
from akm_fg.manipulation.manipulate import Manipulator
from akm_fg.manipulation.records import Goal, Manipulation
from akm_fg.manipulation.refinement import refined
from akm_fg.manipulation.watch import Watch
from akm_fg.model.naming import PartName, part_named
from akm_fg.model.read import read_model
from akm_fg.model.records import Contact as HeldContact
from akm_fg.model.records import ModelPart, ObjectModel, StateLimits
from akm_fg.model.write import write_model
from akm_fg.records import FloatArray, JointTruth, RgbdFrame
from akm_fg.relocalization.several import Beside, FollowedPart
from akm_fg.report.score import axis_angle_rad, line_distance_m
from akm_fg.stream.frame_stream import FrameStream
from factors.joint import Unit
from sim.episode import SimEpisode

# Openings that ordinary drawers and doors have: of a demonstration that names none.
USUAL: dict[Unit, float] = {"m": 0.20, "rad": float(np.deg2rad(35.0))}


@dataclass(frozen=True, slots=True)
class ManipulateRequest:
    """What to do with a part of which object, and where to write."""

    explore: ExploreRequest  # the object, the folder and the settings; explored if `model` is None
    # Opening from closed; None: what is usual for the kind that the joint turns out to be.
    target: tuple[float, Unit] | None
    tolerance: tuple[float, Unit] | None = None
    part: PartName | None = None
    model: Path | None = None
    start: float | None = None  # true state in which the part is put, m or rad; None: as it is
    learn: bool = True


@dataclass(slots=True)
class Ran:
    """What came of it."""

    folder: Path
    explored: Explored | None = None
    model: ObjectModel | None = None  # as it was when the manipulation began
    number: int = 0  # of the part in the model
    goal: Goal | None = None
    manipulation: Manipulation = field(default_factory=Manipulation)
    beside: dict[str, Beside | None] = field(default_factory=dict)  # the other parts; None: unseen
    truth: JointTruth | None = None  # a state for each look; for scoring alone
    final_state: float | None = None  # true, when all motion had ended, from closed
    start_state: float | None = None  # true, when the manipulation began
    pressed_n: float = 0.0
    limit_shares: dict[str, float] = field(default_factory=dict)
    learned: str | None = None  # one line
    model_path: Path | None = None
    failure: str | None = None
    interrupted: bool = False
    cpu_s: float = 0.0  # of the manipulation, processor time

    @property
    def part(self) -> ModelPart | None:
        """That is moved."""
        return None if self.model is None else self.model.parts[self.number]

    @property
    def reached(self) -> bool:
        """By the program's own belief."""
        return self.goal is not None and self.failure is None and not self.interrupted


Watching = Callable[[SimEpisode], Camera]  # the camera that a run looks through


def run_in_simulator(request: ManipulateRequest, through: Watching | None = None) -> Ran:
    """The run; what was recorded stays readable when it is interrupted.

    Args:
        request: what to do.
        through: what the manipulation sees, where it is not the world's own camera: for trials of
            what may go wrong.

    Raises:
        InputError: the object or model cannot be loaded, or the settings cannot be used.
        OutputError: something cannot be written.
    """
    ran = Ran(request.explore.folder)
    wanted = request.explore
    if request.model is not None:
        model = read_model(request.model)
        with opened_world(wanted.object, wanted.seed, wanted.config.sim, "published") as world:
            _manipulate(request, world, model, ran, through)
        return ran

    def go_on(world: SimEpisode, explored: Explored) -> None:
        ran.explored = explored
        if explored.interrupted:
            ran.interrupted, ran.failure = True, "interrupted"
            return
        if explored.model is None:
            notes = explored.exploration.notes
            ran.failure = explored.exploration.failure or "; ".join(notes) or "nothing was opened"
            return
        _manipulate(request, world, read_model(explored.model), ran, through)

    ran.explored = explore_in_simulator(wanted, go_on)
    return ran


def _manipulate(
    request: ManipulateRequest,
    world: SimEpisode,
    model: ObjectModel,
    ran: Ran,
    through: Watching | None,
) -> None:
    """Take the part to its target, and keep what was learned."""
    ran.model, began = model, time.process_time()
    ran.number = part_named(model, request.part, frame=world.camera.capture())
    part = model.parts[ran.number]
    number = true_number(world, part)
    if request.start is not None:
        try:
            world.world.put_part(request.start, number)
        except ValueError as error:
            told = "a state that the robot's base leaves room for"
            raise InputError(
                "--start", f"is {request.start:g} {part.joint.kind.unit}", told
            ) from error
    ran.start_state = world.world.part_state(number)
    ran.goal, ran.failure = goal_of(request, part)
    if ran.failure is not None:
        return
    assert ran.goal is not None
    config, motion = request.explore.config, world.arm.record()
    stream = _stream(request, world)
    camera = world.camera if through is None else through(world)
    with RecordingWriter(request.explore.folder / RECORDING) as writer:
        recorder = RunRecorder(writer, world, part.joint.kind.unit, number)
        follower = FollowedPart(
            model, ran.number, config.perception.observe.noise, config.relocalization
        )
        watch = Watch(
            world.arm, camera, follower, part, ran.goal, ran.manipulation, recorder,
            config.manipulate, stream,
        )  # fmt: skip
        manipulator = Manipulator(
            world.arm, watch, part, ran.goal, ran.manipulation, config.manipulate,
            _FreshGrasps(request.explore),
        )  # fmt: skip
        try:
            manipulator.run()
            ran.failure = ran.manipulation.failure
        except KeyboardInterrupt:
            ran.interrupted, ran.failure = True, "interrupted"
        ran.beside = follower.beside
        recorder.finish()
        ran.truth, ran.pressed_n = recorder.truth(), recorder.pressed_n
    ran.final_state = world.world.part_state(number)
    ran.limit_shares = limit_shares(motion)
    ran.cpu_s = time.process_time() - began
    if not ran.interrupted:
        _keep_learned(request, world, stream, ran)


def goal_of(request: ManipulateRequest, part: ModelPart) -> tuple[Goal | None, str | None]:
    """The goal in the model's states, or why this part cannot have it."""
    own = part.joint.kind.unit
    opening, unit = request.target or (USUAL[own], own)
    if unit != own:
        does = "turns" if own == "rad" else "slides"
        given = f"{opening:g} m" if unit == "m" else f"{np.rad2deg(opening):g} deg"
        wants = "degrees (35deg)" if own == "rad" else "metres (0.25)"
        return None, f"the part {does}: {given} is no target for it; expected {wants}"
    tolerance = request.explore.config.manipulate.tolerance(part.joint.turns)
    if request.tolerance is not None:
        tolerance, unit = request.tolerance
        if unit != own:
            return None, "the tolerance is not in the unit of the target"
    low, high = part.range_seen()
    opens = 1.0 if high - part.closed_state >= part.closed_state - low else -1.0
    return Goal(part.closed_state + opens * opening, tolerance), None


def true_number(world: SimEpisode, part: ModelPart) -> int:
    """Which of the simulator's parts a part of a model is most like. For scoring alone."""

    def off(number: int) -> float:
        truth = world.world.truth(number)
        apart = axis_angle_rad(part.joint.axis, truth.axis)
        if part.joint.pivot is not None and truth.pivot is not None:
            apart += line_distance_m(part.joint.pivot, part.joint.axis, truth.pivot, truth.axis)
        return apart + (str(truth.kind) != str(part.joint.kind))

    return min(range(world.world.parts), key=off)


def _stream(request: ManipulateRequest, world: SimEpisode) -> FrameStream | None:
    if not request.learn:
        return None
    asked = request.explore
    return FrameStream(
        str(asked.folder / RECORDING),
        asked.config.model_settings,
        asked.stages,
        calibration=world.calibration,
    )


class _FreshGrasps:
    """Grasps about a place, by the sampler of the settings."""

    def __init__(self, request: ExploreRequest) -> None:
        config = replace(
            request.config, explore=replace(request.config.explore, contact_analogy=False)
        )
        self._perceiver = perceiver_of(config, request.stages, None, [])

    def __call__(
        self, frame: RgbdFrame, p_world: FloatArray, normal_world: FloatArray
    ) -> Sequence[gtsam.Pose3]:
        contact = Contact(p_world, np.zeros(2), normal_world, 0, 1.0)
        return self._perceiver.grasps(frame, contact)


def _keep_learned(
    request: ManipulateRequest, world: SimEpisode, stream: FrameStream | None, ran: Ran
) -> None:
    """Write the model anew with what the manipulation told, beside the old one."""
    part, model, run = ran.part, ran.model, ran.manipulation
    assert part is not None and model is not None
    part = _with_holds(_with_stop(part, run), run)
    if stream is None:
        ran.learned = "nothing learned: it was not asked for"
    elif not run.rounds:
        ran.learned = "nothing learned: nothing was moved"
    else:
        try:
            told = refined(
                part, stream.posterior(), world.calibration, model.camera, model.T_world_cam
            )
            part, ran.learned = told.part, told.note
        except AkmError as error:
            ran.learned = f"nothing learned: {error}"
    sources = dict.fromkeys([*model.sources, str(request.explore.folder / RECORDING)])
    new = replace(model.with_part(part), sources=tuple(sources))
    ran.model_path = write_model(request.explore.folder, new)


def _with_stop(part: ModelPart, run: Manipulation) -> ModelPart:
    """With a limit that the run met on its way open; that of the other end stays closed."""
    if run.stop is None or not run.stop.opening:
        return part
    low, high = sorted((part.closed_state, run.stop.state))
    if high <= low:
        return part
    return replace(part, limits=StateLimits(low, high, max(run.stop.sd, 0.0)))


def _with_holds(part: ModelPart, run: Manipulation) -> ModelPart:
    """With the grasps of the handle that held."""
    held = [
        HeldContact(
            part.T_world_part(hold.state).inverse() * hold.T_world_gripper, hold.state, succeeded=1
        )
        for hold in run.holds
        if not hold.by_edge
    ]
    return replace(part, contacts=(*part.contacts, *held))
