"""Tracking of a whole clip: a loop over a tracker's session, nothing else."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from akm_fg.interfaces import PointTracker
from akm_fg.perception.tracking.track_store import pixel_tracks
from akm_fg.records import FloatArray, PixelTracks, RgbdFrame


def track_clip(
    tracker: PointTracker,
    frames: Sequence[RgbdFrame],
    queries_uv: FloatArray,
    query_frames: Sequence[int],
) -> PixelTracks:
    """Tracks of N pixels (N, 2) in their order, each from its frame of `query_frames` (N,) on.

    Raises:
        ValueError: queries outside the images or frames.
    """
    uv = np.asarray(queries_uv, dtype=np.float64).reshape(-1, 2)
    start = np.asarray(query_frames, dtype=int).reshape(-1)
    if len(start) != len(uv):
        raise ValueError(f"{len(uv)} queries, but {len(start)} query frames")
    if len(uv) and (start.min() < 0 or start.max() >= len(frames)):
        raise ValueError(f"query frames {start.min()}..{start.max()}, frames 0..{len(frames) - 1}")
    session, rows = tracker.begin(), []
    for t, frame in enumerate(frames):
        seen = session.advance(frame)
        rows.append(seen.joined(session.follow(uv[start == t])))
    given = np.argsort(start, kind="stable")  # the session numbers points as they begin
    tracks = pixel_tracks(rows, len(uv))
    back = np.argsort(given)
    return PixelTracks(tracks.uv[:, back], tracks.visible[:, back], tracks.cov_px2[:, back])
