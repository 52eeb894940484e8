"""`akm-fg demo`: the main job on a simulated object, with a report."""

from __future__ import annotations

import importlib.util
import json as json_module
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from akm_fg.cli.exit_codes import DONE, GOAL_NOT_REACHED, INTERRUPTED
from akm_fg.cli.object_argument import ObjectArgument, parse_object
from akm_fg.cli.output import json_output, write_line
from akm_fg.cli.target import Unit, parse_target
from akm_fg.errors import GraspFailed, InputError, MissingDependency, OutputError

if TYPE_CHECKING:
    from akm_fg.closed_loop import EpisodeConfig
    from akm_fg.report.summary import RunSummary
    from sim.objects.part_spec import PartSpec

_USUAL_TARGET_M = 0.20
_USUAL_TARGET_RAD = float(np.deg2rad(35.0))
_SHARE_OF_RANGE = 0.8  # of a range that ends before the usual target


@dataclass(frozen=True)
class DemoArguments:
    """Example: akm-fg demo --object drawer --target 0.25 --seed 3

    A simulated Franka grasps the handle of a cabinet, pulls, finds out from RGB-D what moved and
    how, and drives the part to a target state. Writes a folder with the recording, the posterior
    and report.html. The exit code is 1 when the target was not reached.
    """

    object: str = "door"
    """What the robot meets: door, drawer, SUITE/NAME (akm-fg objects lists them), a URDF file, or
    the folder of a PartNet-Mobility object."""
    joint: str | None = None
    """Of a file or folder: the joint that is free, where several move."""
    target: str | None = None
    """Opening to reach from closed: metres (0.25) where it slides, degrees (35deg) where it turns.
    If absent 0.20 or 35deg, or 0.8 of the range where that is less."""
    seed: int = 0
    """Of the object and the camera's noise."""
    out: Path = Path("runs")
    """Folder in which the run's own folder is made."""
    json: str | None = None
    """Write the run as one JSON object to this file; - is standard output (no table then)."""


@dataclass(frozen=True, slots=True)
class DemoSetting:
    """What a test makes smaller."""

    episode: EpisodeConfig | None = None  # None: the default
    image_scale: float = 1.0  # of 640 x 480 pixels


def demo(arguments: DemoArguments, setting: DemoSetting | None = None) -> int:
    """Run the command; tests hand in a smaller setting.

    Raises:
        InputError: a target that cannot be read, or of the wrong unit.
        MissingDependency: the simulator is not installed.
        OutputError: the run's folder cannot be written.
    """
    began, setting = time.perf_counter(), setting or DemoSetting()
    wanted = None if arguments.target is None else parse_target(arguments.target)
    _require_simulator()
    from akm_fg.cli.simulated_run import RunRequest, run_in_simulator
    from akm_fg.closed_loop import EpisodeConfig

    thing = parse_object(arguments.object, arguments.joint)
    target = wanted_state(arguments, wanted, thing.spec(arguments.seed))
    with json_output(arguments.json) as stream:
        folder = _make_folder(arguments.out, f"{thing.label}-{arguments.seed}")
        try:
            summary, interrupted = run_in_simulator(
                RunRequest(
                    object=thing,
                    seed=arguments.seed,
                    target=target,
                    folder=folder,
                    command=_command(arguments, thing),
                    config=setting.episode or EpisodeConfig(),
                    image_scale=setting.image_scale,
                )
            )
        except GraspFailed as error:
            print(f"akm-fg: {error}", file=sys.stderr)
            return GOAL_NOT_REACHED
        summary.time_s["total"] = time.perf_counter() - began
        _write(folder, summary)
        if stream is not None:
            write_line(
                stream, json_module.dumps(_as_dict(arguments.object, summary), allow_nan=False)
            )
    if arguments.json != "-":
        _print(summary, folder)
    if interrupted:
        return INTERRUPTED
    return DONE if summary.claims_reached else GOAL_NOT_REACHED


def _require_simulator() -> None:
    absent = [m for m in ("pybullet", "pinocchio") if importlib.util.find_spec(m) is None]
    if absent:
        raise MissingDependency(
            f"the demo needs {' and '.join(absent)}; install akm-fg[sim] (Python 3.11)"
        )


def wanted_state(
    arguments: DemoArguments, wanted: tuple[float, Unit] | None, spec: PartSpec
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
    return {spec.kind: target}


def _command(arguments: DemoArguments, thing: ObjectArgument) -> str:
    target = "" if arguments.target is None else f" --target {arguments.target}"
    return f"akm-fg demo {thing.words} --seed {arguments.seed}{target}"


def _make_folder(out: Path, name: str) -> Path:
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


def _as_dict(name: str, summary: RunSummary) -> dict[str, Any]:
    """The run as JSON (`akm-fg/run/1`, docs/conventions.md)."""
    from akm_fg.io.posterior_json import posterior_as_dict

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
