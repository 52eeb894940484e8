"""A memory on disk: `contacts.json` says what is remembered, an npz beside it holds the arrays.

    {"schema": "akm-fg/contacts/1", "made_by": "network/layer/size", "arrays": "arrays-DIGEST.npz",
     "contacts": [{"object", "family", "kind", "contact_uv": [2], "contact_world": [3],
                   "direction_front": [3], "picture": [first, last], "mask": [first, last]}]}

The npz holds `features` and `descriptors` (N, C) and `pictures`, all bytes of the JPEGs and PNGs
of the crops behind one another; `picture` and `mask` say where each lies. Growing is atomic: the
arrays get a new name first, then the JSON takes the place of the old one, and a lock on the folder
lets one writer in at a time. So a reader finds the memory before or after, never between.
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from akm_fg.errors import InputError, OutputError
from akm_fg.exploration.analogy.contacts import (
    MAX_CROP_PX,
    ContactMemory,
    OpeningKind,
    RememberedContact,
)
from akm_fg.io.arrays.npz import load_arrays
from akm_fg.io.json_fields import Fields, load_json_object

SCHEMA = "akm-fg/contacts/1"
INDEX = "contacts.json"
WHAT = f"a folder of remembered contacts ({SCHEMA})"
JPEG_QUALITY = 90
MAX_CONTACTS = 100_000
DIGITS = 12  # of the content's digest, in the arrays' name
PART = ".part"  # of files that are being written


def read_memory(path: Path) -> ContactMemory:
    """The memory that a folder holds.

    Raises:
        InputError: no such folder, another schema, or a broken one.
    """
    if not path.is_dir():
        raise InputError(path, "is not a folder" if path.exists() else "does not exist", WHAT)
    try:
        with _locked(path, fcntl.LOCK_SH):
            return _read(path)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})", WHAT) from error


def write_memory(path: Path, memory: ContactMemory) -> None:
    """Put a memory into a folder, in the place of one that it holds.

    Raises:
        OutputError: the disk refuses.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with _locked(path, fcntl.LOCK_EX):
            _write(path, memory)
    except OSError as error:
        raise _refused(path, error) from error


def add_contact(path: Path, contact: RememberedContact, made_by: str) -> ContactMemory:
    """Add to the memory of a folder, or begin one; what others add at the same time stays.

    Returns the memory as it is then.

    Raises:
        InputError: what the folder holds is broken.
        OutputError: the disk refuses.
        ValueError: the contact is described by other features than the memory.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with _locked(path, fcntl.LOCK_EX):
            before = _read(path) if (path / INDEX).exists() else ContactMemory(made_by, ())
            memory = before.with_contact(contact, made_by)
            _write(path, memory)
    except OSError as error:
        raise _refused(path, error) from error
    return memory


@contextmanager
def _locked(folder: Path, how: int) -> Iterator[None]:
    """Alone with the folder, or together with other readers."""
    number = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(number, how)
        yield
    finally:
        os.close(number)


def _refused(path: Path, error: OSError) -> OutputError:
    why = error.strerror or str(error)
    return OutputError(f"{path}: cannot be written ({why}); expected a folder that has room")


def _write(path: Path, memory: ContactMemory) -> None:
    pictures, rows = bytearray(), []
    for contact in memory.contacts:
        row = _row(contact)
        for name, image in (("picture", contact.crop_rgb), ("mask", contact.crop_mask)):
            first = len(pictures)
            pictures += _encoded(image)
            row[name] = [first, len(pictures)]
        rows.append(row)
    written = io.BytesIO()
    np.savez(
        written,
        features=_stacked([contact.feature for contact in memory.contacts]),
        descriptors=_stacked([contact.descriptor for contact in memory.contacts]),
        pictures=np.frombuffer(bytes(pictures), dtype=np.uint8),
    )
    content = written.getvalue()
    arrays = path / f"arrays-{hashlib.sha256(content).hexdigest()[:DIGITS]}.npz"
    _put(arrays, content)
    said = {
        "schema": SCHEMA,
        "made_by": memory.made_by,
        "arrays": arrays.name,
        "contacts": rows,
    }
    _put(path / INDEX, (json.dumps(said, indent=1) + "\n").encode())
    for other in (*path.glob("arrays-*.npz"), *path.glob(f"*{PART}")):
        if other != arrays:
            other.unlink()


def _put(path: Path, content: bytes) -> None:
    """A file with all of its content, or as it was before."""
    part = path.with_suffix(PART)  # one writer at a time: see `_locked`
    part.write_bytes(content)
    os.replace(part, path)


def _stacked(vectors: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    return np.array(vectors, dtype=np.float32).reshape(len(vectors), -1)


def _encoded(image: NDArray) -> bytes:
    """A picture as JPEG, a mask as PNG."""
    file = io.BytesIO()
    if image.dtype == bool:
        Image.fromarray(image).save(file, "PNG", optimize=True)
    else:
        Image.fromarray(image).save(file, "JPEG", quality=JPEG_QUALITY)
    return file.getvalue()


def _row(contact: RememberedContact) -> dict[str, Any]:
    return {
        "object": contact.object_name,
        "family": contact.family,
        "kind": contact.kind,
        "contact_uv": np.round(contact.contact_uv, 2).tolist(),
        "contact_world": np.round(contact.contact_world, 4).tolist(),
        "direction_front": np.round(contact.direction_front, 5).tolist(),
    }


def _read(path: Path) -> ContactMemory:
    index = path / INDEX
    fields = Fields(index, load_json_object(index, WHAT))
    schema = fields.text("schema", SCHEMA)
    if schema != SCHEMA:
        raise fields.error("schema", f"is {schema!r}"[:60], SCHEMA)
    rows = fields.get("contacts", "a list of contacts")
    if not isinstance(rows, list) or len(rows) > MAX_CONTACTS:
        raise fields.error("contacts", "is no list, or too long", f"{MAX_CONTACTS} at most")
    name = fields.text("arrays", "a file's name")
    if Path(name).name != name:
        raise fields.error("arrays", f"is {name!r}"[:60], "the name of a file in the folder")
    arrays = load_arrays(path / name, ("features", "descriptors", "pictures"), WHAT)
    _check(path / name, arrays, len(rows))
    contacts = []
    for i, row in enumerate(rows):
        if not isinstance(row, dict):
            raise fields.error(f"contacts[{i}]", "is no object", "an object")
        of_row = Fields(index, row, f"contacts[{i}].")
        feature = arrays["features"][i].astype(np.float32)
        descriptor = arrays["descriptors"][i].astype(np.float32)
        contacts.append(_contact(of_row, arrays["pictures"], feature, descriptor))
    return ContactMemory(fields.text("made_by", "a text"), tuple(contacts))


def _check(path: Path, arrays: dict[str, NDArray[Any]], n: int) -> None:
    """Refuse arrays that are absent or of other shapes than the index says."""
    for name in ("features", "descriptors", "pictures"):
        if name not in arrays:
            raise InputError(path, f"holds no `{name}`", WHAT)
    features, descriptors = arrays["features"], arrays["descriptors"]
    if features.ndim != 2 or features.shape != descriptors.shape or len(features) != n:
        problem = f"features {features.shape}, descriptors {descriptors.shape}"
        raise InputError(path, problem, f"({n}, C) each")
    if not (_finite(features) and _finite(descriptors)):
        raise InputError(path, "holds features that are no finite numbers", WHAT)
    if arrays["pictures"].dtype != np.uint8 or arrays["pictures"].ndim != 1:
        raise InputError(path, "`pictures` are no bytes", WHAT)


def _finite(array: NDArray[Any]) -> bool:
    return bool(np.issubdtype(array.dtype, np.floating) and np.isfinite(array).all())


def _contact(
    fields: Fields,
    pictures: NDArray[np.uint8],
    feature: NDArray[np.float32],
    descriptor: NDArray[np.float32],
) -> RememberedContact:
    expected = f"one of {', '.join(get_args(OpeningKind))}"
    kind = fields.text("kind", expected)
    if kind not in get_args(OpeningKind):
        raise fields.error("kind", f"is {kind!r}"[:60], expected)
    rgb = np.asarray(_decoded(fields, pictures, "picture").convert("RGB"))
    mask = np.asarray(_decoded(fields, pictures, "mask").convert("1"))
    try:
        return RememberedContact(
            object_name=fields.text("object", "a text"),
            family=fields.text("family", "a text"),
            kind=kind,  # type: ignore[arg-type]
            crop_rgb=rgb,
            crop_mask=mask,
            contact_uv=fields.array("contact_uv", (2,), "a pixel"),
            contact_world=fields.array("contact_world", (3,), "a point"),
            direction_front=fields.array("direction_front", (3,), "a unit vector"),
            feature=feature,
            descriptor=descriptor,
        )
    except ValueError as error:
        raise InputError(fields.path, f"`{fields.prefix[:-1]}`: {error}", WHAT) from error


def _decoded(fields: Fields, pictures: NDArray[np.uint8], name: str) -> Image.Image:
    """A picture of at most the size that a crop has; its size is read before its pixels."""
    first, last = (int(x) for x in fields.array(name, (2,), "first and last byte"))
    if not 0 <= first < last <= len(pictures):
        raise fields.error(name, f"is {first} to {last}", f"bytes of {len(pictures)}")
    try:
        image = Image.open(io.BytesIO(pictures[first:last].tobytes()), formats=("JPEG", "PNG"))
        if max(image.size) > MAX_CROP_PX:
            raise fields.error(name, f"is {image.size} pixels", f"at most {MAX_CROP_PX}")
        image.load()
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise fields.error(name, "cannot be decoded", "a JPEG or PNG") from error
    return image
