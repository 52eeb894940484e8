"""Points of the part that moved, where they were and how they went, with or without tracks."""

from __future__ import annotations

import numpy as np

from akm_fg.exploration.belief import ways_of
from akm_fg.exploration.records import Contact
from akm_fg.records import FloatArray, PointTracks
from akm_fg.stages import RecordingFit

PANEL_M = 0.1  # half side of what stands for a part without tracks: a small drawer's front


def part_points(fit: RecordingFit, contact: Contact) -> FloatArray:
    """(N, 3) followed points of the part, where they were in the first frame that shows them.

    Of a part that was known by its surface alone, the corners of a panel about the contact.
    """
    tracks = fit.observed.moving_tracks
    seen = tracks.observed
    chosen = np.flatnonzero(seen.any(axis=0))
    if chosen.size == 0:
        sides = ways_of(contact.normal_world)
        across, up = sides["left"], np.cross(contact.normal_world, sides["left"])
        corners = [(x, y) for x in (-PANEL_M, PANEL_M) for y in (-PANEL_M, PANEL_M)]
        return np.array([contact.p_world + x * across + y * up for x, y in corners])
    first = seen[:, chosen].argmax(axis=0)
    return np.asarray(tracks.p_world[first, chosen])


def mobile_tracks(fit: RecordingFit, contact: Contact) -> PointTracks:
    """How points of the part went: their tracks, for the paper's check of what moved.

    The paper's tracker follows points on plain surfaces too; ours does not. Where none is followed
    on the part and its surface tells how it moved, its points go as that says. There are none where
    nothing moved.
    """
    tracks, best = fit.observed.moving_tracks, fit.posterior.best
    followed = (tracks.observed.sum(axis=0) > 1).any()
    if followed or best.joint is None or best.states is None:
        return tracks
    x, q = part_points(fit, contact), best.states.mean
    R, t = best.joint.joint.motion(q)  # NaN where the part is not seen
    p_world = x @ np.ascontiguousarray(R.transpose(0, 2, 1)) + t[:, None]
    return PointTracks(p_world, np.zeros((*p_world.shape, 3)))
