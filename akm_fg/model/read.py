"""Reads `model.json` and the surfaces beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from akm_fg.errors import InputError
from akm_fg.io.arrays.npz import load_arrays
from akm_fg.io.json_fields import Fields, load_json_object
from akm_fg.io.posteriors.posterior_reader import posterior_from_fields
from akm_fg.model.records import Contact, ModelPart, ObjectModel, StateLimits, Surface
from akm_fg.records import CameraCorrection, PinholeCamera

SCHEMA = "akm-fg/model/1"
FILE = "model.json"
WHAT = f"the model of an object ({SCHEMA})"
UNIT_TOLERANCE = 1e-2  # of a normal's length: stored as float32


def read_model(path: Path) -> ObjectModel:
    """Read a model.

    Args:
        path: of `model.json`, or of the folder that holds it.

    Raises:
        InputError: missing, damaged, of another schema, or it contradicts itself.
    """
    path = Path(path)
    try:
        file = path / FILE if path.is_dir() else path
    except (OSError, ValueError) as error:
        raise InputError(path, "is not a usable path", WHAT) from error
    fields = Fields(file, load_json_object(file, WHAT))
    schema = fields.text("schema", f"the string {SCHEMA!r}")
    if schema != SCHEMA:
        raise fields.error("schema", f"is {schema!r}"[:80], f"{SCHEMA!r}")
    static = fields.table("static", "an object with surface")
    camera = fields.table("camera", "an object with width, height, fx, fy, cx, cy, T_world_cam")
    try:
        return ObjectModel(
            tuple(_part(table) for table in _tables(fields, "parts")),
            _surface(static),
            _camera(camera),
            camera.pose("T_world_cam"),
            _names(fields),
        )
    except ValueError as error:
        raise InputError(file, str(error), WHAT) from error


def _tables(fields: Fields, name: str) -> list[Fields]:
    expected = "a list of objects"
    values = fields.get(name, expected)
    if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
        raise fields.error(name, "is something else", expected)
    return [
        Fields(fields.path, value, f"{fields.prefix}{name}[{i}].") for i, value in enumerate(values)
    ]


def _names(fields: Fields) -> tuple[str, ...]:
    values: Any = fields.get("from", "a list of recordings")
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise fields.error("from", "is something else", "a list of recordings")
    return tuple(values)


def _camera(fields: Fields) -> PinholeCamera:
    size = fields.positive_integer("width"), fields.positive_integer("height")
    focal = fields.positive("fx"), fields.positive("fy")
    return PinholeCamera(*size, *focal, fields.number("cx"), fields.number("cy"))


def _part(fields: Fields) -> ModelPart:
    posterior = posterior_from_fields(fields.table("posterior", "an akm-fg/posterior/1"))
    if posterior.best.joint is None:
        raise fields.error("posterior", "has no joint", "the posterior of a part that moves")
    limits = None
    if fields.has("limits"):
        table = fields.table("limits", "an object with lower, upper, sd, or null")
        try:
            limits = StateLimits(table.number("lower"), table.number("upper"), table.number("sd"))
        except ValueError as error:
            raise fields.error("limits", "contradict themselves", str(error)) from error
    return ModelPart(
        fields.text("name", "the part's name"),
        posterior,
        _surface(fields),
        fields.number("closed_state"),
        limits,
        tuple(_contact(table) for table in _tables(fields, "contacts")),
        _names(fields) if fields.has("from") else (),
        _correction(fields) if fields.has("correction") else None,
    )


def _correction(fields: Fields) -> CameraCorrection:
    table = fields.table("correction", "as docs/model.md has it")
    cov = table.array("cov_seen_joint", (6, 6), "6x6 numbers")
    share, sd = table.number("length_share"), table.number("length_share_sd")
    try:
        return CameraCorrection(table.pose("T_world_seen"), cov, share, sd)
    except ValueError as error:
        raise fields.error("correction", "cannot be", str(error)) from error


def _contact(fields: Fields) -> Contact:
    counts = []
    for name in ("succeeded", "failed"):
        count = fields.number(name, "a whole number from 0 on")
        if count < 0 or not count.is_integer():
            raise fields.error(name, f"is {count:g}", "a whole number from 0 on")
        counts.append(int(count))
    return Contact(fields.pose("T_part_grasp"), fields.number("state"), *counts)


def _surface(fields: Fields) -> Surface:
    """The archive that `surface` names, which lies beside the model."""
    name = fields.text("surface", "the name of an .npz beside the model")
    if name in (".", "..") or Path(name).name != name:
        raise fields.error("surface", f"is {name!r}"[:80], "the name of a file beside the model")
    path = fields.path.parent / name
    expected = "points (N, 3), normals (N, 3) and colours (N, 3)"
    names = ("points", "normals", "colours", "on_object")
    arrays = load_arrays(path, names, f"a surface: {expected}")
    missing = sorted({"points", "normals", "colours"} - set(arrays))
    if missing:
        raise InputError(path, f"has no `{missing[0]}`", expected)
    try:
        points, normals = (np.asarray(arrays[k], np.float64) for k in ("points", "normals"))
        surface = Surface(points, normals, arrays["colours"], arrays.get("on_object"))
    except (ValueError, TypeError) as error:
        raise InputError(path, f"is no surface ({error})", expected) from error
    lengths = np.linalg.norm(surface.normal_world, axis=1)
    if (np.abs(lengths - 1) > UNIT_TOLERANCE).any():
        raise InputError(path, "holds a normal whose length is not 1", expected)
    return surface
