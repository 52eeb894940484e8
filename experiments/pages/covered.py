"""What has a claimed covariance, and how often that holds the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from experiments.pages.tables import percent
from experiments.rows.rows import TrialRow
from experiments.scores.statistics import Estimate, mean_nees, share

NOTHING = "–"


@dataclass(frozen=True, slots=True)
class Quantity:
    """Something with a claimed covariance."""

    name: str
    inside: Callable[[TrialRow], bool | None]
    nees: Callable[[TrialRow], float | None]
    colour: str


QUANTITIES = (
    Quantity(
        "axis", lambda r: r.consistency.axis_inside95, lambda r: r.consistency.nees_axis, "graph"
    ),
    Quantity(
        "pivot", lambda r: r.consistency.pivot_inside95, lambda r: r.consistency.nees_pivot, "paper"
    ),
    Quantity(
        "joint", lambda r: r.consistency.joint_inside95, lambda r: r.consistency.nees_joint, "peer"
    ),
    Quantity(
        "last state",
        lambda r: r.consistency.last_state_inside95,
        lambda r: r.consistency.nees_last_state,
        "second",
    ),
)


def flags_of(rows: Sequence[TrialRow], quantity: Quantity) -> list[bool]:
    """Whether the truth is inside, of the rows that know it."""
    return [flag for row in rows if (flag := quantity.inside(row)) is not None]


def inside_columns(
    rows: Sequence[TrialRow], quantities: Sequence[Quantity] = QUANTITIES
) -> list[str]:
    """Share of the rows with the truth inside, of each quantity, for a table."""
    shares = (flags_of(rows, quantity) for quantity in quantities)
    return [percent(share(flags)) if flags else NOTHING for flags in shares]


def nees_of_joint(rows: Sequence[TrialRow]) -> Estimate | None:
    """Mean over its degrees of freedom; doors and drawers may be pooled. None: nobody knows it."""
    known = [row.consistency for row in rows if row.consistency.nees_joint is not None]
    if not known:
        return None
    total = sum(c.nees_joint or 0.0 for c in known)
    return mean_nees(total, sum(c.dof_joint or 0 for c in known))
