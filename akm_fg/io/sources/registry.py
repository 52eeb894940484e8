"""Which format a source has, and the source as a recording.

The formats are the files of `akm_fg/io/sources/formats`: each has `NAME`, `recognises(path)`, which
looks at names and first bytes alone, and `open_source(path, options)`.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module
from pathlib import Path
from types import ModuleType

from akm_fg.errors import InputError
from akm_fg.io.conventions import InputConventions
from akm_fg.io.recording_reader import check_memory
from akm_fg.io.sources import formats
from akm_fg.io.sources.prepare import Prepared, prepare
from akm_fg.io.sources.source import SourceOptions
from akm_fg.records import Recording


def format_of(path: Path) -> ModuleType | None:
    """The format that recognises a file or folder; None if none does."""
    for found in sorted(pkgutil.iter_modules(formats.__path__), key=lambda module: module.name):
        module = import_module(f"{formats.__name__}.{found.name}")
        if module.recognises(path):
            return module
    return None


def known_formats() -> list[str]:
    """What each format is called, for a person."""
    names = sorted(module.name for module in pkgutil.iter_modules(formats.__path__))
    return [str(import_module(f"{formats.__name__}.{name}").NAME) for name in names]


def open_prepared(
    path: Path,
    options: SourceOptions | None = None,
    said: InputConventions | None = None,
    first_frames: int | None = None,
) -> Prepared:
    """Open a source of a known format and find out how to read it.

    Raises:
        InputError: of no known format, or broken.
        MissingDependency: the library that reads it is not installed.
    """
    module = format_of(path)
    if module is None:
        if (path / "recording.json").exists():
            raise InputError(path, "is a recording folder already", "another format; fit reads it")
        problem = "is of no format that is known" if path.exists() else "does not exist"
        raise InputError(path, problem, ", ".join(known_formats()))
    options = options or SourceOptions()
    source = module.open_source(path, options)
    return prepare(source, options, said or InputConventions(), first_frames)


def read_source(
    path: Path,
    options: SourceOptions | None = None,
    said: InputConventions | None = None,
    first_frames: int | None = None,
) -> Recording:
    """A source of a known format as a recording, with notes on what was guessed.

    Raises:
        InputError: of no known format, or broken.
        MissingDependency: the library that reads it is not installed.
    """
    prepared = open_prepared(path, options, said, first_frames)
    check_memory(path, prepared.registration.camera, len(prepared.places))
    frames = tuple(frame for frame, _ in prepared.frames())
    name = path.name or path.resolve().name
    notes = prepared.understood.notes
    return Recording(name, frames, T_world_gripper=prepared.grippers, notes=notes)
