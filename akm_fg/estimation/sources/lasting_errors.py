"""Errors of tracks that last: the same in every frame, so that no number of frames averages them.

The graph takes the errors of an observation for new in every frame. Of n errors e_t = s_t z with
vectors s_t and one standard normal z, the covariance s s^T is nowhere larger than n times its
blocks s_t s_t^T, and as large as that for what goes with s_t: (sum s_t^T x_t)^2 <= n sum (s_t^T
x_t)^2 (Cauchy and Schwarz). So what lasts counts n times, n being the frames that see the point.

What does not change in the part's own frame is no error of the motion: the reference point is
latent and takes it up. A point that lies elsewhere on its ray is off by the ray as the part sees
it, less its mean; where the part slides that is next to nothing.
"""

from __future__ import annotations

import numpy as np

from akm_fg.records import FloatArray, PointTracks


def cov_as_independent(tracks: PointTracks, R_world: FloatArray) -> FloatArray:
    """(T, N, 3, 3) of the tracks' errors where they are taken for new in every frame, m^2.

    Args:
        tracks: T frames.
        R_world: (T, 3, 3) how the part has turned, roughly.
    """
    if tracks.lasting is None:
        return tracks.cov_world
    seen = tracks.observed
    n = seen.sum(axis=0)
    here = np.where(seen[..., None], tracks.lasting.relief_world, 0.0)
    of_part = here @ R_world  # R^T r
    of_part -= of_part.sum(axis=0) / np.maximum(n, 1)[:, None]
    off = np.einsum("tij,tnj->tni", R_world, of_part)
    counted = np.maximum(n - 1, 0)[:, None, None] * tracks.lasting.slip_world
    counted += n[:, None, None] * off[..., :, None] * off[..., None, :]
    return np.asarray(tracks.cov_world + counted)


def hidden_share(tracks: PointTracks, cov_world: FloatArray) -> float:
    """Of the observed numbers, in how many residuals do not show what `cov_as_independent` adds.

    A number of which the share h of its variance lasts counts as (1 - h) of one.
    """
    seen = tracks.observed
    if tracks.lasting is None or not seen.any():
        return 0.0
    shown = np.linalg.solve(cov_world[seen], tracks.cov_world[seen])
    return float(1 - np.trace(shown, axis1=1, axis2=2).mean() / 3)
