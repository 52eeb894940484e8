"""Tracks of more than one part: what stands still, the part that moves, and another that moves.

A tracker is given points all over the picture: most of them may be on what stands still, and two
parts may move. Tracks that stand still are left out; of the parts that move the one with most
tracks is the answer, the next one stands beside it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InsufficientData
from akm_fg.estimation.config import FitConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.path import local_noise
from akm_fg.geometry.rigid_motion import MIN_POINTS
from akm_fg.perception.moving_part.motion_segmentation import MotionSegmentation, segment_motion
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import BoolArray, PointTracks
from akm_fg.steps import to_end

_LEAST_NOISE_M = 1e-4  # of tracks whose noise nobody knows
_MIN_OTHER = 6  # tracks of a second part: fewer may go alike by chance
_MIN_OTHER_SHARE = 0.1  # of the first part's


def fit_parts(
    tracks: PointTracks,
    name: str = "tracks",
    noise_known: bool = True,
    seed: int = 0,
    config: FitConfig | None = None,
) -> ArticulationPosterior:
    """Fit the part that moves; a second one that moves is among `other_parts`.

    Args:
        tracks: T frames, N points of one part or several, and of what stands still.
        name: of the input.
        noise_known: False when the covariances are only nominal.
        seed: of whatever is sampled.
        config: tuning of the estimator.

    Raises:
        TracksLost: fewer than two frames, or too few tracks of one rigid part.
        AxisUnobservable: no moving kind can be fitted.
    """
    copies = _copies(tracks)
    if copies.any():
        answer = fit_parts(tracks.select(~copies), name, noise_known, seed, config)
        count = int(copies.sum())
        note = f"{count} of {copies.size} tracks are copies of others and were left out"
        rejected = answer.fit.tracks_rejected + count
        fit = replace(answer.fit, warnings=(note, *answer.fit.warnings), tracks_rejected=rejected)
        return replace(answer, fit=fit)
    measured = tracks if noise_known else _at_local_noise(tracks)
    seen = tracks.observed.sum(axis=0) >= 2
    parted = _parted(measured, seen)
    if parted is None:
        return fit_tracks(tracks, name, noise_known, seed, config)
    resting, moving = parted.static, parted.moving
    answer = fit_tracks(tracks.select(_kept(parted, seen)), name, noise_known, seed, config)
    others = _other_parts(measured, tracks, parted, name, noise_known, seed, config)
    notes = []
    if resting.any():
        notes.append(f"{int(resting.sum())} of {resting.size} tracks stand still and were left out")
    if others:
        notes.append(
            f"more than one part moves: this is the one with {int(moving.sum())} tracks; "
            + "; ".join(f"another with {other.fit.tracks_used}: {other.kind}" for other in others)
        )
    left_out = seen.size - answer.fit.tracks_used
    fit = replace(
        answer.fit, warnings=(*notes, *answer.fit.warnings), tracks_rejected=int(left_out)
    )
    return replace(answer, fit=fit, other_parts=others)


def _copies(tracks: PointTracks) -> BoolArray:
    """(N,) tracks that are another one's to the last bit: they are measured once, not twice.

    Points without extent tell no rotation, however many they are.
    """
    seen = tracks.observed.any(axis=0)
    rows = np.nan_to_num(np.swapaxes(tracks.p_world, 0, 1), nan=np.inf).reshape(seen.size, -1)
    _, first = np.unique(rows, axis=0, return_index=True)
    copies: BoolArray = np.array(seen)
    copies[first] = False
    return copies


def _parted(tracks: PointTracks, seen: BoolArray) -> MotionSegmentation | None:
    """What moves and what rests; None where all tracks are of one part as far as one can tell."""
    if seen.sum() <= MIN_POINTS or tracks.p_world.shape[0] < 2:
        return None
    parted = to_end(segment_motion(tracks))
    others = seen & ~parted.moving
    if parted.moving.sum() <= MIN_POINTS or others.sum() < MIN_POINTS:
        return None
    return parted


def _kept(parted: MotionSegmentation, seen: BoolArray) -> BoolArray:
    """(N,) tracks of the part, and those that rest and motion explain alike: near a hinge."""
    return np.asarray(seen & ~parted.static & ~parted.rejected)


def _other_parts(
    measured: PointTracks,
    tracks: PointTracks,
    parted: MotionSegmentation,
    name: str,
    noise_known: bool,
    seed: int,
    config: FitConfig | None,
) -> tuple[ArticulationPosterior, ...]:
    """The part that moves among the tracks that neither rest nor the first part explain."""
    left = np.flatnonzero(parted.rejected)
    if left.size < _MIN_OTHER:
        return ()
    found = to_end(segment_motion(measured.select(left)))
    enough = max(_MIN_OTHER, _MIN_OTHER_SHARE * float(parted.moving.sum()))
    if found.moving.sum() < enough:
        return ()
    members: NDArray[np.int_] = left[found.moving]
    try:
        return (fit_tracks(tracks.select(members), name, noise_known, seed, config),)
    except InsufficientData:
        return ()


def _at_local_noise(tracks: PointTracks) -> PointTracks:
    """With the noise that no smooth motion explains, the median over the tracks."""
    levels = []
    for point in np.swapaxes(tracks.p_world, 0, 1):
        known = np.isfinite(point).all(axis=1)
        if known.sum() >= 4:
            levels.append(local_noise(point[known]))
    sigma_m = max(float(np.median(levels)) if levels else 0.0, _LEAST_NOISE_M)
    cov = np.where(tracks.observed[..., None, None], sigma_m**2 * np.eye(3), np.nan)
    return PointTracks(tracks.p_world, cov)
