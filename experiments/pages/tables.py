"""Rows as tables in Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from akm_fg.errors import AkmError
from experiments.rows.rows import TrialRow
from experiments.scores.statistics import Estimate


class NoRows(AkmError):
    """There are no trials to make a table or figure of."""


def markdown(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table; the first column to the left, the others to the right."""
    rule = ["---"] + ["---:"] * (len(header) - 1)
    return "\n".join("| " + " | ".join(line) + " |" for line in [header, rule, *lines])


def percent(estimate: Estimate) -> str:
    """A share and its interval: 97 (95 to 98)."""
    value, low, high = (100 * v for v in (estimate.value, estimate.low, estimate.high))
    return f"{value:.1f} ({low:.0f} to {high:.0f})"


def number(estimate: Estimate, digits: int = 2) -> str:
    """A value and its interval, as many significant digits as asked for."""
    parts = [_significant(v, digits) for v in (estimate.value, estimate.low, estimate.high)]
    return f"{parts[0]} ({parts[1]} to {parts[2]})"


def _significant(value: float, digits: int) -> str:
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e" in text and abs(value) >= 1 else text


def of_method(rows: Iterable[TrialRow], method: str) -> list[TrialRow]:
    """The rows of one method."""
    return [row for row in rows if row.method == method]


def grouped(rows: Iterable[TrialRow], name: Callable[[TrialRow], str]) -> dict[str, list[TrialRow]]:
    """Rows by what `name` says of them, in the order in which they come."""
    groups: dict[str, list[TrialRow]] = {}
    for row in rows:
        groups.setdefault(name(row), []).append(row)
    return groups


def known_or_infinite(values: Iterable[float | None]) -> list[float]:
    """A trial without a value is infinitely far off."""
    return [float("inf") if value is None else value for value in values]
