"""Rows of a pose log that jump: a tag seen in another place, or flipped, for a few rows.

A joint moves on; what jumps comes back. A run of rows is a jump where the way into it and the way
out of it are many times the log's usual step, and its neighbours on either side are close to each
other. Fast motion, a start from rest and a reversal do not look like that: their neighbours are as
far apart as their steps are long, or their steps are usual ones. Nothing is assumed of the joint.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from akm_fg.records import BoolArray, FloatArray, PoseTrack
from factors.measurements.orientation_track import log_so3

LONGEST_RUN = 10  # rows; what stays away longer is a place of its own
_USUAL_STEPS = 8.0  # a jump in usual steps: 3-d normal noise makes one such in 10^20 rows
_COMES_BACK = 1 / 3  # neighbours of a jump are nearer to each other than this share of it
_PASSES = 3  # jumps beside jumps show once the others are gone
_LEAST_M, _LEAST_RAD = 0.002, 0.02  # smaller ones are noise, whatever the steps are

Distances = Callable[[NDArray[np.int_], NDArray[np.int_]], FloatArray]


def jumping_rows(poses: PoseTrack) -> BoolArray:
    """(T,) rows whose position or orientation jumps."""
    p, R = poses.p_world, poses.R_world_part

    def apart_m(a: NDArray[np.int_], b: NDArray[np.int_]) -> FloatArray:
        return np.asarray(np.linalg.norm(p[b] - p[a], axis=1))

    jumps = _jumps(np.asarray(np.isfinite(p).all(axis=1)), apart_m, _LEAST_M)
    if R is not None:

        def apart_rad(a: NDArray[np.int_], b: NDArray[np.int_]) -> FloatArray:
            return np.asarray(np.linalg.norm(log_so3(R[a].swapaxes(1, 2) @ R[b]), axis=1))

        jumps |= _jumps(np.asarray(np.isfinite(R).all(axis=(1, 2))), apart_rad, _LEAST_RAD)
    return jumps


def _jumps(known: BoolArray, apart: Distances, least: float) -> BoolArray:
    """(T,) rows that jump by these distances."""
    jumps = np.zeros(known.size, dtype=bool)
    for _ in range(_PASSES):
        rows = np.flatnonzero(known & ~jumps)
        found = _runs(rows, apart, least)
        if not found.size:
            break
        jumps[found] = True
    return jumps


def _runs(rows: NDArray[np.int_], apart: Distances, least: float) -> NDArray[np.int_]:
    """Those of the rows (K,) that are in a run that jumps; short runs are looked for first."""
    if rows.size < 5:
        return rows[:0]
    steps = apart(rows[:-1], rows[1:])
    moves = steps[steps > 1e-9]
    if not moves.size:
        return rows[:0]
    limit = max(_USUAL_STEPS * float(np.median(moves)), least)
    for length in range(1, min(LONGEST_RUN, rows.size // 4) + 1):
        before, after = np.arange(rows.size - length - 1), np.arange(length + 1, rows.size)
        away = np.minimum(steps[before], steps[after - 1])
        back = apart(rows[before], rows[after])
        first = before[(away > limit) & (back < _COMES_BACK * away)] + 1
        if first.size:
            return np.unique(rows[(first[:, None] + np.arange(length)).ravel()])
    return rows[:0]
