"""What is known of a built object and its place, as a file beside its URDF.

Numbers are written so that they come back bit for bit: an object from the cache is the object
that was built.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from sim.bullet import pose_from_matrix
from sim.objects.part_spec import BuiltObject, PartSpec
from sim.objects.placement import Placement

RECORD = "object.json"
URDF = "object.urdf"


def spec_text(spec: PartSpec) -> str:
    """Everything in a spec, in full precision, on one line."""
    fields = asdict(spec)  # type: ignore[call-overload]
    return json.dumps({"is": type(spec).__name__, **fields}, default=_plain, sort_keys=True)


def write_record(folder: Path, built: BuiltObject, placement: Placement) -> None:
    """Writes the record beside the object's URDF, which must be in `folder`."""
    assert built.urdf == folder / URDF
    record = {
        "built": {name: getattr(built, name) for name in _BUILT},
        "placement": {name: getattr(placement, name) for name in _PLACEMENT},
    }
    (folder / RECORD).write_text(json.dumps(record, default=_plain), encoding="utf-8")


def read_record(folder: Path, spec: PartSpec) -> tuple[BuiltObject, Placement]:
    """The object of `spec` and its place, as built in `folder`."""
    record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    built = {name: _restored(value) for name, value in record["built"].items()}
    placement = {name: _restored(value) for name, value in record["placement"].items()}
    return BuiltObject(spec=spec, urdf=folder / URDF, **built), Placement(**placement)


_BUILT = tuple(name for name in BuiltObject.__dataclass_fields__ if name not in ("spec", "urdf"))
_PLACEMENT = tuple(Placement.__dataclass_fields__)


def _plain(value: Any) -> Any:
    if isinstance(value, gtsam.Pose3):
        return value.matrix().tolist()
    if isinstance(value, Path):
        return str(value)
    return value.tolist()


def _restored(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    numbers = np.array(value, dtype=float) if value else np.zeros((0, 3))
    return pose_from_matrix(numbers) if numbers.shape == (4, 4) else numbers
