"""One exploration in the simulator, every attempt recorded as it goes."""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from akm_fg import __version__
from akm_fg.cli.demo_config import DemoConfig
from akm_fg.cli.exploration_stages import perceiver_of
from akm_fg.cli.object_argument import ObjectArgument
from akm_fg.errors import InputError
from akm_fg.exploration.explore import Explorer, explore
from akm_fg.exploration.explore_json import exploration_as_dict, exploration_from_dict
from akm_fg.exploration.page import exploration_part
from akm_fg.exploration.records import Attempt, Exploration
from akm_fg.io.png import replace_file
from akm_fg.io.recording_writer import RecordingWriter
from akm_fg.looks import Look
from akm_fg.records import JointTruth, Recording
from akm_fg.report.summary import PartTracks, RunSummary
from akm_fg.report.write import write_report
from akm_fg.stages import Stages
from akm_fg.stream.frame_stream import FrameStream
from sim.episode import SimEpisode, open_world

CONFIG = "config.toml"
RESULT = "explore.json"
REPORT = "report.html"


@dataclass(frozen=True, slots=True)
class ExploreRequest:
    """What to explore, and where to write."""

    object: ObjectArgument
    name: str  # of the object, as the person wrote it
    seed: int
    locked: bool
    folder: Path
    config: DemoConfig
    stages: Stages
    command: str


@dataclass(slots=True)
class Explored:
    """What came of it."""

    exploration: Exploration
    truth: JointTruth  # a state for each look of the last attempt; for scoring alone
    folder: Path
    model: Path | None = None
    interrupted: bool = False

    def write(self, result: dict[str, Any]) -> None:
        """The result, whole or not at all.

        Raises:
            OutputError: the disk refuses.
        """
        write_result(self.folder, result)


def write_result(folder: Path, result: dict[str, Any]) -> None:
    """Write explore.json, whole or not at all."""
    text = json.dumps(result, allow_nan=False, indent=1) + "\n"
    replace_file(folder / RESULT, text.encode("utf-8"))


def read_request(folder: Path, name: str, seed: int) -> Exploration:
    """What an interrupted run had tried.

    Raises:
        InputError: the folder is not of such a run, or of another object or seed.
    """
    path = folder / RESULT
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            path, f"cannot be read ({error})", "the folder of an explore run"
        ) from error
    if not isinstance(data, dict) or (data.get("object"), data.get("seed")) != (name, seed):
        other = (
            f"{data.get('object')} with seed {data.get('seed')}" if isinstance(data, dict) else ""
        )
        raise InputError(path, f"is of {other or 'something else'}", f"{name} with seed {seed}")
    return exploration_from_dict(data, str(path))


def attempt_name(number: int) -> str:
    """The folder of the recording of an attempt, counted from 0, in the folder of the run."""
    return f"attempt-{number + 1:02d}"


class _Reporter:
    """Records attempts as they go, and says what happens."""

    def __init__(self, request: ExploreRequest, world: SimEpisode, result: Callable[[], None]):
        self._request, self._world, self._result = request, world, result
        self._began = time.perf_counter()
        self._first: Look | None = None  # of an attempt, kept until it has touched something
        self._writer: RecordingWriter | None = None
        self._held: list[int] = []
        self.truths: list[JointTruth] = []

    def begun(self, number: int, attempt: Attempt) -> None:
        """Say what is tried."""
        self._first, self._writer, self._held, self.truths = None, None, [], []
        self._number = number
        folder = self._folder()
        if folder.exists():  # of an attempt that was interrupted
            shutil.rmtree(folder)
        way = attempt.hypothesis.way
        self.stage(
            f"attempt {number + 1}: {attempt.contact.what} on front {attempt.contact.front}, "
            f"pull {way} (probability {attempt.probability:.2f})"
        )

    def looked(self, look: Look) -> None:
        """Write the frame; the truth goes beside it, for scoring alone."""
        self.truths.append(self._world.truth())
        if self._first is None:
            self._first = look
            return
        if self._writer is None:
            self._writer = RecordingWriter(self._folder())
            self._add(self._first)
            if self._world.calibration is not None:
                self._writer.set_calibration(self._world.calibration)
        self._add(look)

    def _folder(self) -> Path:
        return self._request.folder / attempt_name(self._number)

    def _add(self, look: Look) -> None:
        assert self._writer is not None
        if look.holding:
            self._held.append(len(self._writer))
        self._writer.add(look.frame, T_world_gripper=look.T_world_gripper)

    def stretched(self, attempt: Attempt) -> None:
        """Say what is known now."""
        stretch = attempt.stretches[-1]
        if stretch.bounds is None:
            return
        axis_deg = np.rad2deg(stretch.bounds.axis_rad)
        pivot = "" if stretch.bounds.pivot_m is None else f", {100 * stretch.bounds.pivot_m:.1f} cm"
        likely = max(stretch.kind_probability, key=stretch.kind_probability.__getitem__)
        self.stage(
            f"  {100 * stretch.travel_m:.0f} cm: {likely} {stretch.kind_probability[likely]:.3f}, "
            f"axis within {axis_deg:.1f} deg{pivot} (95 %)"
        )

    def ended(self, number: int, attempt: Attempt) -> None:
        """Close the recording."""
        if self._writer is not None:
            attempt.recording = attempt_name(number)
            self._finish()
        self.stage(f"  {attempt.outcome.replace('_', ' ')}: {attempt.reason}")
        self._result()

    def _finish(self) -> None:
        assert self._writer is not None
        n = len(self._writer)
        if n and self.truths:
            states = np.array([float(truth.states[-1]) for truth in self.truths[:n]])
            self._writer.set_truth(dataclasses.replace(self.truths[0], states=states))
        if self._held:
            run = [k for i, k in enumerate(self._held) if k == self._held[0] + i]
            self._writer.set_grasp_frames(run[0], run[-1])

    def truth(self) -> JointTruth:
        """The true joint, a state for each look of the last attempt; for scoring alone."""
        if not self.truths:
            return self._world.truth()
        states = np.array([float(truth.states[-1]) for truth in self.truths])
        return dataclasses.replace(self.truths[0], states=states)

    def stage(self, words: str) -> None:
        """Say what comes next, and when."""
        seconds = time.perf_counter() - self._began
        print(f"{seconds:6.1f} s  {words}", file=sys.stderr, flush=True)


def explore_in_simulator(request: ExploreRequest) -> Explored:
    """The exploration; what was tried stays readable when it is interrupted.

    Raises:
        InputError: the object cannot be loaded, or the settings cannot be used.
        OutputError: something cannot be written.
    """
    exploration = Exploration()
    if (request.folder / RESULT).exists():
        exploration = read_request(request.folder, request.name, request.seed)
    config = request.config

    def keep() -> None:
        told = {"object": request.name, "seed": request.seed, **exploration_as_dict(exploration)}
        write_result(request.folder, told)

    with _opened(request) as world:
        reporter = _Reporter(request, world, keep)
        family = getattr(request.object.spec(request.seed), "family", None)
        perceived = perceiver_of(config, request.stages, family, exploration.notes)

        def stream(number: int) -> FrameStream:
            return FrameStream(
                str(request.folder / attempt_name(number)),
                config.model_settings,
                request.stages,
                calibration=world.calibration,
            )

        explorer = Explorer(
            perceived.contacts, perceived.grasps, stream, config.explore, request.seed
        )
        explored = Explored(exploration, world.truth(), request.folder)
        try:
            explore(world.arm, world.camera, explorer, exploration, reporter)
        except KeyboardInterrupt:
            explored.interrupted = True
            exploration.failure = "interrupted"
        explored.truth = reporter.truth()
    keep()
    if exploration.first_look is not None:
        _write_report(request, explored)
    return explored


def _write_report(request: ExploreRequest, explored: Explored) -> None:
    exploration, config = explored.exploration, request.config
    looks, fit = exploration.looks, exploration.fit
    if exploration.first_look is not None and not looks:
        looks = []
    frames = tuple(look.frame for look in looks) or (exploration.first_look,)
    name = attempt_name(max(len(exploration.attempts) - 1, 0))
    recording = Recording(name, tuple(frame for frame in frames if frame is not None))
    tracks = None
    if fit is not None:
        parts = fit.observed.segmentation
        tracks = PartTracks(fit.observed.pixels, parts.moving, parts.static)
    truth = explored.truth if len(explored.truth.states) == len(recording.frames) else None
    summary = RunSummary(
        title=f"{request.object.title}, seed {request.seed}",
        command=request.command,
        seed=request.seed,
        version=__version__,
        recording=recording,
        tracks=tracks,
        posterior=None if fit is None else fit.posterior,
        truth=truth,
        time_s=dict(exploration.time_s),
        failure=exploration.failure,
    )
    part = exploration_part(exploration, config.explore)
    write_report(request.folder / REPORT, summary, config.overlay, introduction=part)


def _opened(request: ExploreRequest) -> AbstractContextManager[SimEpisode]:
    thing, sim = request.object, request.config.sim
    return open_world(
        thing.name,
        request.seed,
        joint=thing.joint,
        world_config=sim.world,
        franka_config=sim.franka,
        camera_config=sim.camera,
        rig=sim.rig,
        placement="published",
        locked=request.locked,
    )
