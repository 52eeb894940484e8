"""Which tracks follow a motion that is known from elsewhere, and did not just rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from akm_fg.records import BoolArray, FloatArray, PointTracks


@dataclass(frozen=True, slots=True)
class FollowingConfig:
    """What counts as following."""

    gate_m: float = 0.015  # rms distance from the motion: what a motion from depth may be off
    least_share: float = 0.4  # of the rms distance from rest, that from the motion may be
    least_motion_m: float = 0.004  # rms distance from rest: below, calibration drift can do it
    min_observations: int = 5


def following(
    tracks: PointTracks,
    R_world: FloatArray,
    t_world: FloatArray,
    known: BoolArray,
    config: FollowingConfig | None = None,
) -> BoolArray:
    """(N,) tracks that go with the motion.

    Args:
        tracks: T frames.
        R_world: (T, 3, 3) motions from frame 0.
        t_world: (T, 3).
        known: (T,) frames in which the motion is known.
        config: tuning.
    """
    config = config or FollowingConfig()
    seen = tracks.observed & known[:, None]
    p = np.where(seen[..., None], tracks.p_world, 0.0)
    back = (p - t_world[:, None]) @ R_world
    moved, rested = _spread(back, seen), _spread(p, seen)
    good = seen.sum(axis=0) >= config.min_observations
    good &= (moved < config.gate_m) & (rested > config.least_motion_m)
    return np.asarray(good & (moved < config.least_share * rested))


def _spread(p: FloatArray, seen: BoolArray) -> FloatArray:
    """Rms distance (N,) of points (T, N, 3) from their medians."""
    hidden = np.where(seen[..., None], p, np.nan)
    lost = ~seen.any(axis=0)
    hidden[:, lost] = 0.0
    off = hidden - np.nanmedian(hidden, axis=0)
    spread = np.sqrt(np.nanmean((off**2).sum(axis=-1), axis=0))
    return np.where(lost, np.inf, spread)
