"""`akm-fg run`: move a part of a simulated object to a target."""

from __future__ import annotations

import json as json_module
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from akm_fg.cli.demo import require_simulator
from akm_fg.cli.exit_codes import DONE, GOAL_NOT_REACHED, INTERRUPTED
from akm_fg.cli.output import json_output, write_line
from akm_fg.cli.target import parse_target
from akm_fg.errors import InputError

if TYPE_CHECKING:
    from akm_fg.cli.demo_config import DemoConfig
    from akm_fg.cli.running.simulated import ManipulateRequest, Ran


@dataclass(frozen=True)
class RunArguments:
    """Example: akm-fg run furniture-dev/door-003 --target 30deg

    A simulated Franka explores an object that it has never seen (or reads the model that an
    earlier run left), finds out where the part is, takes hold and moves it to the target, as far
    at a time as the covariance of the joint bears, and ends when it is sure enough. Writes a
    folder with the recordings, report.html and the model with what was learned. The exit code is 1
    when the target was not reached.
    """

    object: Annotated[str, tyro.conf.Positional]
    """What the robot meets: SUITE/NAME (akm-fg objects lists them), door, drawer, a URDF file, or
    the folder of a PartNet-Mobility object."""
    target: str
    """Opening to reach, from closed: metres (0.25) where it slides, degrees (35deg) where it
    turns. Nobody tells which it is: a target of the wrong unit ends the run with 1."""
    tolerance: str | None = None
    """Of the target, as it is written: 0.005, 5mm or 0.5deg. If absent manipulate.tolerance_m or
    tolerance_rad of the settings: 1 cm, 1.5 deg."""
    part: str | None = None
    """Which part of the model: number or name, a pixel U,V of the camera's picture, or a point
    X,Y,Z in metres; needed where it has several."""
    model: Path | None = None
    """A model.json, or its folder, that explore or run left of the same object and seed; if absent
    the object is explored first."""
    start: str | None = None
    """Of the simulated object: where the part stands when the manipulation begins, moved while
    nobody looked; for trials."""
    planner: Literal["covariance", "blind"] = "covariance"
    """How far a move goes: as far as the covariance bears, or fixed steps (the baseline)."""
    joint: str | None = None
    """Of a file or folder: the joint that is free, where several move."""
    scale: float | None = None
    """Of a file or folder: what every length in it is multiplied by."""
    allow: Path | None = None
    """Of a file or folder: one more folder from which its meshes may be taken."""
    seed: int = 0
    """Of the object and the camera's noise."""
    rig_errors: bool = False
    """Camera and arm err as a calibrated rig does; the seed draws by how much."""
    out: Path = Path("runs")
    """Folder in which the run's own folder is made."""
    json: str | None = None
    """Write the run as one JSON object to this file; - is standard output."""
    config: Path | None = None
    """TOML file with settings that differ from the defaults."""
    tracker: str | None = None
    """What follows points: flow, or another file of akm_fg/backends/trackers."""
    segmenter: str | None = None
    """What finds the object: depth, or another file of akm_fg/backends/segmenters."""


def run(arguments: RunArguments, config: DemoConfig | None = None) -> int:
    """Run the command.

    Args:
        arguments: of the command line.
        config: what `--config` and the flags change; the defaults if absent.

    Raises:
        InputError: no such object, model or part; a number or settings that cannot be used.
        MissingDependency: the simulator is not installed.
        OutputError: the run's folder cannot be written.
    """
    require_simulator("the run")
    return carried_out(run_request(arguments, config), arguments.json)


def carried_out(request: ManipulateRequest, json: str | None) -> int:
    """Carry out a request, write what came of it, and say so; the exit code comes back.

    Raises:
        InputError: the object or the model cannot be used.
        OutputError: something cannot be written.
    """
    from akm_fg.cli.running.outcome import run_as_dict, write_run_report
    from akm_fg.cli.running.simulated import run_in_simulator

    began = time.perf_counter()
    with json_output(json) as stream:
        ran = run_in_simulator(request)
        title = f"{request.explore.object.title}, seed {request.explore.seed}"
        report = write_run_report(request, ran, title)
        result = run_as_dict(request, ran, time.perf_counter() - began)
        if stream is not None:
            write_line(stream, json_module.dumps(result, allow_nan=False))
    if json != "-":
        _print(request, ran, report)
    if ran.interrupted:
        return INTERRUPTED
    return DONE if ran.reached else GOAL_NOT_REACHED


def run_request(
    arguments: RunArguments,
    config: DemoConfig | None = None,
    command: str | None = None,
    what: str = "run",
) -> ManipulateRequest:
    """What is to be done, and the folder for it.

    Args:
        arguments: of the command line.
        config: what `--config` and the flags change; the defaults if absent.
        command: that repeats it, where it is not run's own.
        what: the command's name, for the folder.

    Raises:
        InputError: a target, part or model that cannot be used.
    """
    from akm_fg.cli.exploring.explore import (
        ALL_PARTS,
        ExploreArguments,
        explore_request,
        simulated_default,
    )
    from akm_fg.cli.running.simulated import ManipulateRequest
    from akm_fg.model.naming import part_name
    from akm_fg.model.read import read_model

    target = parse_target(arguments.target)
    if target[0] < 0:
        raise InputError("--target", f"is {arguments.target}", "an opening from closed, 0 or more")
    tolerance = None if arguments.tolerance is None else parse_target(arguments.tolerance)
    if tolerance is not None and (tolerance[0] <= 0 or tolerance[1] != target[1]):
        said = f"{arguments.tolerance} for a target of {arguments.target}"
        raise InputError("--tolerance", said, "more than 0, in the target's unit")
    start = None if arguments.start is None else parse_target(arguments.start)
    if start is not None and (start[0] < 0 or start[1] != target[1]):
        said = f"{arguments.start} for a target of {arguments.target}"
        raise InputError("--start", said, "0 or more, in the target's unit")
    part = None if arguments.part is None else part_name(arguments.part)
    if arguments.model is not None:
        read_model(arguments.model)  # refuses a broken one before anything is written
    config = config or simulated_default()
    config = replace(config, manipulate=replace(config.manipulate, planner=arguments.planner))
    asked = ExploreArguments(
        object=arguments.object, joint=arguments.joint, scale=arguments.scale,
        allow=arguments.allow, seed=arguments.seed,
        rig_errors=arguments.rig_errors, out=arguments.out, config=arguments.config,
        tracker=arguments.tracker, segmenter=arguments.segmenter,
        parts="1" if arguments.part is None else ALL_PARTS,  # the one that is meant is among them
    )  # fmt: skip
    explore = explore_request(asked, config, command=command or _command(arguments), what=what)
    return ManipulateRequest(
        explore, target, tolerance, part, arguments.model, None if start is None else start[0]
    )


def _command(arguments: RunArguments) -> str:
    """The command line that repeats a run."""
    words = [f"akm-fg run {arguments.object}"]
    for flag in _NAMED:
        given = getattr(arguments, flag)
        words += [] if given is None else [f"--{flag} {given}"]
    words += [f"--planner {arguments.planner}"] if arguments.planner != "covariance" else []
    words += [f"--seed {arguments.seed}"]
    words += ["--rig-errors"] if arguments.rig_errors else []
    return " ".join(words)


def _print(request: ManipulateRequest, ran: Ran, report: Path | None) -> None:
    from akm_fg.cli.console.lines import console
    from akm_fg.cli.running.outcome import believed_line, beside_lines
    from akm_fg.report.wording import printable, state

    out, run = console(), ran.manipulation
    part, belief = ran.part, run.belief
    if part is not None:
        line = f"{part.name}: {part.posterior.kind}, state unknown"
        known = belief if belief and belief.mode == "tracking" else None
        if known and known.mean is not None and known.sd is not None:
            line = believed_line(part, known.mean, known.sd)
        else:
            last = next((b for b in reversed(run.beliefs) if b.mode == "tracking"), None)
            if last is not None and last.mean is not None:
                at = state(last.mean - part.closed_state, part.joint.kind.unit)
                line += f"; last known {at}"
        out.print(line, soft_wrap=True)
    words = f"{run.rounds} moves, {run.clear_looks} looks, {run.regrasps} regrasps"
    if ran.reached:
        p = f"within tolerance with probability {run.probability:.3f}"
        out.print(f"reached: {p} ({words})", soft_wrap=True)
    else:
        out.print(f"not reached: {ran.failure} ({words})", soft_wrap=True)
    for line in beside_lines(ran):
        out.print(line, soft_wrap=True)
    if ran.learned is not None:
        out.print(f"learned: {ran.learned}", soft_wrap=True)
    if report is not None:
        out.print(f"report: {printable(str(report))}", soft_wrap=True)
    elif ran.explored is not None:
        path = request.explore.folder / "report.html"
        out.print(f"report: {printable(str(path))}", soft_wrap=True)


# Flags with a value, that a command line which repeats a run needs.
_NAMED = (
    "target", "tolerance", "part", "model", "start", "joint", "scale", "allow", "config", "tracker",
    "segmenter",
)  # fmt: skip
