"""Whether the camera sees the object at all: dark and shiny things have no depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from akm_fg.records import BoolArray, Doubt, RgbdFrame


def unseen_doubts(
    frames: Sequence[RgbdFrame], object_mask: BoolArray, largest_share: float
) -> list[Doubt]:
    """About an object in whose place many pixels have no depth, in the median of the frames.

    Args:
        frames: of the clip.
        object_mask: (H, W) what is seen of the object in the first frame.
        largest_share: of the pixels of its box that may be without depth.
    """
    v, u = np.nonzero(object_mask)
    if not v.size:
        return []
    box = (slice(v.min(), v.max() + 1), slice(u.min(), u.max() + 1))
    missing = [float(np.mean(~np.isfinite(frame.depth_m[box]))) for frame in frames]
    share = float(np.median(missing))
    if share <= largest_share:
        return []
    return [
        Doubt(
            f"{100 * share:.0f} % of the object's place has no depth: what moved may not have been "
            "seen; expected light, a part that is less dark or shiny, or another sensor"
        )
    ]
