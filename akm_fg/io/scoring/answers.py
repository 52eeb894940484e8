"""Answers that commands have written: posteriors in JSON, one object a line, or in folders."""

from __future__ import annotations

import json
from pathlib import Path

from akm_fg.errors import InputError
from akm_fg.io.json_fields import MAX_BYTES, Fields
from akm_fg.io.posteriors.posterior_json import SCHEMA
from akm_fg.io.posteriors.posterior_reader import posterior_from_fields
from akm_fg.posterior import ArticulationPosterior

POSTERIOR_FILE = "posterior.json"  # in the folder of a run or a fit
WHAT = f"posteriors ({SCHEMA}), one JSON object a line, a run, or a folder with {POSTERIOR_FILE}"


def read_answers(path: Path) -> list[ArticulationPosterior]:
    """All posteriors of a file or folder, in their order.

    Raises:
        InputError: it cannot be read, or one of them is broken; the line is named.
    """
    file = path / POSTERIOR_FILE if path.is_dir() else path
    try:
        if file.exists() and not file.is_file():
            raise InputError(file, "is not a regular file", WHAT)
        if file.stat().st_size > MAX_BYTES:
            raise InputError(file, f"holds {file.stat().st_size / 1e6:.0f} MB", WHAT)
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise InputError(file, "does not exist", WHAT) from error
    except (OSError, ValueError) as error:
        told = getattr(error, "strerror", None) or "not text"
        raise InputError(file, f"cannot be read ({told})", WHAT) from error
    found = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip():
            found += _answers_of(file, number, line)
    if not found:
        raise InputError(file, "holds no posterior", WHAT)
    return found


def _answers_of(file: Path, number: int, line: str) -> list[ArticulationPosterior]:
    try:
        values = json.loads(line)
    except (RecursionError, ValueError) as error:
        raise InputError(file, f"line {number} is not JSON", WHAT) from error
    if not isinstance(values, dict):
        raise InputError(file, f"line {number} is no JSON object", WHAT)
    fields = Fields(file, values, f"line {number}: " if number > 1 else "")
    if "posterior" not in values:
        return [posterior_from_fields(fields)]
    if not fields.has("posterior"):  # a run that ended before there was one
        return []
    return [posterior_from_fields(fields.table("posterior", "a posterior, or null"))]
