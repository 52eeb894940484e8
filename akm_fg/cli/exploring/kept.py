"""What a run of `akm-fg explore` keeps: its folder's files, and what came of it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from akm_fg.errors import InputError
from akm_fg.exploration.explore_json import exploration_from_dict
from akm_fg.exploration.records import INTERRUPTED, Exploration
from akm_fg.io.png import replace_file
from akm_fg.model.read import read_model
from akm_fg.records import JointTruth

RESULT = "explore.json"


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
    folder: Path
    truth: JointTruth | None = None  # a state for each look of the last attempt; scoring alone
    measured: Measured | None = None
    model: Path | None = None
    interrupted: bool = False
    parts_truth: tuple[JointTruth, ...] = ()  # of every part that opens; for scoring alone
    planned: bool = False  # a dry run has come to its first grasp


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
    if any(part.name is not None for part in exploration.found):
        exploration.model = read_model(folder)
    return exploration
