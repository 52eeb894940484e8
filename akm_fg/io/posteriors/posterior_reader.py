"""Posteriors back from JSON, as far as the format holds them. Format: docs/conventions.md.

Only the most probable kind has states there, and of `other_parts` too little is kept to make them
anew: they are left out.
"""

from __future__ import annotations

from dataclasses import fields as fields_of
from typing import Any, cast

import numpy as np

from akm_fg.io.json_fields import Fields
from akm_fg.io.posteriors.posterior_json import SCHEMA
from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    FitReport,
    JointPosterior,
    KindPosterior,
    NamedKind,
    StatePosterior,
)
from akm_fg.records import FloatArray
from factors.joint import Joint, JointKind, Unit

KINDS = ("rigid", *map(str, JointKind))
_SYMMETRY_TOLERANCE = 1e-6  # of a covariance, relative


def posterior_from_fields(fields: Fields) -> ArticulationPosterior:
    """The posterior that a JSON object holds.

    Args:
        fields: of the object, which knows its file.

    Raises:
        InputError: of another schema, something is missing, or it contradicts itself.
    """
    schema = fields.text("schema", f"the string {SCHEMA!r}")
    if schema != SCHEMA:
        raise fields.error("schema", f"is {schema!r}"[:80], f"{SCHEMA!r}")
    kind = fields.text("kind", "a kind of joint")
    if kind not in (*KINDS, "undecided"):
        raise fields.error("kind", f"is {kind!r}"[:60], f"one of {(*KINDS, 'undecided')}")
    table = fields.table("kind_probability", "a probability for each kind")
    probability = {name: table.number(name) for name in table.values}
    if not probability or not set(probability) <= set(KINDS):
        raise fields.error("kind_probability", "names other kinds", f"some of {KINDS}")
    likeliest = max(probability, key=probability.__getitem__)
    alternatives = _alternatives(fields, probability, likeliest)
    return ArticulationPosterior(
        name=fields.text("input", "the input's name"),
        kind=cast(NamedKind, kind),
        kind_probability=probability,
        alternatives=alternatives,
        fit=_report(fields.table("fit", "an object that says how the fit went")),
        time_s=_times(fields),
    )


def _alternatives(
    fields: Fields, probability: dict[str, float], likeliest: str
) -> dict[str, KindPosterior]:
    evidence = fields.table("evidence", "the evidence of each kind")
    others = fields.table("alternatives", "the joints of the other kinds")
    if likeliest not in evidence.values:
        raise fields.error("evidence", f"says nothing of {likeliest}", "every kind that was fitted")
    found = {}
    for kind in evidence.values:
        if kind not in probability:
            raise fields.error("evidence", f"names {kind!r}"[:60], f"some of {KINDS}")
        own = kind == likeliest
        place = fields if own else others.table(kind, "an object with joint and log_evidence")
        joint = _joint(place.table("joint", "a joint"), kind) if place.has("joint") else None
        if (joint is None) != (kind == "rigid"):
            raise place.error("joint", f"does not go with {kind}", "a joint of what moves")
        states = _states(place.table("states", "states")) if own and place.has("states") else None
        said = evidence.table(kind, "the terms of its evidence")
        terms = {f.name: _number(said, f.name) for f in fields_of(Evidence)}
        found[kind] = KindPosterior(joint, states, Evidence(**terms))
    return found


def _joint(fields: Fields, kind: str) -> JointPosterior:
    if fields.text("kind", "a kind of joint") != kind:
        raise fields.error("kind", f"is not {kind}", "the kind that it is named by")
    cov = fields.array("cov", (6, 6), "a symmetric 6x6, rotation first")
    scale = max(float(np.abs(cov).max()), 1e-300)
    if np.abs(cov - cov.T).max() > _SYMMETRY_TOLERANCE * scale:
        raise fields.error("cov", "is not symmetric", "a covariance")
    if np.linalg.eigvalsh(cov)[0] < -_SYMMETRY_TOLERANCE * scale:
        raise fields.error("cov", "is negative in some direction", "a covariance")
    T_world_joint = fields.pose("T_world_joint").matrix()
    row = JointKind(kind)
    pitch = fields.number("pitch_m_per_rad") if row.has_pitch else 0.0
    known = row.has_pitch and fields.has("pitch_sd_m_per_rad")
    sd = fields.number("pitch_sd_m_per_rad") if known else None
    return JointPosterior(Joint(row, T_world_joint, pitch), cov, sd)


def _states(fields: Fields) -> StatePosterior:
    unit = fields.text("unit", "m or rad")
    if unit not in ("m", "rad"):
        raise fields.error("unit", f"is {unit!r}"[:60], "m or rad")
    mean, sd = _numbers(fields, "mean"), _numbers(fields, "sd")
    if mean.shape != sd.shape:
        raise fields.error("sd", f"has {sd.size} numbers", f"{mean.size}, one for each of `mean`")
    return StatePosterior(cast(Unit, unit), mean, sd)


def _numbers(fields: Fields, name: str) -> FloatArray:
    """A list of numbers, null where unknown: NaN."""
    expected = "a list of numbers, null where unknown"
    values = fields.get(name, expected)
    if not isinstance(values, list):
        raise fields.error(name, "is no list", expected)
    known = Fields(fields.path, {name: [0.0 if v is None else v for v in values]}, fields.prefix)
    numbers = known.array(name, (None,), expected)
    numbers[[v is None for v in values]] = np.nan
    return numbers


def _number(fields: Fields, name: str) -> float:
    """A number, null where it was not finite: NaN."""
    fields.get(name, "a number, or null")
    return fields.number(name) if fields.has(name) else float("nan")


def _report(fields: Fields) -> FitReport:
    numbers: dict[str, Any] = {}
    for name in ("tracks_used", "tracks_rejected", "patches_used", "rows_left_out"):
        numbers[name] = int(fields.number(name))
    for name in ("log_evidence", "rms_m", "noise_scale", "correlation_frames"):
        numbers[name] = _number(fields, name)
    numbers["correlation_points"] = _number(fields, "correlation_points")
    for name in ("patches_rms_m", "patches_as_one"):
        numbers[name] = fields.number(name) if fields.has(name) else None
    warnings = fields.get("warnings", "a list of lines")
    if not isinstance(warnings, list) or not all(isinstance(line, str) for line in warnings):
        raise fields.error("warnings", "is something else", "a list of lines")
    keyframes = fields.array("keyframes_registered", (None,), "numbers of frames")
    return FitReport(
        parametric=fields.get("parametric", "true or false") is True,
        warnings=tuple(warnings),
        keyframes_registered=tuple(int(k) for k in keyframes),
        holds=tuple((int(a), int(b)) for a, b in _pairs(fields, "holds")),
        **numbers,
    )


def _pairs(fields: Fields, name: str) -> FloatArray:
    """(N, 2); an empty list has no second dimension."""
    expected = "pairs of numbers of frames"
    if fields.get(name, expected) == []:
        return np.zeros((0, 2))
    return fields.array(name, (None, 2), expected)


def _times(fields: Fields) -> dict[str, float]:
    table = fields.table("time_s", "seconds by stage")
    return {name: _number(table, name) for name in table.values}
