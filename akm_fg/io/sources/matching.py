"""Which depth picture belongs to which colour picture, by their stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from akm_fg.io.sources.source import Pair
from akm_fg.records import FloatArray

FARTHEST_S = 0.05  # a part pulled at 0.1 m/s goes 5 mm in it
LEAST_REACH_S = 0.02  # what the TUM benchmark's own tool allows


@dataclass(frozen=True, slots=True)
class Matched:
    """Pairs of colour and depth, and how far they are apart."""

    pairs: tuple[Pair, ...]  # both numbers grow
    stamps_s: FloatArray  # (N,) of the colour pictures, strictly growing
    apart_s: FloatArray  # (N,) depth after colour
    alone: int  # colour pictures without depth


def period_s(stamps_s: FloatArray) -> float:
    """Median time between pictures; NaN of fewer than two."""
    return float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else float("nan")


def match(colour_s: FloatArray, depth_s: FloatArray) -> Matched:
    """Nearest first, each picture once, as far apart as half the faster stream's period.

    Args:
        colour_s: stamps (N,) in order.
        depth_s: stamps (M,) in order, of the same clock.
    """
    periods = [p for p in (period_s(colour_s), period_s(depth_s)) if np.isfinite(p)]
    reach_s = float(np.clip(0.6 * min(periods, default=0.0), LEAST_REACH_S, FARTHEST_S))
    near: list[tuple[float, int, int]] = []
    for i, stamp_s in enumerate(colour_s):
        first = int(np.searchsorted(depth_s, stamp_s - reach_s))
        last = int(np.searchsorted(depth_s, stamp_s + reach_s, side="right"))
        near += [(abs(float(depth_s[j] - stamp_s)), i, j) for j in range(first, last)]
    taken_colour: dict[int, int] = {}
    taken_depth: set[int] = set()
    for _, i, j in sorted(near):
        if i not in taken_colour and j not in taken_depth:
            taken_colour[i] = j
            taken_depth.add(j)
    return _in_order(sorted(taken_colour.items()), colour_s, depth_s)


def _in_order(pairs: Sequence[Pair], colour_s: FloatArray, depth_s: FloatArray) -> Matched:
    """Without pairs that go back in time, or repeat a stamp."""
    kept: list[Pair] = []
    for i, j in pairs:
        if not kept or (j > kept[-1][1] and colour_s[i] > colour_s[kept[-1][0]]):
            kept.append((i, j))
    ci, di = [i for i, _ in kept], [j for _, j in kept]
    apart = depth_s[di] - colour_s[ci]
    return Matched(tuple(kept), colour_s[ci], apart, len(colour_s) - len(kept))
