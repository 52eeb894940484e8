"""The true joint as JSON has it, for scoring alone. Format: docs/conventions.md."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np

from akm_fg.errors import InputError
from akm_fg.io.json_fields import Fields, load_json_object
from akm_fg.records import FloatArray, JointTruth, KindName
from factors.joint import JointKind

KINDS = ("rigid", *map(str, JointKind))
UNIT_TOLERANCE = 1e-3  # of an axis' length: more is not rounding
WHAT = "a truth: an object with kind, axis, pivot and states, or one that holds it as `truth`"


def truth_from_fields(truth: Fields, frames: int | None) -> JointTruth:
    """The truth that an object holds.

    Args:
        truth: the object; a rigid one may leave its axis out (NaN).
        frames: how many states it must have; None: as many as it likes, or none.

    Raises:
        InputError: it contradicts itself.
    """
    expected = "one of " + ", ".join(KINDS)
    kind = truth.text("kind", expected)
    if kind not in KINDS:
        raise truth.error("kind", f"is {kind!r}"[:60], expected)
    rigid = kind == "rigid"
    axis = np.full(3, np.nan) if rigid and not truth.has("axis") else _direction(truth)
    pivot = None
    if truth.has("pivot"):
        pivot = truth.array("pivot", (3,), "a point in the world frame, metres, or null")
    elif not rigid and JointKind(kind).turns:
        raise truth.error("pivot", "is missing", "a point of the axis in the world frame, metres")
    if frames is None and not truth.has("states"):
        return JointTruth(cast(KindName, kind), axis, pivot, np.zeros(0))
    count = "the" if frames is None else frames
    wanted = f"{count} joint states, one for each of `stamps_s`"
    return JointTruth(cast(KindName, kind), axis, pivot, truth.array("states", (frames,), wanted))


def _direction(truth: Fields) -> FloatArray:
    expected = "a vector of length 1 in the world frame"
    axis = truth.array("axis", (3,), expected)
    length = float(np.linalg.norm(axis))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise truth.error("axis", f"has length {length:.3g}", expected)
    return axis / length if abs(length - 1) > 1e-12 else axis


def read_truth_file(path: Path) -> JointTruth:
    """The truth in a JSON file of any kind that has one; states may be left out.

    Raises:
        InputError: it has none, or one that contradicts itself.
    """
    fields = Fields(path, load_json_object(path, WHAT))
    if fields.has("truth"):
        fields = fields.table("truth", WHAT)
    elif "kind" not in fields.values or "kind_probability" in fields.values:
        raise InputError(path, "holds no truth", WHAT)
    return truth_from_fields(fields, None)
