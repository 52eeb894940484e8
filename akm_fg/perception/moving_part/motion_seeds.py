"""Tracks to start from when looking for the part: what moved with the hand, or moved alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from akm_fg.perception.moving_part.motion_config import MotionSegmentationConfig
from akm_fg.perception.moving_part.two_clusters import two_clusters
from akm_fg.records import BoolArray, FloatArray, PointTracks


def held_tracks(
    tracks: PointTracks,
    significant: BoolArray,
    hand_world: FloatArray,
    config: MotionSegmentationConfig,
) -> NDArray[np.int_]:
    """Indices of tracks that moved and kept their distance to the hand."""
    distance = np.linalg.norm(tracks.p_world - hand_world[:, None], axis=-1)
    seen = np.isfinite(distance)
    n = np.maximum(seen.sum(axis=0), 1)
    change = np.where(seen, distance - np.where(seen, distance, 0).sum(axis=0) / n, 0.0)
    noise = np.trace(tracks.cov_world, axis1=2, axis2=3) / 3 + config.systematic_m**2
    noise = np.where(seen, noise + config.hand_slip_m**2, 1.0)
    per_freedom = (change**2 / noise).sum(axis=0) / np.maximum(n - 1, 1)
    enough = seen.sum(axis=0) >= config.min_observations
    return np.flatnonzero(significant & enough & (per_freedom < config.max_per_freedom))


def with_hand(
    tracks: PointTracks, hand_world: FloatArray, config: MotionSegmentationConfig
) -> PointTracks:
    """The tracks and, as one more, the hand."""
    cov = np.where(np.isfinite(hand_world)[..., None], config.hand_slip_m**2 * np.eye(3), np.nan)
    return PointTracks(
        np.concatenate([tracks.p_world, hand_world[:, None]], axis=1),
        np.concatenate([tracks.cov_world, cov[:, None]], axis=1),
    )


def spectral_clusters(
    tracks: PointTracks,
    p: FloatArray,
    significant: BoolArray,
    config: MotionSegmentationConfig,
    rng: np.random.Generator,
) -> list[NDArray[np.int_]]:
    """Indices of tracks that moved, and moved alike (paper, Eq. 3, in units of the noise).

    One group or two, the likelier part first.
    """
    observed = tracks.observed
    index = np.flatnonzero(significant)
    if len(index) > config.spectral_tracks:
        index = np.sort(rng.choice(index, config.spectral_tracks, replace=False))
    if len(index) < 2 * config.min_moving:
        return [index]
    difference = _displacement_difference(p[:, index], observed[:, index], tracks, index, config)
    k = min(config.neighbours, len(index) - 1)
    local = np.maximum(np.sort(difference, axis=1)[:, k], 1.0)
    affinity = np.exp(-(difference**2) / (local[:, None] * local[None]))
    labels = two_clusters(affinity + 1e-6)
    sizes = [int((labels == k).sum()) for k in (0, 1)]
    alike = [float(np.median(difference[np.ix_(labels == k, labels == k)])) for k in (0, 1)]
    # The larger cluster is the part, unless it is a heap of tracks that moved each on its own.
    order = sorted((0, 1), key=lambda k: (-sizes[k] / (1 + alike[k]), k))
    return [*(index[labels == k] for k in order), index]


def _displacement_difference(
    p: FloatArray,
    observed: BoolArray,
    tracks: PointTracks,
    index: NDArray[np.int_],
    config: MotionSegmentationConfig,
) -> FloatArray:
    """(n, n) rms change of the offset between two tracks, in standard deviations.

    Over the frames that see both; pairs with fewer than two such frames get the largest value.
    """
    M = observed.T.astype(float)
    count = M @ M.T
    x = p.transpose(1, 0, 2) * M[..., None]
    square = (x**2).sum(axis=2)
    sum_square = square @ M.T + M @ square.T - 2 * np.einsum("itk,jtk->ij", x, x)
    sums = np.einsum("itk,jt->ijk", x, M) - np.einsum("it,jtk->ijk", M, x)
    n = np.maximum(count, 1)
    variance = np.maximum(sum_square / n - ((sums / n[..., None]) ** 2).sum(axis=2), 0)
    trace = np.trace(tracks.cov_world[:, index], axis1=2, axis2=3)
    noise = np.nanmean(np.where(observed, trace, np.nan), axis=0) + 3 * config.systematic_m**2
    difference = np.sqrt(variance / (noise[:, None] + noise[None]))
    return np.where(count >= 2, difference, difference.max())
