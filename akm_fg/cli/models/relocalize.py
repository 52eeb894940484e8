"""`akm-fg relocalize`: the states of a known object's part in a recording."""

from __future__ import annotations

import json as json_module
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from akm_fg.cli.exit_codes import DONE, GOAL_NOT_REACHED
from akm_fg.cli.output import json_output, write_line
from akm_fg.errors import InputError

if TYPE_CHECKING:
    from akm_fg.model.records import ObjectModel
    from akm_fg.relocalization.records import StateBelief

SCHEMA = "akm-fg/relocalize/1"


@dataclass(frozen=True)
class RelocalizeArguments:
    """Example: akm-fg relocalize runs/kitchen runs/kitchen-later --json states.json

    Follows the state of a part through a recording of the same object by the same world: from
    anywhere in its range, with a standard deviation in every frame, and says when it is lost. The
    exit code is 1 where the part is not found in the last frame.
    """

    model: Annotated[Path, tyro.conf.Positional]
    """A model.json, or the folder that holds it: one that fit --out or an exploration left."""
    recording: Annotated[Path, tyro.conf.Positional]
    """A recording of the same object; the world of its T_world_cam is the model's."""
    part: str | None = None
    """Name of the part; needed where the model has several."""
    json: str | None = None
    """Write the states as one JSON object to this file; - is standard output."""
    config: Path | None = None
    """TOML file with settings that differ from the defaults."""
    seed: int = 0
    """Not used: nothing here is random."""


def relocalize(arguments: RelocalizeArguments) -> int:
    """Run the command.

    Raises:
        InputError: no such model, part or recording.
        OutputError: the disk refuses.
    """
    from akm_fg.cli.config_argument import chosen_config
    from akm_fg.config import AkmConfig
    from akm_fg.io.recording_reader import read_recording
    from akm_fg.model.read import read_model
    from akm_fg.relocalization.relocalizer import Relocalizer
    from akm_fg.stream.seen_so_far import hands_of

    config = chosen_config(AkmConfig(), arguments.config)
    model = read_model(arguments.model)
    number = part_number(model, arguments.part)
    recording = read_recording(arguments.recording)
    noise = config.perception.observe.noise
    follower, beliefs = Relocalizer(model, number, noise, config.relocalization), []
    began = time.perf_counter()
    with json_output(arguments.json) as stream:
        for frame, hand in zip(recording.frames, hands_of(recording), strict=True):
            beliefs.append(follower.update(frame, hand))
        took_s = time.perf_counter() - began
        result = _result(arguments, model, number, beliefs, took_s)
        if stream is not None:
            write_line(stream, json_module.dumps(result, allow_nan=False))
    if arguments.json != "-":
        _print(model, number, beliefs)
    return DONE if beliefs[-1].mode == "tracking" else GOAL_NOT_REACHED


def part_number(model: ObjectModel, name: str | None) -> int:
    """Place of a named part.

    Raises:
        InputError: no such part, or none named where there are several.
    """
    names = [part.name for part in model.parts]
    if name is None and len(names) == 1:
        return 0
    if name not in names:
        said = "none is named" if name is None else f"{name!r} is not in the model"
        raise InputError("--part", said, f"one of {', '.join(names)}")
    return names.index(name)


def _result(
    arguments: RelocalizeArguments,
    model: ObjectModel,
    number: int,
    beliefs: list[StateBelief],
    took_s: float,
) -> dict[str, Any]:
    part = model.parts[number]
    return {
        "schema": SCHEMA,
        "model": str(arguments.model),
        "recording": str(arguments.recording),
        "part": part.name,
        "unit": part.joint.kind.unit,
        "closed_state": part.closed_state,
        "stamps_s": [belief.stamp_s for belief in beliefs],
        "mode": [belief.mode for belief in beliefs],
        "mean": [belief.mean for belief in beliefs],
        "sd": [belief.sd for belief in beliefs],
        "probability": [belief.probability for belief in beliefs],
        "seen": [belief.seen for belief in beliefs],
        "nis": [belief.nis for belief in beliefs],
        "reason": [belief.reason for belief in beliefs],
        "time_s": {"total": took_s},
    }


def _print(model: ObjectModel, number: int, beliefs: list[StateBelief]) -> None:
    from rich.console import Console
    from rich.table import Table

    from akm_fg.report.wording import state

    unit = model.parts[number].joint.kind.unit
    table = Table("frame", "state", "95 % within", "what is known", title=model.parts[number].name)
    step = max(1, -(-len(beliefs) // MOST_ROWS))
    for k, belief in enumerate(beliefs):
        if k % step and k + 1 < len(beliefs):
            continue
        known = belief.mean is not None and belief.sd is not None
        mean = state(belief.mean, unit) if known else "unknown"  # type: ignore[arg-type]
        bound = state(1.96 * belief.sd, unit) if known else ""  # type: ignore[operator]
        told = belief.reason or ("seen" if belief.seen else "predicted")
        table.add_row(str(k), mean, bound, f"{belief.mode}: {told}")
    Console().print(table)


MOST_ROWS = 40  # of the table; of longer recordings every so manieth frame
