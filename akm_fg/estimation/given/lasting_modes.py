"""Which tracks may be off alike in all frames, and how: what trackers tell, as the factor takes it.

See `factors.measurements.lasting_errors`. A slip is a part of the covariances, relief comes on top.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from akm_fg.records import FloatArray, PointTracks
from factors.measurements.lasting_errors import LastingModes
from factors.measurements.track_cost import TrackObservations

# Variance that lasts over that of the mean of all frames' own errors: below it, it is taken for
# new in every frame, which makes the variance of what a track tells at most so much too small.
LEAST_SHARE = 0.1
# Of a slip's variance, which adds up as that of a random walk does: the share of its first mode
# (8 / pi^2 of the Karhunen-Loeve expansion of Brownian motion). The rest comes and goes.
LASTING_SHARE = 8 / math.pi**2


def observations_of(tracks: PointTracks, which: NDArray[np.int_]) -> TrackObservations:
    """T frames of tracks as the factor takes them, the errors of some of them as such that last.

    Raises:
        ValueError: a covariance that is not positive definite, or not without its slip.
    """
    if tracks.lasting is None or not which.size:
        return TrackObservations.from_points(tracks.p_world, tracks.cov_world)
    slip, relief = _ways_off(tracks)
    vectors = np.stack([slip[:, which], relief[:, which]]).swapaxes(2, 3)
    sd = np.stack([np.sqrt(_alike(slip[:, which])), np.ones(which.size)])
    modes = LastingModes(which, np.ascontiguousarray(vectors), sd)
    cov_world = tracks.cov_world.copy()
    cov_world[:, which] = _without(slip[:, which], tracks.cov_world[:, which])
    return TrackObservations.from_points(tracks.p_world, cov_world, modes)


def lasting_tracks(tracks: PointTracks, R_world: FloatArray) -> NDArray[np.int_]:
    """The tracks of which it matters that their errors last.

    Args:
        tracks: T frames.
        R_world: (T, 3, 3) how the part has turned, roughly.
    """
    if tracks.lasting is None:
        return np.zeros(0, dtype=int)
    slip, relief = _ways_off(tracks)
    own = _without(slip, tracks.cov_world)
    share = sum(_share(way, R_world, tracks.observed, own) for way in (slip, relief))
    return np.flatnonzero(share > LEAST_SHARE)


def _ways_off(tracks: PointTracks) -> tuple[FloatArray, FloatArray]:
    """Slip and relief (T, N, 3), 0 where lost."""
    assert tracks.lasting is not None
    seen = tracks.observed[..., None]
    slip = math.sqrt(LASTING_SHARE) * np.where(seen, tracks.lasting.slip_world, 0.0)
    return slip, np.where(seen, tracks.lasting.relief_world, 0.0)


def _alike(slip_world: FloatArray) -> FloatArray:
    """(L,) with how many tracks each slips, itself included, of slips (T, L, 3).

    Flow that nothing holds along edges errs the same way along all of them. Of n numbers a_m with
    whatever correlations and unit variances (sum c_m a_m)^2 has a mean of at most n sum c_m^2
    (Cauchy and Schwarz): taken for independent, each counts n times.
    """
    length = np.linalg.norm(slip_world, axis=2, keepdims=True)
    along = slip_world / np.where(length > 0, length, 1.0)
    both = np.einsum("tl,tm->lm", length[..., 0] > 0, length[..., 0] > 0, dtype=float)
    squared = (np.einsum("tli,tmi->tlm", along, along) ** 2).sum(axis=0)
    return np.asarray(np.maximum((squared / np.maximum(both, 1.0)).sum(axis=1), 1.0))


def _without(slip_world: FloatArray, cov_world: FloatArray) -> FloatArray:
    return np.asarray(cov_world - slip_world[..., :, None] * slip_world[..., None, :])


def _share(
    off_world: FloatArray, R_world: FloatArray, seen: NDArray[np.bool_], cov_world: FloatArray
) -> FloatArray:
    """(N,) s^T cov^-1 s of all frames, of what the part does not take with it (T, N, 3)."""
    of_part = off_world @ R_world
    mean = of_part.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)[:, None]
    off = np.where(seen[..., None], of_part - mean, 0.0) @ R_world.swapaxes(1, 2)
    cov = np.where(seen[..., None, None], cov_world, np.eye(3))
    return np.asarray((off * np.linalg.solve(cov, off[..., None])[..., 0]).sum(axis=(0, 2)))
