"""`akm-fg explore`: find where an object opens, and how; simulated, or before a real robot."""

from __future__ import annotations

import json as json_module
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import tyro

from akm_fg.cli.demo import make_run_folder, require_simulator
from akm_fg.cli.exit_codes import DONE, GOAL_NOT_REACHED, INTERRUPTED
from akm_fg.cli.object_argument import parse_object
from akm_fg.cli.output import json_output, write_line
from akm_fg.cli.requirements import require_arm
from akm_fg.errors import InputError

ALL_PARTS = "all"
TURNS_RAD = 0.8  # of a hand on what it holds, beyond which it does not hold it
ASLANT_RAD = 0.8  # of the hand that feels for a handle: depth errs along the camera's look
CLOSE_M_S = (
    0.007  # of a finger: felt for, a handle is off the middle, and is met by one finger first
)
CLOSE_MAX_S = 7.5  # 40 mm at that speed, and time to squeeze
KEPT_FRAMES = 24  # of a pull: with more a stretch takes longer to solve, and tells no more

if TYPE_CHECKING:
    from akm_fg.cli.demo_config import DemoConfig
    from akm_fg.cli.exploring.kept import Explored
    from akm_fg.cli.exploring.on_robot import RobotRequest
    from akm_fg.cli.exploring.simulated import ExploreRequest
    from akm_fg.config import AkmConfig
    from akm_fg.exploration.config import ExploreConfig

Tree = TypeVar("Tree", bound="AkmConfig")


@dataclass(frozen=True)
class ExploreArguments:
    """Example: akm-fg explore furniture-dev/door-001 --seed 3

    A simulated Franka looks at a closed object that it has never seen, tries where it may open,
    learns from every try, and stops when it knows the joint well enough for the task, or when
    nothing is left to try. Writes a folder with explore.json, a recording of every attempt,
    model.json and report.html. The exit code is 1 when nothing was opened.

    With --robot a real Franka does, under a RealSense: see docs/hardware.md before.
    """

    object: Annotated[str, tyro.conf.Positional] = "furniture-dev/door-001"
    """What the robot meets: door, drawer, SUITE/NAME (akm-fg objects lists them), a URDF file, or
    the folder of a PartNet-Mobility object."""
    named: Annotated[str | None, tyro.conf.arg(name="object")] = None
    """The same, as akm-fg demo has it."""
    joint: str | None = None
    """Of a file or folder: the joint that is free, where several move."""
    scale: float | None = None
    """Of a file or folder: what every length in it is multiplied by, such as 0.001 for one in
    millimetres. If absent 1 for a URDF file, and for a folder what its category's size gives."""
    allow: Path | None = None
    """Of a file or folder: one more folder from which its meshes may be taken."""
    seed: int = 0
    """Of the object and the camera's noise."""
    max_attempts: int = 25
    """Pulls after which the search ends."""
    parts: str = "1"
    """How many parts to find and model, or all that open. One that was opened is closed again, and
    the search goes on over the fronts that it does not explain."""
    stop: Literal["posterior", "threshold"] = "posterior"
    """When a pull ends: when the posterior is good enough, or by the paper's threshold."""
    belief: Literal["bayes", "suppression"] = "bayes"
    """How failures teach: by their meaning, or all alike as in the paper (Eq. 2)."""
    without_at: bool = False
    """Without adaptive termination: one attempt is all."""
    without_fs: bool = False
    """Without failure suppression: failures teach nothing."""
    without_ca: bool = False
    """Without contact analogy: all places to take hold are alike at first."""
    zero_shot: bool = False
    """Nothing is remembered of the object's own family."""
    remember: bool = False
    """Add the contact that opens to the memory, for the objects to come."""
    memory: Path | None = None
    """Folder of remembered contacts to ask, and with --remember to add to; without, what comes with
    the package is asked, and --remember keeps its own in the user's data folder."""
    rig_errors: bool = False
    """Camera and arm err as a calibrated rig does; the seed draws by how much."""
    locked: bool = False
    """Lock every joint of the simulated object; for scoring."""
    out: Path = Path("runs")
    """Folder in which the run's own folder is made."""
    resume: Path | None = None
    """A run's folder: go on where it was interrupted; what was tried is not tried again."""
    json: str | None = None
    """Write the exploration as one JSON object to this file; - is standard output."""
    config: Path | None = None
    """TOML file with settings that differ from the defaults, such as explore.max_attempts = 10."""
    tracker: str | None = None
    """What follows points: flow, or another file of akm_fg/backends/trackers."""
    segmenter: str | None = None
    """What finds the object: depth, or another file of akm_fg/backends/segmenters."""
    robot: str | None = None
    """Address of a real Franka's control interface: explore what stands before it."""
    camera: Literal["realsense"] = "realsense"
    """With --robot: the camera, the first of its kind that is connected."""
    calibration: Path | None = None
    """With --robot: what akm-fg calibrate --json wrote of the camera, which has to stand still."""
    floor: float = 0.0
    """With --robot: height of the floor or table top above the robot's base, m; nothing goes
    below."""
    dry_run: bool = False
    """With --robot: look and plan, say what would move first, connect no arm and move nothing."""


def explore(arguments: ExploreArguments, config: DemoConfig | None = None) -> int:
    """Run the command.

    Args:
        arguments: of the command line.
        config: what `--config` and the flags change; the defaults if absent.

    Raises:
        InputError: no such object, a configuration that cannot be used, a folder to resume that
            is not of this object and seed.
        MissingDependency: the simulator is not installed.
        OutputError: the run's folder cannot be written.
    """
    began = time.perf_counter()
    arguments = replace(arguments, object=arguments.named or arguments.object, named=None)
    if arguments.max_attempts < 1:
        raise InputError("--max-attempts", f"is {arguments.max_attempts}", "1 or more")
    parts_of(arguments.parts)
    request, run = _on_robot(arguments) if arguments.robot else _simulated(arguments, config)
    from akm_fg.cli.exploring.kept import write_result

    with json_output(arguments.json) as stream:
        explored = run()
        result = _result(request, explored, time.perf_counter() - began)
        write_result(request.folder, result)
        if stream is not None:
            write_line(stream, json_module.dumps(result, allow_nan=False))
    if arguments.json != "-":
        _print(request, explored)
    if explored.interrupted:
        return INTERRUPTED
    exploration = explored.exploration
    reached = exploration.opened and exploration.failure is None
    return DONE if reached or explored.planned else GOAL_NOT_REACHED


def parts_of(text: str) -> int:
    """How many parts are looked for; 0 means all that open.

    Raises:
        InputError: neither a number from 1 on nor `all`.
    """
    if text == ALL_PARTS:
        return 0
    if not re.fullmatch(r"[1-9][0-9]{0,3}", text):
        raise InputError("--parts", f"is {text!r}"[:60], f"a number from 1 on, or {ALL_PARTS}")
    return int(text)


def _simulated(
    arguments: ExploreArguments, config: DemoConfig | None
) -> tuple[ExploreRequest, Callable[[], Explored]]:
    for flag in ("calibration", "dry_run"):
        if getattr(arguments, flag):
            word = f"--{flag.replace('_', '-')}"
            raise InputError(word, "is of a real robot", "--robot HOST beside it")
    require_simulator("exploring")
    from akm_fg.cli.exploring.simulated import explore_in_simulator

    request = explore_request(arguments, config)
    return request, lambda: explore_in_simulator(request)


def _on_robot(arguments: ExploreArguments) -> tuple[RobotRequest, Callable[[], Explored]]:
    require_arm()
    from akm_fg.cli.exploring.robot_request import refuse_what_is_simulated, robot_request

    refuse_what_is_simulated(arguments)
    request = robot_request(arguments)
    from akm_fg.cli.exploring.on_robot import explore_on_robot

    return request, lambda: explore_on_robot(request)


def explore_request(
    arguments: ExploreArguments,
    config: DemoConfig | None = None,
    command: str | None = None,
    what: str = "explore",
) -> ExploreRequest:
    """What is to be done, and the folder for it.

    Args:
        arguments: of the command line.
        config: what `--config` and the flags change; the defaults if absent.
        command: that repeats it, where it is not explore's own.
        what: the command's name, for the folder.
    """
    from akm_fg.backends.registry import stages_of
    from akm_fg.cli.config_argument import CONFIG, write_tree
    from akm_fg.cli.demo_config import demo_config
    from akm_fg.cli.exploring.kept import read_request
    from akm_fg.cli.exploring.simulated import ExploreRequest

    config = demo_config(arguments, config or simulated_default())
    config = replace(config, explore=chosen_explore(arguments, config.explore))
    config = with_memory(arguments, config)
    stages, command = stages_of(config), command or command_of(arguments)
    thing = parse_object(arguments.object, arguments.joint, arguments.scale, arguments.allow)
    thing.spec(arguments.seed)  # refuses a broken one before anything is written
    if arguments.resume is not None:
        folder = arguments.resume
        read_request(folder, arguments.object, arguments.seed)
    else:
        folder = make_run_folder(arguments.out, f"{what}-{thing.label}-{arguments.seed}")
        write_tree(folder / CONFIG, config, f"All settings of {command}")
    return ExploreRequest(
        thing, arguments.object, arguments.seed, arguments.locked, folder, config, stages,
        command, memory_folder(arguments) if arguments.remember else None,
    )  # fmt: skip


def exploring_default(config: Tree) -> Tree:
    """The settings that an exploration begins with, before any file: fingers may turn, few frames.

    A compliant pull leaves the hand's orientation free: on a bar or knob it turns by 20 to 30 deg.
    A recording is solved once, a pull after each stretch.
    """
    rig = config.perception.rig
    turning = replace(rig, gripper=replace(rig.gripper, turn_rad=TURNS_RAD))
    observe = config.perception.observe
    observe = replace(observe, kept=replace(observe.kept, most=KEPT_FRAMES))
    return replace(
        config,
        perception=replace(config.perception, rig=turning, observe=observe),
        fit=replace(config.fit, max_frames=KEPT_FRAMES),
    )


def simulated_default() -> DemoConfig:
    """As `exploring_default`, with the simulated arm as it reaches for what it knows by depth."""
    from akm_fg.cli.demo_config import DemoConfig

    config = exploring_default(DemoConfig())
    franka = config.sim.franka
    gripper = replace(franka.gripper, close_m_s=CLOSE_M_S)
    feeling = replace(franka, gripper=gripper, close_max_s=CLOSE_MAX_S, aslant_rad=ASLANT_RAD)
    return replace(config, sim=replace(config.sim, franka=feeling))


def with_memory(arguments: ExploreArguments, config: Tree) -> Tree:
    """The settings with the memory that is asked; one that has yet to begin is not."""
    memory = memory_folder(arguments)
    if memory is None or (arguments.remember and not memory.exists()):
        return config
    return replace(config, explore=replace(config.explore, memory=str(memory)))


def memory_folder(arguments: ExploreArguments) -> Path | None:
    """The memory that was named, or that grows; None: the package's own."""
    if arguments.memory is not None or not arguments.remember:
        return arguments.memory
    import platformdirs

    return platformdirs.user_data_path("akm-fg", appauthor=False) / "contacts"


def command_of(arguments: ExploreArguments) -> str:
    """The command line that repeats a run."""
    words = [f"akm-fg explore {_what(arguments)} --seed {arguments.seed}"]
    for flag in ("config", "tracker", "segmenter", "memory"):
        given = getattr(arguments, flag)
        words += [] if given is None else [f"--{flag} {given}"]
    usual = ExploreArguments()
    for flag in ("parts", "stop", "belief", "max_attempts"):
        given = getattr(arguments, flag)
        words += [] if given == getattr(usual, flag) else [f"--{flag.replace('_', '-')} {given}"]
    for flag in ("without_at", "without_fs", "without_ca", "zero_shot", "rig_errors", "locked",
                 "remember"):  # fmt: skip
        words += [f"--{flag.replace('_', '-')}"] if getattr(arguments, flag) else []
    return " ".join(words)


def _what(arguments: ExploreArguments) -> str:
    """What is explored, as words of a command line."""
    if arguments.robot is None:
        return parse_object(
            arguments.object, arguments.joint, arguments.scale, arguments.allow
        ).positional
    dry = " --dry-run" if arguments.dry_run else ""
    rig = f"--robot {arguments.robot} --calibration {arguments.calibration}"
    return f"{rig} --floor {arguments.floor:g}{dry}"


def chosen_explore(arguments: ExploreArguments, config: ExploreConfig) -> ExploreConfig:
    """The settings with what the flags say; a flag that is not given leaves the file's word."""
    usual, changes = ExploreArguments(), {}
    for name in ("max_attempts", "stop", "belief"):
        if getattr(arguments, name) != getattr(usual, name):
            changes[name] = getattr(arguments, name)
    if arguments.parts != usual.parts:
        changes["parts"] = parts_of(arguments.parts)
    without = {
        "adaptive_termination": arguments.without_at,
        "failure_suppression": arguments.without_fs,
        "contact_analogy": arguments.without_ca,
    }
    changes |= {name: False for name, given in without.items() if given}
    if arguments.zero_shot:
        changes["zero_shot"] = True
    return replace(config, **changes)


def _result(
    request: ExploreRequest | RobotRequest, explored: Explored, total_s: float
) -> dict[str, Any]:
    """The exploration as JSON (`akm-fg/explore/1`, docs/conventions.md)."""
    from akm_fg.exploration.explore_json import exploration_as_dict
    from akm_fg.io.recording_reader import truth_as_json

    result = exploration_as_dict(explored.exploration)
    truth = None
    if explored.truth is not None:
        described = truth_as_json(explored.truth)
        truth = {"final_state": described.pop("states")[-1], **described}
        truth |= _parts_truth(explored)
    return {
        "schema": result.pop("schema"),
        "object": request.name,
        "seed": request.seed,
        **result,
        "model": None if explored.model is None else str(explored.model),
        "truth": truth,
        "time_s": {**result["time_s"], "total": total_s},
    }


def _parts_truth(explored: Explored) -> dict[str, Any]:
    """Of every part, where several open."""
    from akm_fg.io.recording_reader import truth_as_json

    if len(explored.parts_truth) < 2:
        return {}
    rows = [truth_as_json(truth) for truth in explored.parts_truth]
    return {"parts": [{"final_state": row.pop("states")[-1], **row} for row in rows]}


def _print(request: ExploreRequest | RobotRequest, explored: Explored) -> None:
    from akm_fg.cli.console.lines import console
    from akm_fg.report.wording import printable

    out = console()

    def say(text: str) -> None:
        lines = "\n".join(map(printable, text.splitlines()))
        out.print(lines, soft_wrap=True, highlight=False)

    exploration = explored.exploration
    words = f"{exploration.pulls} pulls of {len(exploration.attempts)} tries"
    if explored.planned:
        say(str(exploration.failure))
    elif exploration.opened:
        last = next(a for a in reversed(exploration.attempts) if a.outcome == "opened")
        say(f"opened: {last.reason} ({words})")
    if exploration.failure is not None and not explored.planned:
        said = "short of it" if exploration.opened else "not opened"
        say(f"{said}: {exploration.failure}")
    if exploration.model is not None:
        for part in exploration.model.parts:
            say(f"{part.name}: {part.posterior.summary()}")
    elif exploration.fit is not None:
        say(exploration.fit.posterior.summary())
    report = request.folder / "report.html"
    if report.exists():
        say(f"report: {report}")
