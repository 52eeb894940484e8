"""A posterior as plain values (docs/conventions.md), and as words for a person."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from akm_fg.errors import MissingDependency
from akm_fg.posterior import (
    ArticulationPosterior,
    Evidence,
    JointPosterior,
    KindPosterior,
    StatePosterior,
    normal_bound,
)
from akm_fg.records import FloatArray

if TYPE_CHECKING:
    import pandas

SCHEMA = "akm-fg/posterior/1"


def posterior_as_dict(posterior: ArticulationPosterior) -> dict[str, Any]:
    """Plain numbers, lists and strings; unknown is None.

    A number that is not finite is None too, and `fit.warnings` says where. `joint` and `states`
    are those of the most probable kind, named in `joint.kind`; `kind` itself may be "undecided".
    """
    fields = _fields(posterior)
    lost = sorted({place for key, value in fields.items() for place in _not_finite(value, key)})
    if lost:
        fields["fit"]["warnings"].append("not finite, null here: " + ", ".join(lost))
        fields = {key: finite(value) for key, value in fields.items()}
    return fields


def _fields(posterior: ArticulationPosterior) -> dict[str, Any]:
    best = posterior.best
    most_probable = next(k for k, v in posterior.alternatives.items() if v is best)
    return {
        "schema": SCHEMA,
        "input": posterior.name,
        "frame": "world",
        "kind": posterior.kind,
        "kind_probability": posterior.kind_probability,
        "joint": _joint(best.joint),
        "states": _states(best.states),
        "evidence": {
            kind: _evidence(alternative.evidence)
            for kind, alternative in posterior.alternatives.items()
        },
        "alternatives": {
            kind: _alternative(alternative)
            for kind, alternative in posterior.alternatives.items()
            if kind != most_probable
        },
        "fit": {
            "log_evidence": posterior.fit.log_evidence,
            "tracks_used": posterior.fit.tracks_used,
            "tracks_rejected": posterior.fit.tracks_rejected,
            "rms_m": posterior.fit.rms_m,
            "noise_scale": posterior.fit.noise_scale,
            "correlation_frames": posterior.fit.correlation_frames,
            "correlation_points": posterior.fit.correlation_points,
            "keyframes_registered": list(posterior.fit.keyframes_registered),
            "patches_used": posterior.fit.patches_used,
            "patches_rms_m": posterior.fit.patches_rms_m,
            "patches_as_one": posterior.fit.patches_as_one,
            "rows_left_out": posterior.fit.rows_left_out,
            "holds": [list(hold) for hold in posterior.fit.holds],
            "parametric": posterior.fit.parametric,
            "warnings": list(posterior.fit.warnings),
        },
        "other_parts": [_other_part(other) for other in posterior.other_parts],
        "time_s": posterior.time_s,
    }


def _other_part(posterior: ArticulationPosterior) -> dict[str, Any]:
    return {
        "kind": posterior.kind,
        "kind_probability": posterior.kind_probability,
        "joint": _joint(posterior.best.joint),
        "states": _states(posterior.best.states),
        "tracks_used": posterior.fit.tracks_used,
    }


def _states(states: StatePosterior | None) -> dict[str, Any] | None:
    if states is None:
        return None
    return {
        "unit": states.unit,
        "mean": _numbers(states.mean),
        "sd": _numbers(states.sd),
        "last_seen_frame": states.last_seen,
    }


def _alternative(alternative: KindPosterior) -> dict[str, Any]:
    return {"joint": _joint(alternative.joint), "log_evidence": alternative.log_evidence}


def _evidence(evidence: Evidence) -> dict[str, float]:
    return {**asdict(evidence), "log_evidence": evidence.total}


def _joint(joint: JointPosterior | None) -> dict[str, Any] | None:
    if joint is None:
        return None
    return {
        "kind": joint.kind,
        "T_world_joint": joint.T_world_joint.tolist(),
        "cov": joint.cov.tolist(),
        "gauge": list(joint.gauge),
        "axis": joint.axis.tolist(),
        "pivot": None if joint.pivot is None else joint.pivot.tolist(),
        "axis_sd_deg": math.degrees(joint.axis_sd_rad),
        "pivot_sd_m": joint.pivot_sd_m,
        "pitch_m_per_rad": joint.pitch_m_per_rad,
        "pitch_sd_m_per_rad": joint.pitch_sd_m_per_rad,
    }


def _numbers(values: FloatArray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]


def _not_finite(value: Any, place: str) -> Iterator[str]:
    """Where numbers are that JSON does not have; entries of lists by the list's name."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _not_finite(inner, f"{place}.{key}")
    elif isinstance(value, list):
        for inner in value:
            yield from _not_finite(inner, place)
    elif isinstance(value, float) and not math.isfinite(value):
        yield place


def finite(value: Any) -> Any:
    """The same with None for what is not finite."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def posterior_in_words(posterior: ArticulationPosterior) -> list[str]:
    """Kind, axis, pivot, pitch, states and warnings, a line each; bounds hold 95 %."""
    kind = posterior.kind
    p = posterior.kind_probability
    likeliest = max(p, key=p.__getitem__)
    named = kind if kind == likeliest else f"{kind}, most probable {likeliest}"
    best = posterior.best
    lines = [f"{posterior.name}: {named} (probability {_probability(p[likeliest])})"]
    if best.joint is not None:
        lines += _joint_words(best.joint)
    if best.states is not None:
        lines += _state_words(best.states)
    if not posterior.fit.parametric:
        lines.append("no joint kind explains the data")
    return [*lines, *(f"note: {warning}" for warning in posterior.fit.warnings)]


def states_as_frame(
    posterior: ArticulationPosterior, stamps_s: Sequence[float] | None = None
) -> pandas.DataFrame:
    """States, deviations and 95 % bounds; see `ArticulationPosterior.states_frame`."""
    try:
        import pandas
    except ImportError as error:
        missing = "a frame of states needs pandas; install akm-fg[pandas]"
        raise MissingDependency(missing) from error
    best = posterior.best
    if best.joint is None or best.states is None:
        raise ValueError(f"{posterior.name}: nothing moves; expected a part with states")
    mean, sd = best.states.mean, best.states.sd
    if stamps_s is not None and len(stamps_s) != mean.size:
        raise ValueError(f"{len(stamps_s)} stamps, expected {mean.size}, one a frame")
    index = range(mean.size) if stamps_s is None else stamps_s
    name = "frame" if stamps_s is None else "stamp_s"
    bound = normal_bound() * sd
    columns = {"state": mean, "sd": sd, "low": mean - bound, "high": mean + bound}
    frame = pandas.DataFrame(columns, index=pandas.Index(index, name=name))
    frame.attrs.update(unit=best.states.unit, kind=str(best.joint.kind), input=posterior.name)
    return frame


def _probability(p: float) -> str:
    """Never rounded to certainty."""
    return "> 0.999" if p > 0.9995 else f"{p:.3f}"


def _joint_words(joint: JointPosterior) -> list[str]:
    bound_deg = math.degrees(joint.axis_bound_rad())
    lines = [f"axis {_vector(joint.axis)} ± {bound_deg:.2g} deg"]
    pivot_bound_m = joint.pivot_bound_m()
    if joint.pivot is not None and pivot_bound_m is not None:
        lines.append(f"pivot {_vector(joint.pivot)} m ± {100 * pivot_bound_m:.2g} cm")
    if joint.pitch_m_per_rad is not None:
        lines.append(f"pitch {2000 * math.pi * joint.pitch_m_per_rad:.3g} mm a turn")
    return lines


def _state_words(states: StatePosterior) -> list[str]:
    seen = np.flatnonzero(np.isfinite(states.mean))
    if not seen.size:
        return ["seen in no frame"]
    last = int(seen[-1])
    scale, unit = (math.degrees(1), "deg") if states.unit == "rad" else (100.0, "cm")
    bound = normal_bound() * float(states.sd[last]) * scale
    value = f"{scale * float(states.mean[last]):.2f} ± {bound:.2g} {unit}"
    return [f"state {value} in frame {last}, seen in {seen.size} of {states.mean.size} frames"]


def _vector(v: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.3f}" for x in np.round(v, 3) + 0.0) + ")"
