"""One exploration in the simulator, every attempt recorded as it goes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from akm_fg.cli.demo_config import DemoConfig
from akm_fg.cli.exploring.outcome import write_outcome, write_part_model
from akm_fg.cli.exploring.recorder import Recorder, attempt_name
from akm_fg.cli.exploring.stages import perceiver_of
from akm_fg.cli.object_argument import ObjectArgument
from akm_fg.cli.simulated_run import limit_shares, opened_world
from akm_fg.errors import InputError
from akm_fg.exploration.explore import Explorer, explore
from akm_fg.exploration.explore_json import exploration_as_dict, exploration_from_dict
from akm_fg.exploration.records import INTERRUPTED, Exploration
from akm_fg.exploration.remembering import remember
from akm_fg.io.png import replace_file
from akm_fg.records import JointTruth
from akm_fg.stages import Stages
from akm_fg.stream.frame_stream import FrameStream
from sim.episode import SimEpisode

CONFIG = "config.toml"
RESULT = "explore.json"


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
    remember: Path | None = None  # folder whose memory of contacts grows by what is opened


@dataclass(frozen=True, slots=True)
class Measured:
    """What the simulator knows of a run. For scoring alone."""

    largest_state: float  # to which the part was opened, m or rad
    pressed_n: float  # largest force of a link that is no finger on the object, as sampled
    limit_shares: dict[str, float]  # quantity -> largest share of the arm's limit


@dataclass(slots=True)
class Explored:
    """What came of it."""

    exploration: Exploration
    truth: JointTruth  # a state for each look of the last attempt; for scoring alone
    folder: Path
    measured: Measured | None = None
    model: Path | None = None
    interrupted: bool = False


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
    if not isinstance(data, dict):
        raise InputError(path, "is no JSON object", "what explore wrote")
    if (data.get("object"), data.get("seed")) != (name, seed):
        other = f"is of {data.get('object')} with seed {data.get('seed')}"
        raise InputError(path, other, f"{name} with seed {seed}")
    exploration = exploration_from_dict(data, str(path))
    whole = [attempt for attempt in exploration.attempts if attempt.reason != INTERRUPTED]
    exploration.attempts, exploration.beliefs = whole, exploration.beliefs[: len(whole)]
    return exploration


def explore_in_simulator(
    request: ExploreRequest, then: Callable[[SimEpisode, Explored], None] | None = None
) -> Explored:
    """The exploration; what was tried stays readable when it is interrupted.

    Args:
        request: what to explore.
        then: goes on in the same world, once the model is written.

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

    with opened_world(
        request.object, request.seed, config.sim, "published", request.locked
    ) as world:
        reporter = Recorder(request.folder, world, keep)
        motion = world.arm.record()
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
            perceived.contacts,
            perceived.grasps,
            stream,
            config.explore,
            request.seed,
            world.calibration,
        )
        explored = Explored(exploration, world.truth(), request.folder)
        try:
            explore(world.arm, world.camera, explorer, exploration, reporter)
        except KeyboardInterrupt:
            explored.interrupted = True
            exploration.failure = "interrupted"
        explored.truth = reporter.truth()
        explored.measured = Measured(
            reporter.largest_state, reporter.pressed_n, limit_shares(motion)
        )
        if request.remember is not None:
            name, family = request.name, family or ""
            count = remember(request.remember, exploration, perceived, name, family)
            if count is not None:
                reporter.stage(f"{count} contacts are remembered in {request.remember}")
        if then is not None:
            explored.model = write_part_model(request.folder, exploration, config)
            then(world, explored)
    explored.model = explored.model or write_part_model(request.folder, exploration, config)
    keep()
    title = f"{request.object.title}, seed {request.seed}"
    write_outcome(
        request.folder, title, request.command, request.seed, exploration, explored.truth, config
    )
    return explored
