"""The Cramer-Rao bound of the openings that rows speak of, each worked out once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from experiments.rows.rows import TrialRow
from experiments.trials.bound import Bound, cramer_rao_bound
from experiments.trials.cells import cell_named


@cache
def bound_of(cell: str, seed: int) -> Bound:
    """The bound of one trial, from its name and seed."""
    return cramer_rao_bound(cell_named(cell).opening(seed))


def bounds_of(rows: Sequence[TrialRow]) -> list[Bound]:
    """One a row."""
    return [bound_of(row.cell, row.seed) for row in rows]


def median_axis_error_deg(rows: Sequence[TrialRow]) -> float:
    """Median over the rows of the median error that the bound allows."""
    return float(np.degrees(np.median([b.median_axis_error_rad for b in bounds_of(rows)])))


def share_inside(rows: Sequence[TrialRow], degrees_and_cm: float) -> float:
    """Share of estimates at the bound that are inside, their kinds right."""
    rng = np.random.default_rng(0)
    limit = np.deg2rad(degrees_and_cm), degrees_and_cm / 100
    return float(np.mean([bound.share_inside(*limit, rng) for bound in bounds_of(rows)]))
