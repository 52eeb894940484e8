"""A program that lacks what it needs ends with one line on standard error and a status of 1."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from akm_fg.errors import MissingDependency
from experiments.pages.tables import NoRows


@contextmanager
def ends_in_one_line(program: str) -> Iterator[None]:
    """Where rows or recordings, or what a method runs in, are not there.

    Raises:
        SystemExit: with that line.
    """
    try:
        yield
    except NoRows as nothing:
        raise SystemExit(f"{program}: {nothing}") from nothing
    except MissingDependency as error:
        raise SystemExit(str(error)) from error
