"""What a description has no place for: how sure its joints are, and what in it is nominal."""

from __future__ import annotations

import json
import math
from typing import Any

from akm_fg.export.description import Description, ExportedJoint
from akm_fg.model.records import ModelPart, ObjectModel

SCHEMA = "akm-fg/export/1"


def uncertainty_json(model: ObjectModel, description: Description) -> bytes:
    """`joints.json`: format in docs/model.md."""
    joints = [
        _joint(part, joint) for part, (joint, _) in zip(model.parts, description.parts, strict=True)
    ]
    fields = {
        "schema": SCHEMA,
        "frame": "world",
        "joints": joints,
        "nominal": ["mass", "inertia", "effort", "velocity"],
        "from": list(model.sources),
    }
    return (json.dumps(fields, indent=1, allow_nan=False) + "\n").encode()


def _joint(part: ModelPart, joint: ExportedJoint) -> dict[str, Any]:
    found, limits = part.joint, part.limits
    pivot_bound_m = found.pivot_bound_m()
    return {
        "name": joint.name,
        "kind": str(joint.kind),
        "kind_probability": part.posterior.kind_probability,
        "T_world_joint": found.T_world_joint.tolist(),
        "cov": found.cov.tolist(),  # of the tangent of T_world_joint, rotation first
        "gauge": list(found.gauge),
        "axis": found.axis.tolist(),
        "axis_bound_deg": math.degrees(found.axis_bound_rad()),
        "pivot": None if found.pivot is None else found.pivot.tolist(),
        "pivot_bound_m": pivot_bound_m,
        "pitch_m_per_rad": found.pitch_m_per_rad,
        "pitch_sd_m_per_rad": found.pitch_sd_m_per_rad,
        "closed_state": part.closed_state,  # position 0 of the description is this state
        "limits": {
            "lower": joint.lower,
            "upper": joint.upper,
            "sd": None if limits is None else limits.sd,
            "met": joint.limits_met,  # false: the range that was seen
        },
    }
