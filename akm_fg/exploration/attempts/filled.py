"""A frame whose hidden places are taken from another of the same still camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from akm_fg.records import RgbdFrame


def filled(frame: RgbdFrame, other: RgbdFrame) -> RgbdFrame:
    """The frame, and where it has no depth, as behind the robot, colour and depth of the other.

    Args:
        frame: keeps its time.
        other: by the same camera at the same place, of things that stand as they do in the frame.
    """
    hidden = ~np.isfinite(frame.depth_m)
    return replace(
        frame,
        rgb=np.where(hidden[..., None], other.rgb, frame.rgb),
        depth_m=np.where(hidden, other.depth_m, frame.depth_m),
    )
