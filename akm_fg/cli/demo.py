"""`akm-fg demo`: the main job on a simulated object, with a report."""

from __future__ import annotations

import importlib.util
import json as json_module
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from akm_fg.cli.console.lines import complain, console
from akm_fg.cli.exit_codes import DONE, GOAL_NOT_REACHED, INTERRUPTED
from akm_fg.cli.object_argument import ObjectArgument, parse_object
from akm_fg.cli.output import json_output, write_line
from akm_fg.cli.target import Unit, parse_target
from akm_fg.errors import GraspFailed, InputError, MissingDependency, OutputError
from akm_fg.report.wording import printable

if TYPE_CHECKING:
    from akm_fg.cli.demo_config import DemoConfig
    from akm_fg.cli.running.run import RunArguments
    from akm_fg.cli.simulated_run import SimulatedRun
    from akm_fg.closed_loop import Observer
    from akm_fg.report.summary import RunSummary
    from sim.objects.part_spec import Mechanism, PartSpec

_USUAL_TARGET_M = 0.20
_USUAL_TARGET_RAD = float(np.deg2rad(35.0))
_SHARE_OF_RANGE = 0.8  # of a range that ends before the usual target


@dataclass(frozen=True)
class DemoArguments:
    """Example: akm-fg demo --object drawer --target 0.25 --seed 3

    A simulated Franka looks at a cabinet that it has never seen, tries where it opens, finds out
    from RGB-D what moved and how, and drives the part to a target state, as akm-fg run does. With
    --contact given a grasp of the handle is handed to it instead. Writes a folder with the
    recordings, the model and report.html. The exit code is 1 when the target was not reached.
    """

    object: str = "door"
    """What the robot meets: door, drawer, SUITE/NAME (akm-fg objects lists them), a URDF file, or
    the folder of a PartNet-Mobility object."""
    contact: Literal["explored", "given"] = "explored"
    """Where to take hold: found out by exploring, or given."""
    joint: str | None = None
    """Of a file or folder: the joint that is free, where several move."""
    scale: float | None = None
    """Of a file or folder: what every length in it is multiplied by, such as 0.001 for one in
    millimetres. If absent 1 for a URDF file, and for a folder what its category's size gives."""
    allow: Path | None = None
    """Of a file or folder: one more folder from which its meshes may be taken."""
    target: str | None = None
    """Opening to reach from closed: metres (0.25) where it slides, degrees (35deg) where it turns.
    If absent 0.20 or 35deg; with a given contact 0.8 of the range where that is less."""
    seed: int = 0
    """Of the object and the camera's noise."""
    out: Path = Path("runs")
    """Folder in which the run's own folder is made."""
    json: str | None = None
    """Write the run as one JSON object to this file; - is standard output (no table then)."""
    config: Path | None = None
    """TOML file with settings that differ from the defaults, such as sim.camera.focal_px = 450.0.
    All settings of a run are written to config.toml in its folder."""
    tracker: str | None = None
    """What follows points: flow, or another file of akm_fg/backends/trackers."""
    segmenter: str | None = None
    """What finds the object: depth, or another file of akm_fg/backends/segmenters."""
    rig_errors: bool = False
    """Camera and arm err as real ones do (hand-eye 1 mm and 0.1 deg, focal length 0.2 %, depth 1 %
    and 1 mm, joints 0.05 deg), drawn by the seed; how much they may is sim.rig in --config."""


@dataclass(frozen=True, slots=True)
class DemoRun:
    """What one demo did."""

    folder: Path
    summary: RunSummary | None  # None: it ended before the first frame
    code: int  # of the command


def demo(arguments: DemoArguments, config: DemoConfig | None = None) -> int:
    """Run the command.

    Args:
        arguments: of the command line.
        config: what `--config` and the flags change; the defaults if absent.

    Raises:
        InputError: a target that cannot be read, or of the wrong unit; a configuration that
            cannot be used.
        MissingDependency: the simulator is not installed.
        OutputError: the run's folder cannot be written.
    """
    if arguments.contact == "explored":
        return _explored(arguments, config)
    return run_demo(arguments, config).code


def _explored(arguments: DemoArguments, config: DemoConfig | None) -> int:
    """Explore, model, run to the target, report."""
    from akm_fg.cli.running.run import carried_out, run_request

    target = None if arguments.target is None else parse_target(arguments.target)
    if target is not None and target[0] < 0:
        raise InputError("--target", f"is {arguments.target}", "an opening from closed, 0 or more")
    require_simulator()
    thing = parse_object(arguments.object, arguments.joint, arguments.scale, arguments.allow)
    if target is not None:
        _require_some_part(arguments, target, thing.spec(arguments.seed))
    request = run_request(_as_run(arguments), config, _command(arguments, thing), "demo")
    return carried_out(replace(request, target=target), arguments.json)


def _as_run(arguments: DemoArguments) -> RunArguments:
    """The flags that a run has too; the target is the caller's."""
    from akm_fg.cli.running.run import RunArguments

    names = ("object", "joint", "scale", "allow", "seed", "out", "config", "tracker", "segmenter",
             "rig_errors")  # fmt: skip
    return RunArguments(target="0", **{name: getattr(arguments, name) for name in names})


def run_demo(
    arguments: DemoArguments,
    config: DemoConfig | None = None,
    observer: Observer | None = None,
) -> DemoRun:
    """As `demo`; an observer is told of frames and stages as they come, before they are kept."""
    began = time.perf_counter()
    wanted = None if arguments.target is None else parse_target(arguments.target)
    require_simulator()
    from akm_fg.backends.registry import stages_of
    from akm_fg.cli.config_argument import CONFIG, write_tree
    from akm_fg.cli.demo_config import demo_config
    from akm_fg.cli.simulated_run import RunRequest, run_in_simulator

    config = demo_config(arguments, config)
    stages = stages_of(config)
    thing = parse_object(arguments.object, arguments.joint, arguments.scale, arguments.allow)
    target = wanted_state(arguments, wanted, thing.spec(arguments.seed))
    with json_output(arguments.json) as stream:
        folder = make_run_folder(arguments.out, f"{thing.label}-{arguments.seed}")
        command = _command(arguments, thing)
        write_tree(folder / CONFIG, config, f"All settings of {command}")
        request = RunRequest(thing, arguments.seed, target, folder, command, config, stages)
        try:
            ran = run_in_simulator(request, observer)
        except GraspFailed as error:
            complain(str(error))
            return DemoRun(folder, None, GOAL_NOT_REACHED)
        summary = ran.summary
        summary.time_s["total"] = time.perf_counter() - began
        _write(folder, ran, config)
        if stream is not None:
            line = json_module.dumps(_as_dict(arguments.object, summary), allow_nan=False)
            write_line(stream, line)
    if arguments.json != "-":
        _print(summary, folder)
    reached = DONE if summary.claims_reached else GOAL_NOT_REACHED
    return DemoRun(folder, summary, INTERRUPTED if ran.interrupted else reached)


def require_simulator(what: str = "the demo") -> None:
    """Refuse to go on without the simulator.

    Raises:
        MissingDependency: it is not installed.
    """
    absent = [m for m in ("pybullet", "pinocchio") if importlib.util.find_spec(m) is None]
    if absent:
        raise MissingDependency(
            f"{what} needs {' and '.join(absent)}; install akm-fg[sim] (Python 3.11)"
        )


def _require_some_part(
    arguments: DemoArguments, wanted: tuple[float, Unit], spec: PartSpec
) -> None:
    """Refuse a target that no part of the object has, before minutes are spent on it.

    Raises:
        InputError: in the words of the first part.
    """
    from sim.objects.part_spec import mechanisms

    problem: InputError | None = None
    for part in mechanisms(spec):
        try:
            wanted_state(arguments, wanted, part)
        except InputError as error:
            problem = problem or error
        else:
            return
    assert problem is not None
    raise problem


def wanted_state(
    arguments: DemoArguments, wanted: tuple[float, Unit] | None, spec: Mechanism
) -> dict[str, float]:
    """Wanted state of the object's kind of joint: what was asked for, or what is in its range."""
    turns = spec.kind == "revolute"
    if wanted is None:
        usual = _USUAL_TARGET_RAD if turns else _USUAL_TARGET_M
        return {spec.kind: min(usual, _SHARE_OF_RANGE * spec.upper)}
    target, unit = wanted
    if unit != ("rad" if turns else "m"):
        raise InputError(
            "--target",
            f"{arguments.target} is not for {arguments.object}, whose joint is {spec.kind}",
            "degrees (35deg)" if turns else "metres (0.25)",
        )
    if not 0.0 <= target <= spec.upper:
        end = f"{np.degrees(spec.upper):.0f}deg" if turns else f"{spec.upper:.2f}"
        told = f"{arguments.target} is outside the range of {arguments.object}"
        raise InputError("--target", told, f"0 to {end}")
    return {spec.kind: target}


def _command(arguments: DemoArguments, thing: ObjectArgument) -> str:
    words = f"akm-fg demo {thing.words} --seed {arguments.seed}"
    words += " --contact given" if arguments.contact == "given" else ""
    for flag in ("target", "config", "tracker", "segmenter"):
        given = getattr(arguments, flag)
        words += "" if given is None else f" --{flag} {given}"
    return words + (" --rig-errors" if arguments.rig_errors else "")


def make_run_folder(out: Path, name: str) -> Path:
    """A new folder in `out`, named by the time and by what runs.

    Raises:
        OutputError: it cannot be made.
    """
    base = out / f"{time.strftime('%Y%m%d-%H%M%S')}-{name}"
    for attempt in range(100):
        folder = base if attempt == 0 else base.with_name(f"{base.name}-{attempt}")
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            if out.exists() and not out.is_dir():
                break
        except OSError as error:
            raise OutputError(
                f"{folder}: cannot be made ({error.strerror}); expected a writable folder"
            ) from error
    raise OutputError(f"{out}: is not a folder to write runs into")


def _write(folder: Path, ran: SimulatedRun, config: DemoConfig) -> None:
    from akm_fg.cli.fitting.folder import keep_model
    from akm_fg.io.png import replace_file
    from akm_fg.io.posteriors.posterior_json import posterior_as_line
    from akm_fg.report.write import write_report
    from akm_fg.view.embedded import embedded_view

    summary = ran.summary
    if summary.posterior is not None:
        line = posterior_as_line(summary.posterior) + "\n"
        replace_file(folder / "posterior.json", line.encode())
    model = None if ran.fitted is None else keep_model(folder, ran.fitted, config)
    view = None if model is None else embedded_view(model, summary.title)
    write_report(folder / "report.html", summary, config.overlay, view=view)


def _print(summary: RunSummary, folder: Path) -> None:
    from akm_fg.report.tables import score_table

    out = console()
    if summary.posterior is not None:
        out.print(score_table(summary, plain=out.options.ascii_only))
    if summary.failure is not None:
        out.print(f"not reached: {summary.failure}", soft_wrap=True)
    report = printable(str(folder / "report.html"))
    out.print(f"report: {report}", soft_wrap=True)


def _as_dict(name: str, summary: RunSummary) -> dict[str, Any]:
    """The run as JSON (`akm-fg/run/1`, docs/conventions.md)."""
    from akm_fg.io.posteriors.posterior_json import posterior_as_dict

    last = summary.rounds[-1] if summary.rounds else None
    truth, posterior = summary.truth, summary.posterior
    return {
        "schema": "akm-fg/run/1",
        "object": name,
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
            "slip_m": None if summary.arm is None else summary.arm.slip_m,
            "slip_rad": None if summary.arm is None else summary.arm.slip_rad,
        },
        "time_s": summary.time_s,
        "failure": summary.failure,
    }
