"""`akm-fg demo`: the main job on an embedded object, with a report."""

from __future__ import annotations

import dataclasses
import importlib.util
import json as json_module
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from akm_fg import __version__
from akm_fg.cli.exit_codes import DONE, GOAL_NOT_REACHED, INTERRUPTED
from akm_fg.cli.output import json_output, write_line
from akm_fg.cli.target import parse_target
from akm_fg.errors import GraspFailed, InputError, MissingDependency, OutputError
from akm_fg.records import JointTruth

if TYPE_CHECKING:
    import gtsam

    from akm_fg.closed_loop import Episode, EpisodeConfig
    from akm_fg.io.recording_writer import RecordingWriter
    from akm_fg.records import RgbdFrame
    from akm_fg.report.summary import RunSummary
    from sim.episode import SimEpisode

_DEFAULT_TARGET = {"door": "35deg", "drawer": "0.20"}
_UNIT_OF = {"door": "rad", "drawer": "m"}
_KIND_OF_UNIT = {"rad": "revolute", "m": "prismatic"}


@dataclass(frozen=True)
class DemoArguments:
    """Example: akm-fg demo --object drawer --target 0.25 --seed 3

    A simulated Franka grasps the handle of a cabinet, pulls, finds out from RGB-D what moved and
    how, and drives the part to a target state. Writes a folder with the recording, the posterior
    and report.html. The exit code is 1 when the target was not reached.
    """

    object: Literal["door", "drawer"] = "door"
    """What the robot meets."""
    target: str | None = None
    """Opening to reach from closed: metres (0.25) for the drawer, degrees (35deg) for the door."""
    seed: int = 0
    """Of the object, the camera's noise and the estimator's sampling."""
    out: Path = Path("runs")
    """Folder in which the run's own folder is made."""
    json: str | None = None
    """Write the run as one JSON object to this file; - is standard output (no table then)."""


@dataclass(frozen=True, slots=True)
class DemoSetting:
    """What a test makes smaller."""

    episode: EpisodeConfig | None = None  # None: the default
    image_scale: float = 1.0  # of 640 x 480 pixels


class _Reporter:
    """Writes frames and true states as they come, and says what happens."""

    def __init__(self, writer: RecordingWriter, world: SimEpisode) -> None:
        self._writer, self._world = writer, world
        self._began = time.perf_counter()
        self.truths: list[JointTruth] = []

    def frame(self, frame: RgbdFrame, T_world_gripper: gtsam.Pose3) -> None:
        """Keep the frame; the truth goes beside it, for scoring alone."""
        self._writer.add(frame, T_world_gripper=T_world_gripper)
        self.truths.append(self._world.truth())
        if sys.stderr.isatty():
            print(f"\r\033[K  frame {len(self.truths)}", end="", file=sys.stderr, flush=True)

    def stage(self, words: str) -> None:
        """Say what comes next, and when."""
        start = "\r\033[K" if sys.stderr.isatty() else ""
        seconds = time.perf_counter() - self._began
        print(f"{start}{seconds:6.1f} s  {words}", file=sys.stderr, flush=True)

    def truth(self) -> JointTruth | None:
        """The true joint, one state a frame."""
        if not self.truths:
            return None
        states = np.array([float(truth.states[-1]) for truth in self.truths])
        return dataclasses.replace(self.truths[-1], states=states)


def demo(arguments: DemoArguments, setting: DemoSetting | None = None) -> int:
    """Run the command; tests hand in a smaller setting.

    Raises:
        InputError: a target that cannot be read, or of the wrong unit.
        MissingDependency: the simulator is not installed.
        OutputError: the run's folder cannot be written.
    """
    began, setting = time.perf_counter(), setting or DemoSetting()
    target, unit = _target(arguments)
    _require_simulator()
    with json_output(arguments.json) as stream:
        folder = _make_folder(arguments)
        try:
            summary, interrupted = _run(arguments, folder, {_KIND_OF_UNIT[unit]: target}, setting)
        except GraspFailed as error:
            print(f"akm-fg: {error}", file=sys.stderr)
            return GOAL_NOT_REACHED
        summary.time_s["total"] = time.perf_counter() - began
        _write(folder, summary)
        if stream is not None:
            write_line(stream, json_module.dumps(_as_dict(summary), allow_nan=False))
    if arguments.json != "-":
        _print(summary, folder)
    if interrupted:
        return INTERRUPTED
    return DONE if summary.claims_reached else GOAL_NOT_REACHED


def _target(arguments: DemoArguments) -> tuple[float, str]:
    target, unit = parse_target(arguments.target or _DEFAULT_TARGET[arguments.object])
    if unit != _UNIT_OF[arguments.object]:
        wanted = "degrees (35deg)" if arguments.object == "door" else "metres (0.25)"
        raise InputError(
            "--target", f"{arguments.target} is not for a {arguments.object}", f"{wanted}"
        )
    return target, unit


def _require_simulator() -> None:
    absent = [m for m in ("pybullet", "pinocchio") if importlib.util.find_spec(m) is None]
    if absent:
        raise MissingDependency(
            f"the demo needs {' and '.join(absent)}; install akm-fg[sim] (Python 3.11)"
        )


def _make_folder(arguments: DemoArguments) -> Path:
    stamp = time.strftime("%Y%m%d-%H%M%S")
    base = arguments.out / f"{stamp}-{arguments.object}-{arguments.seed}"
    for attempt in range(100):
        folder = base if attempt == 0 else base.with_name(f"{base.name}-{attempt}")
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            if arguments.out.exists() and not arguments.out.is_dir():
                break
        except OSError as error:
            raise OutputError(
                f"{folder}: cannot be made ({error.strerror}); expected a writable folder"
            ) from error
    raise OutputError(f"{arguments.out}: is not a folder to write runs into")


def _run(
    arguments: DemoArguments, folder: Path, target: dict[str, float], setting: DemoSetting
) -> tuple[RunSummary, bool]:
    """The episode; what was recorded stays readable whenever it is interrupted."""
    from akm_fg.closed_loop import Episode, EpisodeConfig, Task, run_episode
    from akm_fg.io.recording_writer import RecordingWriter
    from sim.camera import CameraConfig
    from sim.episode import open_world

    name = f"{arguments.object}-{arguments.seed}"
    config = setting.episode or EpisodeConfig()
    episode, interrupted = Episode(), False
    camera = CameraConfig().scaled(setting.image_scale)
    with (
        open_world(arguments.object, arguments.seed, camera_config=camera) as world,
        RecordingWriter(folder / "recording") as writer,
    ):
        reporter = _Reporter(writer, world)
        task = Task(name, world.T_world_grasp, world.pull_direction_world, target, arguments.seed)
        try:
            run_episode(world.arm, world.camera, task, episode, reporter, config)
        except KeyboardInterrupt:
            interrupted = True
            episode.failure = "interrupted"
        truth = reporter.truth()
        if truth is None:  # it ended before the first frame
            if interrupted:
                raise KeyboardInterrupt
            raise GraspFailed(f"{name}: {episode.failure}; nothing was recorded")
        writer.set_truth(truth)
        writer.set_grasp_frames(0, len(episode.frames) - 1)
        final_state = float(world.truth().states[-1])
    return _summary(arguments, episode, truth, final_state, target, name, config), interrupted


def _summary(
    arguments: DemoArguments,
    episode: Episode,
    truth: JointTruth,
    final_state: float,
    target: dict[str, float],
    name: str,
    config: EpisodeConfig,
) -> RunSummary:
    from akm_fg.report.summary import Goal, PartTracks, RunSummary

    fit = episode.fit
    kind, wanted = next(iter(target.items()))
    command = f"akm-fg demo --object {arguments.object} --seed {arguments.seed}"
    if arguments.target is not None:
        command += f" --target {arguments.target}"
    return RunSummary(
        title=name,
        command=command,
        seed=arguments.seed,
        version=__version__,
        recording=episode.recording(name),
        tracks=None
        if fit is None
        else PartTracks(
            fit.observed.pixels, fit.observed.segmentation.moving, fit.observed.segmentation.static
        ),
        posterior=None if fit is None else fit.posterior,
        truth=truth,
        goal=Goal(wanted, config.tolerance(kind), "m" if kind == "prismatic" else "rad"),
        rounds=tuple(episode.rounds),
        final_state_true=final_state - float(truth.states[0]),
        closed_loop_frame=episode.closed_loop_frame,
        time_s=dict(episode.time_s),
        failure=episode.failure,
    )


def _write(folder: Path, summary: RunSummary) -> None:
    from akm_fg.io.posterior_json import posterior_as_line
    from akm_fg.report.write import write_report

    if summary.posterior is not None:
        path = folder / "posterior.json"
        try:
            path.write_text(posterior_as_line(summary.posterior) + "\n", encoding="utf-8")
        except OSError as error:
            raise OutputError(f"{path}: cannot be written ({error.strerror})") from error
    write_report(folder / "report.html", summary)


def _print(summary: RunSummary, folder: Path) -> None:
    from rich.console import Console

    from akm_fg.report.tables import score_table

    console = Console()
    if not console.is_terminal:
        console = Console(width=120)
    if summary.posterior is not None:
        console.print(score_table(summary))
    if summary.failure is not None:
        console.print(f"not reached: {summary.failure}")
    console.print(f"report: {folder / 'report.html'}", soft_wrap=True)


def _as_dict(summary: RunSummary) -> dict[str, Any]:
    """The run as JSON (`akm-fg/run/1`, docs/conventions.md)."""
    from akm_fg.io.posterior_json import posterior_as_dict

    last = summary.rounds[-1] if summary.rounds else None
    truth, posterior = summary.truth, summary.posterior
    return {
        "schema": "akm-fg/run/1",
        "object": summary.title,
        "seed": summary.seed,
        "explored": posterior is not None,
        "attempts": 1,
        "posterior": None if posterior is None else posterior_as_dict(posterior),
        "target": None if summary.goal is None else summary.goal.target,
        "rounds": max(len(summary.rounds) - 1, 0),
        "state": None if last is None else {"mean": last.state_mean, "sd": last.state_sd},
        "p_within_tolerance": None if last is None else last.p_within_tolerance,
        "truth": None
        if truth is None
        else {
            "kind": truth.kind,
            "axis": truth.axis.tolist(),
            "pivot": None if truth.pivot is None else truth.pivot.tolist(),
            "final_state": summary.final_state_true,
        },
        "time_s": summary.time_s,
        "failure": summary.failure,
    }
