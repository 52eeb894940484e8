"""`akm-fg relocalize`: the states of a known object's parts in a recording."""

from __future__ import annotations

import json as json_module
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from akm_fg.cli.console.lines import console
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

    Follows the states of a model's parts through a recording of the same object by the same world:
    from anywhere in their ranges, with a standard deviation in every frame, and says when one is
    lost. The exit code is 1 where a part is not found in the last frame.
    """

    model: Annotated[Path, tyro.conf.Positional]
    """A model.json, or the folder that holds it: one that fit --out or an exploration left."""
    recording: Annotated[Path, tyro.conf.Positional]
    """A recording of the same object; the world of its T_world_cam is the model's."""
    part: str | None = None
    """Number or name of a part, the one that a hand in the recording holds; all are followed if it
    is not given, and by their surfaces alone where there are several."""
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
    from akm_fg.relocalization.several import PartsRelocalizer
    from akm_fg.stream.seen_so_far import hands_of

    config = chosen_config(AkmConfig(), arguments.config)
    model = read_model(arguments.model)
    chosen = parts_named(model, arguments.part)
    recording = read_recording(arguments.recording)
    noise = config.perception.observe.noise
    follower = PartsRelocalizer(model, noise, config.relocalization)
    held = chosen[0] if len(chosen) == 1 else None
    rows: list[tuple[StateBelief, ...]] = []
    began = time.perf_counter()
    with json_output(arguments.json) as stream:
        for frame, hand in zip(recording.frames, hands_of(recording), strict=True):
            rows.append(follower.update(frame, hand, held))
        took_s = time.perf_counter() - began
        beliefs = {place: [row[place] for row in rows] for place in chosen}
        result = _result(arguments, model, beliefs, took_s)
        if stream is not None:
            write_line(stream, json_module.dumps(result, allow_nan=False))
    if arguments.json != "-":
        for place in chosen:
            _print(model, place, beliefs[place])
    found = all(each[-1].mode == "tracking" for each in beliefs.values())
    return DONE if found else GOAL_NOT_REACHED


def parts_named(model: ObjectModel, text: str | None) -> list[int]:
    """Places of the parts that are told of: the one that is named, or all.

    Raises:
        InputError: no such part, or a pixel or a point, which nobody can look up here.
    """
    from akm_fg.model.naming import Pixel, Point, part_name, part_named

    if text is None:
        return list(range(len(model.parts)))
    name = part_name(text)
    if isinstance(name, Pixel | Point):
        raise InputError("--part", f"is {text!r}"[:80], "a part's number or name")
    return [part_named(model, name)]


def _result(
    arguments: RelocalizeArguments,
    model: ObjectModel,
    beliefs: Mapping[int, list[StateBelief]],
    took_s: float,
) -> dict[str, Any]:
    """Of one part its fields stand at the top; of several there is an object each in `parts`."""
    told = [_of_part(model, place, each) for place, each in beliefs.items()]
    fields = told[0] if len(told) == 1 else {"parts": told}
    stamps_s = [belief.stamp_s for belief in next(iter(beliefs.values()))]
    return {
        "schema": SCHEMA,
        "model": str(arguments.model),
        "recording": str(arguments.recording),
        "stamps_s": stamps_s,
        **fields,
        "time_s": {"total": took_s},
    }


def _of_part(model: ObjectModel, place: int, beliefs: list[StateBelief]) -> dict[str, Any]:
    part = model.parts[place]
    return {
        "part": part.name,
        "unit": part.joint.kind.unit,
        "closed_state": part.closed_state,
        "mode": [belief.mode for belief in beliefs],
        "mean": [belief.mean for belief in beliefs],
        "sd": [belief.sd for belief in beliefs],
        "probability": [belief.probability for belief in beliefs],
        "seen": [belief.seen for belief in beliefs],
        "nis": [belief.nis for belief in beliefs],
        "reason": [belief.reason for belief in beliefs],
    }


def _print(model: ObjectModel, number: int, beliefs: list[StateBelief]) -> None:
    from rich.table import Table

    from akm_fg.report.wording import ascii_text, printable, state

    out = console()

    def text(words: str) -> str:
        return ascii_text(words) if out.options.ascii_only else words

    part = model.parts[number]
    unit, name = part.joint.kind.unit, text(printable(part.name))
    table = Table("frame", "state", "95 % within", "what is known", title=name)
    step = max(1, -(-len(beliefs) // MOST_ROWS))
    for k, belief in enumerate(beliefs):
        if k % step and k + 1 < len(beliefs):
            continue
        known = belief.mean is not None and belief.sd is not None
        mean = state(belief.mean, unit) if known else "unknown"  # type: ignore[arg-type]
        bound = state(1.96 * belief.sd, unit) if known else ""  # type: ignore[operator]
        told = belief.reason or ("seen" if belief.seen else "predicted")
        table.add_row(str(k), text(mean), text(bound), f"{belief.mode}: {told}")
    out.print(table)


MOST_ROWS = 40  # of the table; of longer recordings every so manieth frame
