"""Targets as a person writes them: 0.30 (metres), 30cm, 30deg, 0.5rad."""

from __future__ import annotations

import math
import re
from typing import Literal

from akm_fg.errors import InputError

Unit = Literal["m", "rad"]

_FACTOR: dict[str, tuple[float, Unit]] = {
    "": (1.0, "m"),
    "m": (1.0, "m"),
    "cm": (0.01, "m"),
    "mm": (0.001, "m"),
    "deg": (math.pi / 180, "rad"),
    "rad": (1.0, "rad"),
}


def parse_target(text: str) -> tuple[float, Unit]:
    """The state and its unit.

    Raises:
        InputError: not a finite number with one of the units.
    """
    match = re.fullmatch(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([a-z]*)\s*", text)
    try:
        value = float(match.group(1)) if match else math.nan
    except ValueError:
        value = math.nan
    if match is None or not math.isfinite(value) or match.group(2) not in _FACTOR:
        raise InputError("--target", f"{text!r} is not a state", "metres (0.30) or degrees (30deg)")
    factor, unit = _FACTOR[match.group(2)]
    return value * factor, unit
