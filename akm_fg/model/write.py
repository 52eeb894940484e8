"""Writes `model.json` and its surfaces, the new model beside the old one.

A model that is there becomes `model-1.json` (`model-2.json`, ...) and keeps its own surfaces: the
new ones have names of their own. `model.json` is replaced last, in one step, so a reader finds the
old model or the new one, whole.
"""

from __future__ import annotations

import io
import json
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from akm_fg.errors import OutputError
from akm_fg.io.png import replace_file
from akm_fg.io.posteriors.posterior_json import posterior_as_dict
from akm_fg.model.read import FILE, SCHEMA
from akm_fg.model.records import Contact, ModelPart, ObjectModel, Surface


def write_model(folder: Path, model: ObjectModel) -> Path:
    """Write a model into a folder that exists.

    Args:
        folder: where to; an older model there is kept under another name.
        model: to be written.

    Returns:
        The path of `model.json`.

    Raises:
        OutputError: the disk refuses; what was there is as it was.
    """
    file = Path(folder) / FILE
    old, exists = _next_version(file), file.exists()
    new = old if exists else old - 1  # kept models and the one there: each has surfaces of its own
    suffix = f"-{new}" if new else ""
    surfaces = [f"part-{i}{suffix}.npz" for i in range(len(model.parts))]
    static = f"static{suffix}.npz"
    for name, surface in zip(
        [*surfaces, static], [*(part.surface for part in model.parts), model.static], strict=True
    ):
        replace_file(file.with_name(name), _archive(surface))
    if exists:
        _keep(file, file.with_name(f"model-{old}.json"))
    text = json.dumps(_as_dict(model, surfaces, static), indent=1, allow_nan=False)
    replace_file(file, (text + "\n").encode())
    return file


def set_aside(folder: Path) -> None:
    """Give a model that is there the name of an older one.

    Raises:
        OutputError: the disk refuses.
    """
    file = Path(folder) / FILE
    if not file.exists():
        return
    try:
        file.rename(file.with_name(f"model-{_next_version(file)}.json"))
    except OSError as error:
        raise OutputError(f"{file}: cannot be renamed ({error.strerror})") from error


def _next_version(file: Path) -> int:
    """The first number from 1 on that no kept model has."""
    return next(n for n in count(1) if not file.with_name(f"model-{n}.json").exists())


def _keep(file: Path, place: Path) -> None:
    try:
        old = file.read_bytes()
    except OSError as error:
        raise OutputError(f"{file}: cannot be kept ({error.strerror})") from error
    replace_file(place, old)


def _archive(surface: Surface) -> bytes:
    """Points and normals in single precision: a tenth of a micrometre at a metre."""
    file = io.BytesIO()
    arrays: dict[str, Any] = {
        "points": surface.p_world.astype(np.float32),
        "normals": surface.normal_world.astype(np.float32),
        "colours": surface.rgb,
    }
    if surface.on_object is not None:
        arrays["on_object"] = surface.on_object
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def _as_dict(model: ObjectModel, surfaces: list[str], static: str) -> dict[str, Any]:
    camera = model.camera
    return {
        "schema": SCHEMA,
        "frame": "world",
        "parts": [_part(*each) for each in zip(model.parts, surfaces, strict=True)],
        "static": {"surface": static},
        "camera": {
            "width": camera.width,
            "height": camera.height,
            "fx": camera.fx,
            "fy": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "T_world_cam": model.T_world_cam.matrix().tolist(),
        },
        "from": list(model.sources),
    }


def _part(part: ModelPart, surface: str) -> dict[str, Any]:
    limits = part.limits
    fields: dict[str, Any] = {
        "name": part.name,
        "posterior": posterior_as_dict(part.posterior),
        "closed_state": part.closed_state,
        "limits": None
        if limits is None
        else {"lower": limits.lower, "upper": limits.upper, "sd": limits.sd},
        "contacts": [_contact(contact) for contact in part.contacts],
        "surface": surface,
    }
    if part.correction is not None:
        fields["correction"] = {
            "T_world_seen": part.correction.T_world_seen.matrix().tolist(),
            "cov_seen_joint": part.correction.cov_seen_joint.tolist(),
            "length_share": part.correction.length_share,
            "length_share_sd": part.correction.length_share_sd,
        }
    if part.sources:  # of a model with one part they are the model's
        fields["from"] = list(part.sources)
    return fields


def _contact(contact: Contact) -> dict[str, Any]:
    return {
        "T_part_grasp": contact.T_part_grasp.matrix().tolist(),
        "state": contact.state,
        "succeeded": contact.succeeded,
        "failed": contact.failed,
    }
