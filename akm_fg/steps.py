"""Long work in pieces: a generator that pauses, so that a camera's next frame need not wait."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeAlias, TypeVar

Result = TypeVar("Result")
Steps: TypeAlias = Generator[None, None, Result]


def to_end(steps: Steps[Result]) -> Result:
    """Do all the pieces that are left, without a pause."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result


def every(count: int, steps: Steps[Result]) -> Steps[Result]:
    """The same work with a pause after so many pieces only."""
    done = 0
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result
        done += 1
        if done % count == 0:
            yield
