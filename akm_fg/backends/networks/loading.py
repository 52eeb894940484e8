"""Optional packages and local checkpoints: either what is asked for, or one plain line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from akm_fg.errors import InputError, MissingDependency


@contextmanager
def packages_of(who: str, install: str) -> Iterator[None]:
    """Inside, a package that does not load is said in a line.

    Args:
        who: needs it, for the message.
        install: what to install.

    Raises:
        MissingDependency: a package is absent, or does not load.
    """
    try:
        yield
    except (ImportError, OSError) as error:
        name = getattr(error, "name", None) or str(error).splitlines()[0]
        raise MissingDependency(f"{who} needs {name}, which does not load; {install}") from error


def checkpoint_folder(given: str, setting: str, what: str) -> Path:
    """The folder of a checkpoint.

    Args:
        given: the setting's value.
        setting: its name, for messages.
        what: should be there, for messages.

    Raises:
        InputError: nothing was given, or it is no folder.
    """
    if not given:
        raise InputError(setting, "is not given, and nothing is ever downloaded", what)
    path = Path(given).expanduser()
    if not path.is_dir():
        problem = "is not a folder" if path.exists() else "does not exist"
        raise InputError(path, problem, what)
    return path
